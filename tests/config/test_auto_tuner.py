"""What `tuner="auto"` stands for."""

import numpy as np
import pytest

import zoac
from tests.support import CountingTask
from zoac import specs
from zoac.config import auto_tuner
from zoac.config.auto_tuner import settled, tuner_for
from zoac.config.compose import compose_config, resolved
from zoac.core.errors import ConfigError
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.runs import schema
from zoac.runs.training.lifecycle import run_session


def task(dimension, with_specs=False):
    made = CountingTask(10)
    made.space = ParameterSpace([Parameter(f"p{k}", 0.0, 1.0) for k in range(dimension)])
    made.specs = (specs.peak("y", max=1.0),) if with_specs else ()
    return made


@pytest.mark.parametrize(
    ("dimension", "with_specs", "name"),
    [
        (2, False, "cmaes_plus"),
        (20, False, "cmaes_plus"),
        (21, False, "zoac_plus"),
        (1, False, "nevergrad"),
        (2, True, "cmaes_full"),
        (1, True, "nevergrad"),
    ],
)
def test_it_is_chosen_by_parameters_and_specs(dimension, with_specs, name):
    chosen = tuner_for(task(dimension, with_specs))
    assert chosen.tuner == name
    common = name != "zoac_plus" and not with_specs
    assert chosen.settings == ({"common_random_numbers": True} if common else {})


OPTIONS = (
    "task=lqr", "tuner=auto", "num_envs=10", "evaluation.episodes=1", "evaluation.final_episodes=2"
)  # fmt: skip


def on_the_command_line(folder, *overrides):
    config = resolved(compose_config([*OPTIONS, f"runs_dir={folder}", *overrides]))
    return run_session(config, task="lqr", tuner="auto", command=[])


def test_it_is_the_default_and_the_command_line_does_and_tells_the_same(tmp_path, capsys):
    record = on_the_command_line(tmp_path, "budget=20000")
    twin = zoac.tune(
        task="lqr", budget=20_000, num_envs=10, quiet=True, episodes=1, final_episodes=2
    )
    assert np.isfinite(twin.cost_mean)
    assert record["parameters"] == twin.parameters
    assert record["parameters"] != zoac.make_task("lqr").baseline
    assert zoac.load_result(twin.folder).record["tuner"] == "cmaes_plus"
    told = "cmaes_plus with common random numbers, for 2 parameters"
    of_command = schema.read_run(tmp_path / "lqr" / "auto" / "seed=0")
    for run in (of_command, schema.read_run(twin.folder)):
        assert run["tuner_choices"]["auto"] == told
    assert of_command["config"]["tuner"]["_target_"].endswith("CmaEs")
    assert capsys.readouterr().out.splitlines()[1] == f"  auto: {told}"


def test_the_choice_has_the_options_that_suit_the_task_and_the_fidelity(monkeypatch):
    monkeypatch.setattr(auto_tuner, "MAX_COORDINATES", 3)
    config = resolved(compose_config(["task=pid_acc", "tuner=auto", "budget=5000"]))
    groups = {"task": "pid_acc", "tuner": "auto", "fidelity": "authors_code"}
    found, choice = settled(config, zoac.make_task("pid_acc"), groups)
    assert choice.tuner == "zoac_plus"
    named = ["task=pid_acc", "tuner=zoac_plus", "fidelity=authors_code"]
    assert found["tuner"] == resolved(compose_config(named))["tuner"]
    assert found["tuner"] != resolved(compose_config(["task=lqr", "tuner=zoac_plus"]))["tuner"]


def test_what_the_user_sets_stays_and_options_of_no_tuner_are_refused(tmp_path):
    config = resolved(compose_config([*OPTIONS, "common_random_numbers=false"]))
    task, groups = zoac.make_task("lqr"), {"task": "lqr", "tuner": "auto"}
    assert settled(config, task, groups)[0]["common_random_numbers"] is False
    with pytest.raises(ConfigError, match="tuner.population: tuner=auto has no options"):
        on_the_command_line(tmp_path, "+tuner.population=5")
