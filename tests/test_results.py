"""The reproduction's tables and figures come from `results/`, byte for byte."""

import functools
import json
import re
from pathlib import Path

import matplotlib
import pandas as pd
import pytest
from scipy.stats import ttest_ind

from benchmarks.remake import MADE
from zoac.analysis import curves, suite
from zoac.analysis.data import cli
from zoac.analysis.data.load import load
from zoac.analysis.figures import style
from zoac.analysis.statistics.profiles import mean_score, with_scores

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results"
FIGURES = ROOT / "docs" / "images" / "reproduction"


@pytest.fixture(scope="module", autouse=True)
def each_folder_is_read_once():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli, "load", functools.cache(load))
        yield


def same_bytes(made: Path, kept: Path) -> None:
    names = sorted(path.name for path in kept.iterdir())
    assert names
    for name in names:
        assert (made / name).read_bytes() == (kept / name).read_bytes(), name


def test_no_path_of_a_machine_is_kept():
    for path in RESULTS.rglob("methods.json"):
        for method in json.loads(path.read_text()):
            assert "runs_dir" not in method["config"], path
            assert not re.search(r'"(/|~|[A-Z]:)', json.dumps(method)), path


@pytest.mark.parametrize("folder", MADE)
def test_a_table_or_figure_rebuilds(tmp_path, folder):
    command, kept, options = MADE[folder]
    drawn_by = (FIGURES / "matplotlib.txt").read_text().strip()
    if command is curves and drawn_by != matplotlib.__version__:
        pytest.skip(f"drawn by matplotlib {drawn_by}, whose bytes differ")
    assert command.main([str(RESULTS / kept), *options.split(), "--out", str(tmp_path)]) == 0
    same_bytes(tmp_path, ROOT / folder)


def test_the_40_seeds_of_cruise_control_are_as_found_md_says():
    costs = pd.read_csv(RESULTS / "seeds" / "runs.csv").set_index("seed").cost_mean
    assert sorted(costs.index) == list(range(40))
    starts = range(0, 40, 8)
    blocks = " ".join(f"{costs.iloc[first : first + 8].median():.2f}" for first in starts)
    assert blocks == "3.63 2.65 2.36 2.61 2.73"
    quartiles = " ".join(f"{costs.quantile(q):.2f}" for q in (0.25, 0.5, 0.75))
    assert quartiles == "2.36 2.61 30.33"
    assert ((costs > 3.2).sum(), (costs > 1800).sum()) == (13, 8)


def test_the_8_seeds_kept_in_full_are_the_first_of_the_40():
    many = pd.read_csv(RESULTS / "seeds" / "runs.csv").set_index("seed").cost_mean
    runs = pd.read_csv(RESULTS / "runs.csv")
    few = runs[(runs.task == "pid_acc") & (runs.tuner == "zoac")].set_index("seed").cost_mean
    assert few.to_dict() == many.iloc[:8].to_dict()


def report_of(costs, name):
    """Return how the report says where runs end: the numbers, formatted as there."""
    if name == "mpc_tracking":
        return f"| code | {len(costs)} | {costs.mean():.1f} ± {costs.std():.1f} |"
    converged = f"{(costs < 2.2).sum()} below 2.2"
    return f"| {len(costs)} | {costs.min():.2f} to {costs.max():.2f} | {converged} |"


@pytest.mark.parametrize(
    ("task", "variant"),
    [
        ("mpc_tracking", "authors_code"),
        ("pid_acc_code", "authors_code"),
        ("pid_acc_code", "authors_code_annealed"),
    ],
)
def test_runs_of_the_authors_code_end_where_the_report_says(task, variant):
    runs = pd.read_csv(RESULTS / "authors_code" / "runs.csv")
    chosen = runs[(runs.task == task) & (runs.variant == variant) & (runs.tuner == "zoac")]
    report = (ROOT / "docs" / "reproduction.md").read_text()
    assert sorted(chosen.seed) == list(range(len(chosen)))
    assert report_of(chosen.cost_mean, task) in report


def test_the_runs_of_fig_4_are_those_of_the_authors_code():
    logged = pd.read_csv(RESULTS / "authors_code" / "runs.csv")
    chosen = (logged.task == "pid_acc_code") & (logged.variant == "authors_code")
    costs = logged[chosen & (logged.tuner == "zoac")].set_index("seed").cost_mean
    runs = load(RESULTS / "fig4").finished
    assert {run.seed for run in runs} == set(range(8))
    for run in runs:
        assert run.cost_mean == pytest.approx(costs[run.seed], rel=1e-4)
        assert [row["parameters"] for row in run.evaluations][-1].keys() == {"k", "Kp", "Ki", "Kd"}


def test_what_was_found_shows_the_rows_of_table_2():
    table = (RESULTS / "tables" / "mpc_tracking" / "table2.md").read_text().split("\n\n")[2]
    assert table in (ROOT / "docs" / "found.md").read_text()


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ("suite", "suite"),
        ("held_out", "suite_held_out"),
        ("extras", "suite_extras"),
        ("without_restore", "suite_without_restore"),
    ],
)
def test_the_tables_of_the_suite_rebuild(tmp_path, name, folder, monkeypatch):
    if name != "suite":  # whose figure alone is kept
        monkeypatch.setattr(style, "save", lambda *given: None)
    runs = RESULTS / "suite" / f"{name}.csv"
    assert suite.main([str(runs), "--out", str(tmp_path), "--format", "svg"]) == 0
    assert (tmp_path / "suite.csv").read_bytes() == runs.read_bytes()
    kept = RESULTS / "tables" / folder / "suite.md"
    assert (tmp_path / "suite.md").read_bytes() == kept.read_bytes()
    drawn_by = (FIGURES / "matplotlib.txt").read_text().strip()
    if name == "suite" and drawn_by == matplotlib.__version__:
        assert (tmp_path / "suite.svg").read_bytes() == (FIGURES / "suite/suite.svg").read_bytes()


def test_the_page_has_the_scores_of_the_suite():
    page = (ROOT / "docs" / "which_tuner.md").read_text()
    scored = with_scores(suite.read(RESULTS / "suite" / "suite.csv"))
    for (count, tuner), own in scored.groupby(["experiments", "tuner"]):
        found = mean_score(own)
        bold = f"**{found.estimate:.2f}**", f"{found.estimate:.2f}"
        (row,) = (line for line in page.splitlines() if line.startswith(f"| `{tuner}` | "))
        interval = f"[{found.low:.2f}, {found.high:.2f}]"
        assert any(f"{value} {interval}" in row for value in bold), (count, tuner)


def test_the_page_has_the_scores_where_nothing_can_be_restored():
    page = (ROOT / "docs" / "which_tuner.md").read_text()
    scored = with_scores(suite.read(RESULTS / "suite" / "without_restore.csv"))
    for count, own in scored.groupby("experiments"):
        tuners = ("optuna", "bo", "cmaes_plus", "cmaes_full", "zoac_plus", "random")
        found = [mean_score(own[own.tuner == tuner]) for tuner in tuners]
        cells = [f"{score.estimate:.2f} [{score.low:.2f}, {score.high:.2f}]" for score in found]
        assert f"| {count} | {' | '.join(cells)} |" in page


def test_the_page_has_the_scores_of_tuners_with_an_extra():
    page = (ROOT / "docs" / "baselines.md").read_text()
    scored = with_scores(suite.read(RESULTS / "suite" / "extras.csv"))
    for tuner in ("botorch", "hebo", "smac", "optuna", "zoac_plus", "cmaes_plus", "bo", "random"):
        own = scored[scored.tuner == tuner]
        found = mean_score(own)
        score = f"{found.estimate:.2f} [{found.low:.2f}, {found.high:.2f}]"
        assert f"| `{tuner}` | {score} | {own.seconds.median():.1f} |" in page


def test_the_page_has_the_returns_of_linear_policies():
    page = (ROOT / "docs" / "policies.md").read_text()
    rows = pd.read_csv(RESULTS / "linear_policies.csv")
    for (env, noise), both in rows.groupby(["env", "noise"]):
        found = {method: own.return_mean for method, own in both.groupby("method")}
        cells = [f"{found[m].mean():,.0f} ± {found[m].std():,.0f}" for m in ("zoac", "ars")]
        difference = ttest_ind(found["zoac"], found["ars"], equal_var=False)
        interval = difference.confidence_interval()
        gain = found["zoac"].mean() - found["ars"].mean()
        cells.append(f"{gain:+,.0f} [{interval.low:,.0f}, {interval.high:,.0f}]")
        assert f"| {env} | {noise:g} | {' | '.join(cells)} |" in page
        assert all(len(own) == 10 for own in found.values())
