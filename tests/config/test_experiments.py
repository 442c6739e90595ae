"""A budget as a number of experiments, episodes of full length; and the suite's names."""

import json

import pytest

import zoac
from stress import bad_inputs
from zoac.core.errors import ConfigError

STEPS = 200  # of an episode of lqr


def identity(folder):
    return json.loads((folder / "run.json").read_text())


def test_experiments_replace_the_budget(tmp_path):
    result = zoac.tune(
        task="lqr", tuner="random", experiments=20, episodes=1, final_episodes=1,
        folder=tmp_path, quiet=True,
    )  # fmt: skip
    assert identity(tmp_path)["config"]["budget"] == 20 * STEPS
    assert result.record["env_steps"] == 20 * STEPS


def test_the_command_line_has_them_too(tmp_path):
    code, out, _ = bad_inputs.answer(
        "task=lqr", "tuner=auto", "experiments=20", "num_envs=5",
        "evaluation.episodes=1", "evaluation.final_episodes=1", f"runs_dir={tmp_path}", "variant=v",
    )  # fmt: skip
    assert code == 0
    assert f"{20 * STEPS:,} steps" in out
    config = identity(tmp_path / "lqr/auto/seed=0/variant=v")["config"]
    assert (config["experiments"], config["budget"]) == (20, 20 * STEPS)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"experiments": 5, "budget": 1000}, "either budget or experiments"),
        ({"experiments": 0}, "experiments"),
        ({"experiments": "many"}, "experiments"),
        ({"experiments": 2.5}, "experiments"),
    ],
)
def test_other_numbers_are_refused(options, told):
    with pytest.raises(ConfigError, match=told):
        zoac.tune(task="lqr", quiet=True, **options)


@pytest.mark.parametrize("name", ["suite/lqrr", "lqrr"])
def test_an_unknown_task_lists_its_own_folder_and_no_other(name):
    _, message = bad_inputs.message(bad_inputs.Case(f"task={name}", ()))
    with pytest.raises(ConfigError) as raised:
        zoac.make_task(name)
    for told in (message, str(raised.value)):
        assert f"unknown task '{name}'; did you mean '{name[:-1]}'?" in told
        assert ("suite/water_tank" in told) == name.startswith("suite/")
        assert "pid_acc" in told
