"""The examples of `docs/add_a_tuner.md` keep what the page says of costs."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.support import CountingTask, engine
from zoac.core.tuner import Problem

PAGE = Path(__file__).parents[2] / "docs" / "add_a_tuner.md"


@pytest.mark.parametrize("name", ["HillClimber", "Climber"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_batch_of_bad_costs_alone_is_no_error_and_never_the_best(bad, name):
    names = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[:2]:
        exec(block, names)
    task = CountingTask()
    problem = Problem(
        task.space, observation_size=3, num_envs=2, budget=0, max_episode_steps=7, seed=0
    )
    tuner = names[name](problem)
    group = engine(task, [0, 1])
    for _ in range(2):
        segments = group.rollout(tuner.ask())
        tuner.tell([s.with_costs(np.full(s.length, bad)) for s in segments])
        assert tuner.recommend().tolist() == [0.0, 0.0]
    assert np.isfinite(tuner.tell(group.rollout(tuner.ask()))["best_seen"])
