import math
import os
import re
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import zoac
from tests import commands
from tests.envs.test_adapters import Drift, Integrator
from tests.support import CountingTask
from zoac.core.errors import ConfigError, RunFolderError
from zoac.runs import schema
from zoac.runs.result import task_of_run
from zoac.runs.schema import read_run

SMALL = {
    "num_envs": 2, "eval_every": 400, "episodes": 1, "final_episodes": 2, "quiet": True,
    "max_episode_steps": 20,
}  # fmt: skip


ROOT = Path(__file__).parents[2]


class Sized(Drift):
    def __init__(self, size=1.0):
        super().__init__()
        self.size = size


def proportional(params, obs):
    return -params["k"] * obs[0]


def tune(**changes):
    return zoac.tune(**{
        "env": Drift, "controller": proportional, "space": {"k": (0, 2)}, "budget": 400, **SMALL,
        **changes,
    })  # fmt: skip


def test_tunes_a_function_on_an_environment():
    """Noise alone costs least when each step undoes what the last one left: k = 1."""
    result = tune(tuner="random", budget=2500, seed=1)
    assert result.parameters["k"] == pytest.approx(1.0, abs=0.35)
    assert set(result.history["kind"]) == {"train", "eval"}
    assert result.cost_mean == pytest.approx(np.mean(result.cost_per_episode))


def test_processes_give_the_bits_of_serial(forked_workers):
    alone = tune(controller=Integrator())
    assert tune(controller=Integrator(), executor="process").parameters == alone.parameters


def test_start_values_are_where_zoac_begins_and_what_they_cost_stays_with_the_run(tmp_path):
    space = {"k": {"low": 0, "high": 2, "baseline": 1.5}}
    nothing_tuned = tune(space=space, budget=0)
    assert nothing_tuned.parameters["k"] == pytest.approx(1.5)
    assert nothing_tuned.baseline_cost_mean == pytest.approx(nothing_tuned.cost_mean)
    result = tune(space=space, folder=tmp_path / "run")
    assert result.baseline_cost_mean == pytest.approx(nothing_tuned.cost_mean)
    for again in (zoac.load_result(tmp_path / "run"), tune(space=space, folder=tmp_path / "run")):
        assert again.baseline_cost_mean == result.baseline_cost_mean


def test_a_folder_makes_a_run_that_is_not_done_twice_nor_its_task_kept_again(tmp_path, capsys):
    first = tune(folder=tmp_path / "run")
    (tmp_path / "run" / schema.TASK).write_bytes(b"as it was")
    second = tune(folder=tmp_path / "run")
    assert second.parameters == first.parameters
    assert capsys.readouterr().out == ""
    tune(folder=tmp_path / "run", quiet=False)
    assert "done already" in capsys.readouterr().out
    assert (tmp_path / "run" / schema.TASK).read_bytes() == b"as it was"


def other(params, obs):
    return params["k"] * obs[0]


def above(limit):
    return lambda s: s.costs - limit


class Gained(Integrator):
    def __init__(self, gain):
        self.gain = gain


class Locked(Drift):
    def __init__(self):
        super().__init__()
        self.door = threading.Lock()

    def __deepcopy__(self, memo):
        return Locked()


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        ({}, {"controller": other}, "code.controller: 'tests.run.test_api.proportional@"),
        ({}, {"env": lambda: Drift()}, "code.env: 'tests.envs.test_adapters.Drift@"),
        ({}, {"baseline": {"k": 0.5}}, "task.baseline.k: '(absent)' there, 0.5 now"),
        ({}, {"max_episode_steps": 19}, "task.max_episode_steps: 20 there, 19 now"),
        ({}, {"metrics": {"effort": lambda s: s.costs}}, "code.metrics.effort: '(absent)'"),
        ({}, {"budget": 500}, "budget: 400 there, 500 now"),
        ({"env": partial(Sized, 1.0)}, {"env": partial(Sized, 0.01)}, "code.env: '"),
        ({"controller": Gained(1.0)}, {"controller": Gained(2.0)}, "code.controller: '"),
        ({"constraints": {"x": above(1.0)}}, {"constraints": {"x": above(2.0)}},
         "code.constraints.x: '"),
        ({"plant": {"size": 1.0}, "env": Sized}, {"plant": {"size": 2.0}, "env": Sized},
         "task.plant.size: 1.0 there, 2.0 now"),
    ],
)  # fmt: skip
def test_a_folder_with_another_run_is_refused_by_what_differs(tmp_path, first, second, told):
    tune(folder=tmp_path / "run", **first)
    tune(folder=tmp_path / "run", **first)
    with pytest.raises(RunFolderError, match=re.escape(told)):
        tune(folder=tmp_path / "run", **second)


def test_a_task_object_with_other_attributes_is_another_run(tmp_path):
    options = {"budget": 40, "num_envs": 2, "episodes": 1, "final_episodes": 2, "quiet": True}
    zoac.tune(task=CountingTask(7), folder=tmp_path, **options)
    zoac.tune(task=CountingTask(7), folder=tmp_path, **options)
    with pytest.raises(RunFolderError, match="code.task: 'tests.support.CountingTask@"):
        zoac.tune(task=CountingTask(8), folder=tmp_path, **options)


def test_a_result_is_not_returned_for_what_cannot_be_compared(tmp_path, capsys):
    tune(env=Locked(), folder=tmp_path / "run")
    assert "'door' is a lock, which cannot be compared. So nobody" in capsys.readouterr().err
    with pytest.raises(RunFolderError, match="cannot be told: env: attribute 'door' is a lock"):
        tune(env=Locked(), folder=tmp_path / "run")
    assert tune(env=Locked(), folder=tmp_path / "run", resume="overwrite").env_steps >= 400


def test_the_same_script_in_a_second_process_gets_the_result_of_the_first(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "1"}
    run_it = f"import runpy; runpy.run_path({str(script)!r}, run_name='__main__')"
    seen = [  # the first with the random hashes of the process that it is forked from
        commands.run("-c", run_it, cwd=tmp_path, env=environment, check=True).stdout,
        subprocess.run(
            [sys.executable, "-W", "ignore", str(script)], check=True, text=True,
            capture_output=True, cwd=tmp_path, env=environment,
        ).stdout,
    ]  # fmt: skip
    assert "done already" not in seen[0]
    assert "done already" in seen[1]
    assert seen[0].splitlines()[-1] == seen[1].splitlines()[-1]


SCRIPT = """
from functools import partial
import zoac
from tests.run.test_api import Sized, above

print(zoac.tune(
    env=partial(Sized, 2.0), controller=lambda p, o: -p["k"] * o[0], space={"k": (0, 2)},
    num_envs=2, constraints={"x": above(1.0)}, metrics={"y": lambda s: s.costs}, budget=100,
    episodes=1, final_episodes=2, max_episode_steps=20, folder="run", tuner="random",
).cost_mean)
"""


def test_a_run_is_called_after_its_environment():
    assert read_run(tune(budget=0).folder)["task"] == "Drift"
    assert read_run(tune(budget=0, env=lambda: Drift()).folder)["task"] == "lambda"
    assert read_run(tune(budget=0, env=partial(Sized, 2.0)).folder)["task"] == "Sized"


def test_overwrite_begins_the_run_of_a_folder_again(tmp_path):
    tune(folder=tmp_path / "run")
    again = tune(folder=tmp_path / "run", controller=other, resume="overwrite")
    assert again.parameters == tune(controller=other).parameters
    kept = task_of_run(tmp_path / "run", trust_code=True).make_controller()
    action, *_ = kept.act({"k": np.array([1.0])}, np.array([[2.0]]), kept.init(1))
    assert action == other({"k": 1.0}, [2.0])
    with pytest.raises(ConfigError, match="'auto', 'never' or 'overwrite'"):
        tune(folder=tmp_path / "run", resume="sometimes")


def test_a_task_that_is_tuned_stays_as_it_was():
    task = zoac.make_task("pid_acc")
    before = dict(task.baseline), task.failure_penalty
    zoac.tune(
        task=task, baseline={"k": 1.0, "Kp": 1.0, "Ki": 0.1, "Kd": 1.0}, failure_penalty=9.0,
        budget=0, num_envs=2, episodes=1, final_episodes=2, quiet=True,
    )  # fmt: skip
    assert (dict(task.baseline), task.failure_penalty) == before


def test_start_values_may_stand_in_the_space_and_beside_it():
    space = {"k": {"low": 0, "high": 2, "baseline": 1.5}, "other": (0, 1)}
    result = tune(space=space, baseline={"other": 0.25}, budget=0)
    assert result.parameters == pytest.approx({"k": 1.5, "other": 0.25})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tuner": "zoca"}, "did you mean 'zoac'"),
        ({"tuner": 5}, "tuner=5: input should be a valid string"),
        ({"tuner": math.nan}, "tuner=nan: input should be a valid string"),
        ({"budget": np.ones(2)}, r"budget: expected no array, got one of shape \(2,\)"),
        ({"failure_penalty": np.ones(())}, r"failure_penalty: expected no array"),
        ({"failure_penalty": np.bool_(True)}, "failure_penalty=True: input should be"),
        ({"env": (k for k in ())}, "env"),
        ({"plant": {(1,): 2.0}}, r"plant=\{\(1,\): 2.0\}: expected numbers by attribute"),
        ({"tuner_options": "sigma"}, "tuner_options='sigma': input should be a valid dictionary"),
        ({"tuner": "zoac", "tuner_options": {"sgima": 1}}, "did you mean 'exploration.sigma'"),
        (
            {"tuner": "zoac", "tuner_options": {"exploration": {"sigma": -1}}},
            "tuner.exploration.sigma=-1",
        ),
        ({"budget": -5}, "budget=-5"),
        ({"eval_every": 0}, "eval_every=0"),
        ({"initial_sigma": "high"}, "initial_sigma='high': input should be a valid number"),
        ({"controller": None}, "needs a task, or all of env, controller and space"),
        ({"task": "pid_acc"}, "either task or env"),
        ({"space": {"k": {"low": 0, "high": 2, "baseline": 9}}}, "'k': 9.0 lies outside"),
    ],
)
def test_what_cannot_be_used_is_named(changes, message):
    with pytest.raises(ConfigError, match=message):
        tune(**changes)


def test_task_options_get_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'jerk'"):
        zoac.make_task("pid_acc", jrek="rate")
    assert zoac.make_task("pid_acc", jerk="increment").space.names == ("k", "Kp", "Ki", "Kd")


@pytest.mark.parametrize("option", [{"max_episode_steps": 100}, {"metrics": {"m": np.ravel}}])
def test_what_a_given_task_would_not_heed_is_refused(option):
    with pytest.raises(ConfigError, match=f"not .*{next(iter(option))}"):
        zoac.tune(task="pid_acc", budget=400, quiet=True, **option)


def test_a_task_by_name_and_as_an_object_is_tuned_alike():
    options = {"budget": 400, "num_envs": 2, "episodes": 1, "final_episodes": 2, "quiet": True}
    by_name = zoac.tune(task="pid_acc", **options)
    assert set(by_name.parameters) == {"k", "Kp", "Ki", "Kd"}
    assert zoac.tune(task=zoac.make_task("pid_acc"), **options).parameters == by_name.parameters


def test_whole_numbers_may_be_written_as_floats_and_nothing_else_may():
    written = tune(budget=1e2, seed=3.0)
    assert written.parameters == tune(budget=100, seed=3).parameters
    assert isinstance(read_run(written.folder)["seed"], int)
    for option in ({"budget": 10.5}, {"seed": "3"}, {"num_envs": True}, {"budget": "400"}):
        with pytest.raises(ConfigError, match=f"{next(iter(option))}=.*valid integer"):
            tune(**option)
    with pytest.raises(ConfigError, match="common_random_numbers='no': .* valid boolean"):
        tune(common_random_numbers="no")


def test_the_console_tells_the_acceptance_tests_verdict_and_broken_constraints(capsys):
    result = tune(quiet=False, acceptance_test=0.5,
                  space={"k": {"low": 0, "high": 2, "baseline": 1.5}},
                  constraints={"never": lambda s: np.ones(s.length)})  # fmt: skip
    out = " ".join(capsys.readouterr().out.split())  # as it was before it was wrapped
    test = result.record["acceptance_test"]
    verdict = (
        "the tuned values beat the baseline values"
        if test["accepted"]
        else "the baseline values are kept"
    )
    assert f"acceptance test: {verdict}: {test['text']}" in out
    assert re.search(r"WARNING: The constraint never is broken in (\d+) of \1 final episodes", out)


def test_the_console_tells_options_and_whole_numbers(capsys):
    space = {"k": (0, 2), "n": (1, 9, "integer"), "mode": {"choices": ["fast", "safe"]}}
    result = tune(space=space, tuner="random", quiet=False)
    out, err = capsys.readouterr()
    found = result.parameters
    assert f"  n = {found['n']}\n  mode = {found['mode']}\n" in out
    assert "switched off" not in err


def test_a_sampled_start_on_common_episodes_is_told_and_changes_what_is_tuned():
    plain, sampled = (
        tune(tuner="es", **terms)
        for terms in ({}, {"initial_samples": 5, "common_random_numbers": True})
    )
    choices = read_run(sampled.folder)["tuner_choices"]
    assert choices["start"] == "best of 5 random points"
    assert choices["episodes"] == "common to a batch"
    assert plain.parameters != sampled.parameters


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("lanes", "it is now called 'num_envs'"),
        ("start", "it is now called 'baseline'"),
        ("budgte", "did you mean 'budget'"),
    ],
)
def test_an_unknown_option_gets_the_nearest_or_its_present_name(option, said):
    with pytest.raises(ConfigError, match=f"no option '{option}'; {said}"):
        tune(**{option: 3})


@pytest.mark.parametrize("task", [["pid_acc"], 3, Sized])
def test_what_is_no_task_is_refused(task):
    with pytest.raises(ConfigError, match="^task=.*: expected a Task, or the name of a built-in"):
        zoac.tune(task=task)


@pytest.mark.parametrize("baseline", [[1.0, 2.0], 3.0, "Kp"])
def test_the_baseline_of_a_built_in_task_is_values_by_name(baseline):
    with pytest.raises(ConfigError, match="^baseline=.*: expected values by name"):
        zoac.tune(task="pid_acc", baseline=baseline)
