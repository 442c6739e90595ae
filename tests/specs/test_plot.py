"""Signals over seconds: the exported table, the figure before and after, and traces."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import zoac
from tests.specs.loops_to_tune import SIGNALS, FirstOrder, proportional, tuned
from zoac.core.errors import ConfigError, RunFolderError
from zoac.core.segments import Proposal, Segment
from zoac.rollout.engine import RolloutEngine
from zoac.runs import responses
from zoac.specs import guides
from zoac.specs import step_info as figures
from zoac.specs.signals import Signal
from zoac.specs.verdict import Deciding, deciding
from zoac.tasks.user_task import user_task

SPECS = [
    zoac.specs.overshoot("y", "r", max=0.05),
    zoac.specs.settling_time("y", "r", band=0.25, max=0.5),
    zoac.specs.peak("u", max=6.0),
]


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return tuned(specs=SPECS, budget=400, folder=tmp_path_factory.mktemp("run"))


def test_the_table_holds_the_responses_exactly(result):
    table = result.responses
    for which, k in (("baseline", 1.0), ("tuned", result.parameters["k"])):
        part = table[table["parameters"] == which]
        assert part["time"].to_numpy() == pytest.approx(0.05 * np.arange(41))
        y, u = part["y"].to_numpy(), part["u"].to_numpy()
        assert u[:-1] == pytest.approx(k * (1.0 - y[:-1]))
        assert u[-1] == u[-2]  # held
        assert (part["r"] == 1.0).all()


def test_the_figure_shows_each_signal_before_and_after_with_its_limits(result):
    y, u = result.plot().axes
    assert (y.get_ylabel(), u.get_ylabel(), u.get_xlabel()) == ("y [m]", "u", "Time [s]")
    for axes, labels in ((y, ["Reference", "Before", "After"]), (u, ["Before", "After"])):
        assert [line.get_label() for line in axes.lines] == labels
    before, after = y.lines[1].get_ydata(), y.lines[2].get_ydata()
    table = result.responses
    assert (before == table[table["parameters"] == "baseline"]["y"]).all()
    assert (after == table[table["parameters"] == "tuned"]["y"]).all()
    (low, high), (_, most) = y.get_ylim(), u.get_ylim()
    assert forbidden(y) == rounded(
        (0.0, 2.0, 1.05, high), (0.5, 2.0, 1.25, high), (0.5, 2.0, low, 0.75)
    )
    assert forbidden(u) == rounded((0.0, 2.0, 6.0, most))
    assert most > 6.0  # the region is in view, though no signal reaches it


def forbidden(axes):
    """Return the hatched regions: from, to, low, high."""
    boxes = [part.get_datalim(axes.transData) for part in axes.collections]
    return rounded(*((box.x0, box.x1, box.y0, box.y1) for box in boxes))


def rounded(*regions):
    return {tuple(round(float(value), 9) for value in region) for region in regions}


def test_a_step_down_must_not_fall_below_its_limit():
    overshoot = guides.plain(zoac.specs.overshoot("y", "r", max=0.1))
    time, values = np.arange(3.0), {"y": np.array([1.0, 0.2, 0.0]), "r": np.zeros(3)}
    assert guides.limits([overshoot], "y", time, values) == [guides.Limit(-0.1, 0.0, 2.0, False)]


def test_a_limit_holds_where_the_spec_judges():
    spec = guides.plain(zoac.specs.overshoot("y", "r", max=0.1, window=(0.1, 0.3)))
    time = np.arange(5) * 0.1  # 0.3 is 0.30000000000000004
    values = {"y": np.zeros(5), "r": np.ones(5)}
    limit = guides.Limit(1.1, time[1], time[3], True)
    assert guides.limits([spec], "y", time, values) == [limit]


def test_a_loaded_result_plots_the_same_and_saves_it(result, tmp_path):
    path = tmp_path / "response.png"
    loaded = zoac.load_result(result.folder).plot(path)
    assert path.stat().st_size > 1000
    for one, other in zip(result.plot().axes, loaded.axes, strict=True):
        for line, twin in zip(one.lines, other.lines, strict=True):
            assert np.array_equal(line.get_ydata(), twin.get_ydata())


def test_a_run_without_signals_says_what_is_missing():
    plain = tuned(specs=[], signals=None, objective="auto", budget=80)
    assert plain.specs.empty
    assert plain.feasible
    with pytest.raises(RunFolderError, match="give the task signals"):
        plain.plot()


def test_starting_anew_deletes_the_responses_of_the_run_before(tmp_path):
    tuned(budget=80, folder=tmp_path)
    assert (tmp_path / "responses.csv").is_file()
    tuned(budget=80, folder=tmp_path, signals=None, specs=[], objective="auto", resume="overwrite")
    assert not (tmp_path / "responses.csv").exists()


def test_traces_have_names_units_seconds_reference_and_limits():
    task = user_task(
        env=FirstOrder, controller=proportional, space={"k": (0.5, 12.0)}, max_episode_steps=40,
        signals=SIGNALS, specs=SPECS,
    )  # fmt: skip
    (segment,) = RolloutEngine(task, [0], [0]).rollout([Proposal(np.zeros(1), 0)])
    y, u, cost = task.traces(segment)
    assert [trace.title for trace in (y, u, cost)] == ["y [m]", "u", "Cost"]
    assert y.x_label == "Time [s]"
    assert y.x[-1] == pytest.approx(2.0)
    assert y.reference is not None
    assert (y.reference[1] == 1.0).all()
    assert y.limits == pytest.approx((1.05, 1.25, 0.75))
    assert (u.reference, u.limits) == (None, (6.0,))


@pytest.mark.parametrize(
    ("spec", "names", "expected"),
    [
        (None, ("y", "u", "r"), {"y": "r"}),
        (None, ("x", "x_ref", "r"), {"x": "x_ref"}),
        (zoac.specs.peak("y", max=2.0), ("y", "r"), {"y": "r"}),
        (zoac.specs.peak("r", max=2.0), ("y", "r"), {}),
        (zoac.specs.overshoot("x", "r", max=0.1), ("x", "y", "r"), {"x": "r"}),
        (zoac.specs.overshoot("y", "goal", max=0.1), ("y", "r", "goal"), {"y": "goal"}),
    ],
)
def test_a_reference_that_no_spec_names_goes_by_its_name(spec, names, expected):
    rows = [] if spec is None else [guides.plain(spec)]
    assert guides.references(rows, names) == expected


def test_a_reference_without_a_spec_is_drawn_over_its_signal():
    plain = tuned(specs=[], objective="auto", budget=80)
    panels = [axes for axes in plain.plot().axes if axes.lines]
    assert [axes.get_ylabel() for axes in panels] == ["y [m]", "u"]
    assert panels[0].lines[0].get_label() == "Reference"


def test_the_figure_shows_the_episode_that_decides_and_says_so(result):
    shown = result.record["shown"]
    assert shown["of"] == 4
    title = result.plot().axes[0].get_title()
    assert title == f"Final episode {shown['episode'] + 1} of 4, the worst for {shown['spec']}"


class Drifting(FirstOrder):
    """The same with an offset of the output that each episode draws."""

    def reset(self, *, seed=None, options=None):
        observation, info = super().reset(seed=seed)
        self.offset = self.np_random.uniform(0.0, 0.1)
        return observation, info

    def step(self, action):
        observation, *rest = super().step(action)
        return observation + self.offset, *rest


@pytest.mark.parametrize("over", ["worst", "mean"])
def test_the_worst_episode_is_drawn_of_a_spec_of_the_worst(over):
    error = zoac.specs.steady_state_error("y", "r", max=0.25, over=over)
    found = tuned(env=Drifting, specs=[error], budget=400, final_episodes=8)
    table = found.responses
    part = table[table["parameters"] == "tuned"]
    (row,) = found.specs[found.specs["limit"] != ""].to_dict("records")
    drawn = figures.steady_state_error(part["time"], part["y"].to_numpy(), 1.0)
    if over == "worst":
        assert drawn == pytest.approx(row["value"])
        assert found.record["shown"]["spec"] == row["spec"]
    else:
        assert found.record["shown"] == {"episode": 0, "of": 8, "loop": 0, "spec": None}
        assert found.plot().axes[0].get_title() == "Final episode 1 of 8"


def segment_of(*values):
    """Return an episode in which specs had these values."""
    zeros = np.zeros((3, 1))
    return Segment(
        Proposal(np.zeros(1), 0), zeros, zeros[1:], zeros[1:], np.zeros(2), False, True, True,
        spec_values=values,
    )  # fmt: skip


def test_of_several_specs_the_one_with_the_least_reserve_decides():
    specs = [zoac.specs.peak("y", max=10.0), zoac.specs.rms("y", min=1.0)]
    episodes = [segment_of(9.0, 1.5), segment_of(5.0, 1.05), segment_of(2.0, 3.0)]
    signals = {"y": zoac.observation(0)}
    assert deciding(episodes, specs, signals, 0.1) == Deciding(1, specs[1])
    ended_early = replace(episodes[2], spec_values=None)
    assert deciding([*episodes, ended_early], specs, signals, 0.1) == Deciding(3, specs[0])


def test_of_loops_side_by_side_the_worst_decides():
    y = np.array([[0.0, 0.0], [0.5, 2.0], [0.5, 1.0]])
    spec = zoac.specs.peak("y", max=3.0)
    signals = {"y": Signal("both", lambda segment: y)}
    assert deciding([segment_of(2.0)], [spec], signals, 0.1).loop == 1


def test_of_loops_side_by_side_one_is_drawn():
    columns = ["parameters", "time", "y 1", "y 2", "y 10", "speed 1", "u 1", "u 2"]
    table = pd.DataFrame([range(len(columns))], columns=columns)
    first = responses.one_loop(table, {"shown": {"loop": 0}})
    assert list(first.columns) == ["parameters", "time", "y", "speed 1", "u"]
    assert first["u"][0] == 6
    assert responses.one_loop(table, {"shown": {"loop": 1}})["u"][0] == 7


@pytest.mark.parametrize(
    ("path", "said"),
    [
        (3, r"plot\(3\): expected a file, such as 'step.png'; formats: .*\.png"),
        ("step.xyz", r"plot to 'step.xyz': .*known: .*\.pdf, .*\.png"),
        ("nowhere/step.png", "plot to 'nowhere/step.png': No such file"),
    ],
)
def test_a_figure_that_cannot_be_saved_gets_one_message(result, path, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=said):
        result.plot(path)


def test_a_figure_is_saved_in_the_format_of_its_suffix(result, tmp_path):
    result.plot(tmp_path / "step.SVG")
    assert "<svg" in (tmp_path / "step.SVG").read_text()
