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


def test_it_is_the_default_and_the_tuner_it_chose_is_recorded():
    result = zoac.tune(task="lqr", budget=40_000, quiet=True, final_episodes=2)
    assert np.isfinite(result.cost_mean)
    assert zoac.load_result(result.folder).record["tuner"] == "cmaes_plus"
    told = schema.read_run(result.folder)["tuner_choices"]["auto"]
    assert told == "cmaes_plus with common random numbers, for 2 parameters"


OPTIONS = ("task=lqr", "tuner=auto", "eval_every=20000", "evaluation.final_episodes=2")


def on_the_command_line(folder, *overrides):
    config = resolved(compose_config([*OPTIONS, f"runs_dir={folder}", *overrides]))
    return run_session(config, task="lqr", tuner="auto", command=[])


def test_the_command_line_follows_the_same_rule_and_says_so_in_its_first_lines(tmp_path, capsys):
    record = on_the_command_line(tmp_path, "budget=40000")
    twin = zoac.tune(task="lqr", budget=40_000, eval_every=20_000, quiet=True, final_episodes=2)
    assert record["parameters"] == twin.parameters
    run = schema.read_run(tmp_path / "lqr" / "auto" / "seed=0")
    told = "cmaes_plus with common random numbers, for 2 parameters"
    assert run["tuner_choices"]["auto"] == told
    assert run["config"]["tuner"]["_target_"].endswith("CmaEs")
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
