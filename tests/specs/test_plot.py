"""Signals over seconds: the exported table, the figure before and after, and traces."""

import numpy as np
import pandas as pd
import pytest

import zoac
from tests.specs.loops_to_tune import SIGNALS, FirstOrder, proportional, tuned
from zoac.core.errors import RunFolderError
from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.runs import responses
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
        shown = [line.get_label() for line in axes.lines if line.get_label() != "Limit"]
        assert shown == labels
    before, after = y.lines[1].get_ydata(), y.lines[2].get_ydata()
    table = result.responses
    assert (before == table[table["parameters"] == "baseline"]["y"]).all()
    assert (after == table[table["parameters"] == "tuned"]["y"]).all()
    limits = [line for line in y.lines if line.get_label() == "Limit"]
    told = {(*line.get_xdata(), round(line.get_ydata()[0], 9)) for line in limits}
    assert told == {(0.0, 2.0, 1.05), (0.5, 2.0, 1.25), (0.5, 2.0, 0.75)}
    (limit,) = (line for line in u.lines if line.get_label() == "Limit")
    assert set(limit.get_ydata()) == {6.0}


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


def test_of_loops_side_by_side_the_first_is_drawn():
    columns = ["parameters", "time", "y 1", "y 2", "y 10", "speed 1", "u 1", "u 2"]
    table = pd.DataFrame([range(len(columns))], columns=columns)
    assert list(responses.first_loop(table).columns) == ["parameters", "time", "y", "speed 1", "u"]
    assert responses.first_loop(table)["u"][0] == 6
