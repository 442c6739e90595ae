"""`stress.kills` reaches every task and tuner; its kills themselves take an hour."""

import itertools

import pytest

from stress import kills
from zoac.config.compose import compose_config, resolved

TASKS, TUNERS = kills.choices("task"), kills.choices("tuner")
PAIRS = list(zip(itertools.cycle(TASKS), TUNERS, strict=False))


def test_pairs_reach_every_task():
    assert {task for task, _ in PAIRS} == set(TASKS)


@pytest.mark.parametrize(("task", "tuner"), PAIRS)
def test_a_short_run_of_every_task_and_tuner_can_be_composed(task, tuner):
    config = resolved(compose_config(kills.overrides(task, tuner)))
    assert (config["budget"], config["task"]["max_episode_steps"]) == (3000, 40)
