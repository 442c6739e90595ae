"""`stress.kills` reaches every task and tuner; its kills themselves take an hour."""

import pytest

from stress import kills
from zoac.config.compose import compose_config, resolved


@pytest.mark.parametrize("task", kills.choices("task"))
def test_a_short_run_of_every_task_can_be_composed(task):
    assert (
        resolved(compose_config(kills.overrides(task, "zoac")))["task"]["max_episode_steps"] == 40
    )


@pytest.mark.parametrize("tuner", kills.choices("tuner"))
def test_a_short_run_of_every_tuner_can_be_composed(tuner):
    assert resolved(compose_config(kills.overrides("pid_acc", tuner)))["budget"] == 3000
