"""Specs, signals and an objective beside a built-in task."""

import pytest

import zoac
from zoac import specs
from zoac.core.errors import ConfigError, RunFolderError
from zoac.runs import schema

ERROR = specs.peak("clearance_error", max=0.045)


def tuned(**options):
    given = {
        "task": "pid_acc", "budget": 4_000, "eval_every": 4_000, "num_envs": 4, "episodes": 1,
        "final_episodes": 3, "tuner": "cmaes_full", "quiet": True,
    }  # fmt: skip
    return zoac.tune(**{**given, **options})


@pytest.fixture(scope="module")
def result():
    return tuned(specs=[ERROR], objective=specs.rms("clearance_error"))


def test_a_built_in_tasks_signals_are_judged_and_its_cost_is_replaced(result):
    (hard, soft) = result.specs.to_dict("records")
    assert (hard["spec"], hard["limit"]) == ("peak(clearance_error)", "<= 0.045")
    assert hard["baseline"] == pytest.approx(0.05, abs=0.01)  # the baseline breaks it
    assert soft["value"] == pytest.approx(result.cost_mean)
    drawn = result.responses.groupby("parameters")["clearance_error"]
    assert drawn.apply(lambda y: abs(y).max())["tuned"] <= hard["value"]
    assert result.plot().axes[0].get_ylabel() == "clearance_error [m]"


def test_a_run_with_specs_is_another_run_than_one_without(result):
    run = schema.read_run(result.folder)
    assert run["task"] == "pid_acc"
    assert run["config"]["task"]["built_in"]["target"] == "zoac.tasks.pid_acc.PidAcc"
    with pytest.raises(RunFolderError, match="another configuration"):
        tuned(folder=result.folder)
    again = tuned(specs=[ERROR], objective=specs.rms("clearance_error"), folder=result.folder)
    assert again.parameters == result.parameters
    loaded = zoac.load_result(result.folder, trust_code=True)
    assert loaded.controller() is not None


def test_signals_may_be_given_and_the_callers_task_stays_as_it_is():
    task = zoac.make_task("lqr", max_episode_steps=50)
    found = zoac.tune(
        task=task, signals={"x": zoac.observation(0)}, specs=[specs.peak("x", max=1.1)],
        objective=specs.rms("x"),
        budget=500, eval_every=500, tuner="random", final_episodes=2, episodes=1, quiet=True,
    )  # fmt: skip
    assert list(found.specs["spec"]) == ["peak(x)", "rms(x)"]
    assert task.specs == ()
    assert "x" not in task.signals


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tuner": "zoac", "specs": [ERROR]}, "or one that asks for these: cmaes_full"),
        ({"specs": [specs.peak("clearence_error", max=1)]}, "did you mean 'clearance_error'"),
        ({"task": "mpc_tracking", "specs": [ERROR]}, r"name it: signals=\{'clearance_error'"),
        ({"objective": "cost"}, r"not \['objective'\] too"),
        ({"specs": [ERROR], "objective": ERROR}, "it has a limit"),
        ({"specs": [ERROR], "sample_time": -1.0}, "expected seconds, above 0"),
    ],
)
def test_what_cannot_be_used_is_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        tuned(**options)
