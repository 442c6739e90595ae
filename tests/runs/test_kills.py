"""`stress.kills` reaches every task and tuner; its kills themselves take an hour."""

import itertools

import pytest

from stress import kills
from zoac.config.compose import compose_config, resolved

# Every task, and every tuner that has options; without them no key of a tuner is named.
PAIRS = list(zip(kills.choices("task"), itertools.cycle([*kills.SHORT, "random"]), strict=False))


def test_there_is_a_task_for_every_tuner_with_options():
    assert set(kills.SHORT) <= {tuner for _, tuner in PAIRS}


@pytest.mark.parametrize(("task", "tuner"), PAIRS)
def test_a_short_run_can_be_composed(task, tuner):
    config = resolved(compose_config(kills.overrides(task, tuner)))
    assert (config["budget"], config["task"]["max_episode_steps"]) == (3000, 40)
