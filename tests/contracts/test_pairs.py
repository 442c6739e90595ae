"""Every tuner and every task, both found by their YAML files, through the trainer."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from tests.support import needs_its_library
from zoac.config import factory
from zoac.config.files import configuration
from zoac.runs.schema import read_metrics
from zoac.runs.training.lifecycle import Run, execute

CONF = Path(__file__).parents[2] / "conf"
NUM_ENVS, STEPS, BUDGET = 2, 12, 100


def names(group):
    """The files of a group; a task without an environment has tests of its own."""
    return sorted(p.stem for p in (CONF / group).glob("*.yaml") if p.stem != "program")


def pairs():
    """Every tuner on one task, segments on every task, and all that have a preset.

    Whole episodes of every task, and its baseline, are those of the evaluations.
    """
    of_one = product(["lqr"], names("tuner"))
    of_all = product(names("task"), ["zoac_plus"])
    presets = [(p.parent.name, p.stem) for p in (CONF / "preset").glob("*/*.yaml")]
    return sorted({*of_one, *of_all, *presets})


def configured(task, tuner, **settings):
    """Return the configuration of a short run: what the command line would compose."""
    config = configuration(task=task, tuner=tuner, mpc_solver="riccati")
    needs_its_library(config["tuner"]["_target_"])
    config["task"]["max_episode_steps"] = STEPS
    config["evaluation"] |= {"episodes": 2, "final_episodes": 2}
    return config | {"num_envs": NUM_ENVS, **settings}


@pytest.mark.parametrize(("task", "tuner"), pairs())
def test_a_small_run_keeps_its_budget_and_recommends_inside_the_box(tuner, task, tmp_path):
    config = configured(task, tuner, budget=BUDGET, eval_every=50, checkpoint_seconds=0)
    the_task, identity = factory.build_task(config), {"task": task, "tuner": tuner, "seed": 0}
    run = Run(config, the_task, identity=identity, command=[], loggers=[])
    batches = []
    ask = run.tuner.ask

    def counted():
        proposals = ask()
        batches.append(sum(min(p.horizon or STEPS, STEPS) for p in proposals))
        return proposals

    run.tuner.ask = counted
    assert all(isinstance(key, str) for key in run.tuner.describe())
    result = execute(run, tmp_path)
    if tuner == "nominal":
        assert result["env_steps"] == 0
    else:
        assert BUDGET <= result["env_steps"] < BUDGET + max(batches)
    assert np.isfinite(result["cost_mean"])
    assert np.abs(result["x"]).max() <= 1.0
    for p in the_task.space.parameters:
        value = result["parameters"][p.name]
        assert value in p.options if p.options else p.low <= value <= p.high
    rows = read_metrics(tmp_path)
    assert all(np.isfinite(v) for row in rows for v in row.values() if isinstance(v, float))
