import json
import re
import subprocess
import sys
from collections import Counter
from html.parser import HTMLParser

import numpy as np
import pytest

import zoac
from tests.analysis.folders import NOMINAL, write_run
from zoac.analysis import compact, robustness
from zoac.analysis.data.load import load
from zoac.analysis.figures import style
from zoac.analysis.pages import loops
from zoac.analysis.pages import sweep as pages
from zoac.analysis.report import main
from zoac.core.measures import Trace

VOID = {"meta", "br", "link", "img"}


def page(root, out, *options):
    assert main([str(root), "--out", str(out), *options]) == 0
    return (out / "report.html").read_text()


class Tags(HTMLParser):
    """Counts ids and checks that tags close in order."""

    def __init__(self):
        super().__init__()
        self.open: list[str] = []
        self.ids: Counter[str] = Counter()

    def handle_starttag(self, tag, attrs):
        self.ids.update(value for name, value in attrs if name == "id" and value)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.ids.update(value for name, value in attrs if name == "id" and value)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def comparison(root):
    with style.drawing(style.SCREEN):
        return pages.sweep(load(root), "pid_acc")


SPECS = [
    {"spec": "overshoot(y, r)", "limit": "<= 0.05", "baseline": 0.2, "baseline_met": False,
     "value": 0.03, "met": True, "broken": 0, "bad_side": "high", "has_baseline": True,
     "figure": "overshoot", "signals": ["y", "r"], "options": {}, "window": None, "max": 0.05,
     "min": None},
    {"spec": "settling_time(y, r)", "limit": "<= 1 s", "baseline": None, "baseline_met": False,
     "value": 1.2, "met": False, "broken": 3, "bad_side": "high", "has_baseline": True,
     "figure": "settling_time", "signals": ["y", "r"], "options": {"band": 0.02}, "window": None,
     "max": 1.0, "min": None},
]  # fmt: skip
BASELINE = {
    "cost_mean": 6.5, "cost_per_episode": [5.0, 6.0, 7.0, 8.0],
    "violations_by_constraint": {"jerk": {"episodes": 2, "steps": 9, "worst": 0.25}},
}  # fmt: skip


def with_signals(root, **options):
    """Write a run with two specs, a constraint, and a response of first order in y."""
    folder = write_run(
        root,
        **options,
        result={
            "specs": SPECS,
            "violations_by_constraint": {"jerk": {"episodes": 0, "steps": 0, "worst": 0.0}},
            "baseline": BASELINE,
            "baseline_cost_mean": 6.5,
            "shown": {"episode": 0, "of": 4, "loop": 0, "spec": None},
        },
    )
    record = json.loads((folder / "run.json").read_text())
    record["signals"] = {"sample_time": 0.1, "units": {"y": "rad/s", "r": "", "u": "V"}}
    (folder / "run.json").write_text(json.dumps(record))
    rows = ["parameters,time,y,r,u"]
    for which, tau in (("baseline", 2.0), ("tuned", 0.5)):
        for t in np.arange(0.0, 5.0, 0.1):
            rows.append(f"{which},{t},{1 - np.exp(-t / tau)},1.0,0.5")
    (folder / "responses.csv").write_text("\n".join(rows) + "\n")
    return folder


def rows_of(text, heading):
    """Return the cells of the table under a heading, by the first cell and the column."""
    table = text.split(f"<h3>{heading}</h3>")[1].split("</table>")[0]
    found = {}
    for row in re.findall(r"<tr.*?</tr>", table.split("<tbody>")[1], re.S):
        cells = re.findall(r'<td(?: class="[a-z]*")? data-label="([^"]*)">(.*?)</td>', row)
        (_, first), *others = cells
        css = re.match(r'<tr class="(\w+)"', row)
        found[first] = {**dict(others), "css": css[1] if css else ""}
    return found


@pytest.fixture(scope="module")
def signals_folder(tmp_path_factory):
    return with_signals(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def signals(signals_folder, tmp_path_factory):
    return page(signals_folder, tmp_path_factory.mktemp("out"))


@pytest.fixture(scope="module")
def text(tmp_path_factory):
    root = tmp_path_factory.mktemp("runs")
    for seed in range(2):
        write_run(root, "zoac", seed, gains={"k": 2.0, "Kp": 1.0, "Ki": 0.0, "Kd": 3.0})
    write_run(root, "nominal", evaluations=(), gains=NOMINAL)
    write_run(root, "bo", finished=False)
    return page(root, tmp_path_factory.mktemp("out"))


def test_the_page_fetches_nothing(text):
    assert not re.search(r"<(script|link|iframe|img)\b", text)
    assert not re.search(r"""(src|href)=["'](?!#)|url\((?!#)|@import""", text)


def test_the_page_is_well_formed_and_its_ids_are_unique(text):
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    assert [name for name, times in tags.ids.items() if times > 1] == []


def test_references_within_pictures_lead_somewhere(text):
    wanted = set(re.findall(r"url\(#([^)]*)\)", text)) | set(re.findall(r'href="#([^"]*)"', text))
    assert wanted
    assert wanted <= set(re.findall(r' id="([^"]*)"', text))


def test_gains_stand_before_and_after_within_their_bounds(text):
    (line,) = [line for line in text.split("\n") if line.startswith("<tr>") and ">Kp<" in line]
    cells = dict(re.findall(r'data-label="([^"]*)">(.*?)</td>', line))
    assert (cells["Start of tuning"], cells["Before"], cells["After"]) == ("1.05", "0.8307", "1")
    assert "<span>0</span>" in cells["Range"]
    assert "<span>10</span>" in cells["Range"]
    assert 'class="after" style="left:10.0%"' in line


def test_a_gain_at_its_bound_is_pointed_out(text):
    assert "At a bound: Ki (low)." in text


def test_what_the_user_wrote_is_escaped(text):
    assert "uniform &lt;from the seed&gt;" in text


def test_an_unfinished_run_is_named(text):
    assert "unfinished, 500 of 1000 environment steps" in text


@pytest.mark.usefixtures("undrawn")
def test_one_run_is_enough(tmp_path):
    text = page(write_run(tmp_path, evaluations=()), tmp_path / "out", "--no-replay")
    assert "Comparison" not in text
    assert "ZOAC, seed 0" in text
    assert "<h1><small>Tuning report</small>PID-ACC</h1>" in text


@pytest.mark.usefixtures("undrawn")
def test_a_task_that_cannot_be_rebuilt_costs_only_the_closed_loop(tmp_path):
    config = {"task": {"_target_": "nowhere.Task"}}
    folder = write_run(tmp_path, evaluations=(), config=config)
    assert "its task cannot be built again" in page(folder, tmp_path / "out", "--trust-code")


def test_the_same_runs_give_the_same_page(signals_folder, signals, tmp_path):
    assert page(signals_folder, tmp_path) == signals


def test_commands_start_without_torch():
    modules = ("table2", "curves", "landscape", "trajectories", "report")
    imports = "; ".join(f"import zoac.analysis.{name}" for name in modules)
    code = f"import sys; {imports}; print('torch' in sys.modules, 'hydra' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False False\n"


@pytest.mark.usefixtures("undrawn")
def test_terminations_while_tuning_are_those_of_the_result(tmp_path):
    counted = {"tuning_terminations": 224}
    folder, small = write_run(tmp_path / "runs", evaluations=(), result=counted), tmp_path / "small"
    assert compact.main([str(folder), "--out", str(small)]) == 0
    for root in (folder, small):
        text = page(root, tmp_path / "out", "--no-replay")
        assert "episodes that ended early while tuning: 224<" in text


def test_requirements_are_rows_green_or_red_before_and_after(signals):
    rows = rows_of(signals, "Requirements")
    met, unmet = '<span class="met">✓</span>', '<span class="unmet">✗</span>'
    assert rows["overshoot(y, r)"] == {
        "Limit": "≤ 0.05", "Before": f"{unmet} 0.2", "After": f"{met} 0.03", "css": "met",
    }  # fmt: skip
    assert rows["settling_time(y, r)"] == {
        "Limit": "≤ 1 s", "Before": f"{unmet} never",
        "After": f"{unmet} 1.2, broken in 3 of 4 episodes", "css": "unmet",
    }  # fmt: skip
    assert rows["jerk"]["Before"] == f"{unmet} broken in 2 of 4 episodes, by up to 0.25"
    assert rows["jerk"]["After"] == f"{met} kept"
    assert '<b class="unmet">2 of 3 requirements are met.</b>' in signals


def test_signals_have_names_units_and_seconds_and_stand_over_their_reference(signals):
    response = signals.split("<h3>Response</h3>")[1].split("<h3>")[0]
    y, u = re.findall(r"<svg.*?</svg>", response, re.S)
    for picture, label in ((y, "y [rad/s]"), (u, "u [V]")):
        assert f">{label}</text>" in picture
        assert ">Time [s]</text>" in picture
    assert ">Reference</text>" in y
    assert ">Reference</text>" not in u
    assert "Closed loop" not in signals  # recorded signals are not driven once more


def test_the_step_is_described_where_the_reference_steps_once(signals):
    rows = rows_of(signals, "Step information")
    rise = rows["Rise time, 10% to 90% [s]"]  # tau ln 9
    assert float(rise["Before"]) == pytest.approx(2.0 * np.log(9), abs=0.11)
    assert float(rise["After"]) == pytest.approx(0.5 * np.log(9), abs=0.11)
    settled = rows["Settling time, 2% [s]"]  # tau ln 50
    assert settled["Before"] == "never"
    assert float(settled["After"]) == pytest.approx(0.5 * np.log(50), abs=0.11)


def test_a_recorded_limit_cycle_is_told_with_its_period(tmp_path):
    file = with_signals(tmp_path, evaluations=()) / "responses.csv"
    rows = ["parameters,time,y,r,u"]
    for which, amplitude in (("baseline", 0.0), ("tuned", 0.3)):
        for t in np.arange(0.0, 60.0, 0.1):
            rows.append(f"{which},{t},{1 + amplitude * np.sin(2 * np.pi * t / 1.5)},1.0,0.5")
    file.write_text("\n".join(rows) + "\n")
    response = page(tmp_path, tmp_path / "out").split("<h3>Response</h3>")[1].split("<h3>")[0]
    y, u = re.findall(r"<svg.*?</svg>", response, re.S)
    assert ">After (limit cycle, 1.5 s)</text>" in y
    assert ">Before</text>" in y
    assert "limit cycle" not in u


@pytest.mark.usefixtures("undrawn")
def test_a_reference_that_moves_twice_has_no_step(tmp_path):
    file = with_signals(tmp_path, evaluations=()) / "responses.csv"
    lines = file.read_text().splitlines()
    lines[20] = lines[20].replace(",1.0,", ",0.0,")
    file.write_text("\n".join(lines) + "\n")
    rows = rows_of(page(tmp_path, tmp_path / "out"), "Step information")
    assert rows["Overshoot [%]"]["Before"] == "--"
    assert rows["Overshoot [%]"]["After"] == "0"


def test_the_curve_ends_with_the_answer_and_the_baseline_is_drawn_once(signals):
    curve = signals.split("<h3>Learning curve</h3>")[1].split("<h3>")[0]
    (picture, _) = re.findall(r"<svg.*?</svg>", curve, re.S)
    labels = re.findall(r">([^<>]+)</text>", picture)
    assert [labels.count(name) for name in ("Final", "Baseline values")] == [1, 1]
    assert "2 evaluation episodes each" in curve


@pytest.mark.usefixtures("undrawn")
def test_a_difference_stands_with_its_interval(tmp_path):
    costs = [3.0, 4.0, 5.0, 6.0, 7.0]
    baseline = {"cost_mean": 7.2, "cost_per_episode": [5.0, 6.0, 7.0, 8.5, 9.5]}
    folder = write_run(tmp_path, costs=costs, evaluations=(), result={"baseline": baseline})
    text = page(folder, tmp_path / "out", "--no-replay")
    assert re.search(r"Difference -2\.20 \[-2\.\d+, -\d\.\d+\], paired, 95%", text)


@pytest.mark.usefixtures("undrawn")
def test_a_difference_that_is_the_same_but_for_rounding_has_no_interval(tmp_path):
    baseline = {"cost_mean": 0.4, "cost_per_episode": [0.4] * 5}
    costs = [0.1 + 0.2, 0.3, 0.3, 0.3, 0.3]
    folder = write_run(tmp_path, costs=costs, evaluations=(), result={"baseline": baseline})
    text = page(folder, tmp_path / "out", "--no-replay")
    assert "Difference -0.1, the same in every episode" in text


@pytest.mark.usefixtures("undrawn")
def test_no_heading_is_empty(text, signals, tmp_path):
    nominal = page(write_run(tmp_path, "nominal", evaluations=()), tmp_path / "out")
    for found in (text, signals, nominal):
        assert re.findall(r"</h([23])>\s*<(?:h\1|/details|footer)", found) == []
        assert '<div class="gallery"></div>' not in found


@pytest.mark.usefixtures("undrawn")
def test_pairs_without_a_difference_are_one_sentence(sweep):
    text = comparison(sweep)
    differences = text.split("<h3>Differences</h3>")[1]
    assert "no claim" not in text
    assert "1 of 6 pairs show no clear difference" in differences
    said = re.findall(r"<li>(.*?)</li>", differences)
    assert any(s.startswith("<b>Nominal</b> beats ZOAC: it costs less on average") for s in said)
    assert [s for s in said if not re.search(r"\[[\d.%]+, [\d.%]+\]", s)] == []
    table = differences.split("<tbody>")[1]
    assert table.count("<tr>") == 6
    assert len(re.findall(r"[+-][\d.]+ \[[+-][\d.]+, [+-][\d.]+\]", table)) == 6


def test_a_sweep_says_which_runs_are_better_than_the_baseline(tmp_path):
    baseline = {"cost_mean": 5.0, "cost_per_episode": [4.0, 6.0]}
    for tuner, costs in (("zoac", (3.0, 4.0)), ("bo", (3.0, 9.0))):
        for seed, cost in enumerate(costs):
            result = {"baseline": baseline}
            write_run(tmp_path, tuner, seed, costs=[cost, cost], result=result)
    text = comparison(tmp_path)
    assert "The baseline values cost 5 in the same episodes. 3 of 4 runs ended with a lower" in text
    rows = rows_of(text, "Comparison")
    assert {name: row["Better than baseline"] for name, row in rows.items()} == {
        "ZOAC": "2 of 2",
        "BO": "1 of 2",
    }
    curves = text.split("<h3>Learning curves</h3>")[1].split("<h3>")[0]
    assert curves.count(">Baseline values</text>") == 1


@pytest.mark.usefixtures("undrawn")
def test_four_seeds_give_no_difference_without_an_interval(tmp_path):
    for seed in range(4):
        write_run(tmp_path, "zoac", seed, evaluations=())
    write_run(tmp_path, "nominal", evaluations=())
    text = page(tmp_path, tmp_path / "out", "--no-replay")
    assert "A difference needs at least 5 seeds" in text
    assert "Minus nominal" not in text


def test_cells_carry_the_names_of_their_columns_for_narrow_screens(signals):
    cells = re.findall(r"<td[^>]*>", signals)
    assert cells
    assert all("data-label=" in cell for cell in cells)


def test_a_study_is_told_in_experiments(tmp_path):
    zoac.tune(
        cost=lambda p: (p["kp"] - 3) ** 2, space={"kp": (0.1, 20)}, baseline={"kp": 1.0},
        experiments=6, tuner="random", quiet=True, folder=tmp_path / "motor",
    )  # fmt: skip
    text = page(tmp_path / "motor", tmp_path / "out")
    assert re.search(r"<b>6</b><span>experiments</span>", text)
    assert "nvironment steps" not in text
    assert "episode" not in text.split("Configuration")[0]
    assert ">Experiments</text>" in text


@pytest.mark.usefixtures("undrawn")
def test_robustness_is_shown_where_it_was_run(tmp_path, capsys):
    folder, other = write_run(tmp_path / "runs"), write_run(tmp_path / "runs", "bo")
    out = tmp_path / "robustness"
    options = ["--out", str(out), "--plants", "2", "--episodes", "2", "--format", "svg"]
    assert robustness.main([str(folder), *options, "--vary", "preceding_std=0.02,0.2"]) == 0
    asked = ["--robustness", str(out), "--no-replay"]
    text = page(folder, tmp_path / "out", *asked)
    rows = rows_of(text, "Robustness")
    assert set(rows) == {"tuned", "baseline"}
    own = json.loads((out / "robustness.json").read_text())["plants"]["costs"]["tuned"][0]
    assert float(rows["tuned"]["Own plant"]) == pytest.approx(np.mean(own), rel=1e-3)
    assert "<h3>Sensitivity</h3>" in text
    assert "<h3>Robustness</h3>" not in page(other, tmp_path / "out", *asked)
    capsys.readouterr()
    assert main([str(folder), "--robustness", str(tmp_path / "nowhere")]) == 1
    assert capsys.readouterr().err.startswith("error: no robustness.json in")


def test_a_controller_that_leaves_the_view_does_not_squeeze_the_tuned_one():
    trace = Trace("y", np.arange(3.0), np.array([0.0, 1.0, 0.5]))
    axes = style.blank(3, 2).subplots()
    axes.plot(trace.x, trace.y)
    assert not loops.keep_in_view(axes, trace)
    axes.plot(trace.x, [0.0, -300.0, 100.0])
    assert loops.keep_in_view(axes, trace)
    assert axes.get_ylim() == (-1.0, 2.0)
