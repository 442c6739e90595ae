"""The examples of the pages about tuners keep what the pages say of costs and states."""

import re
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

from tests.support import CountingTask, engine
from zoac.core.tuner import Problem

DOCS = Path(__file__).parents[2] / "docs"
NAMES = {"HillClimber": "add_a_tuner", "Climber": "add_a_tuner",
         "Cma": "wrap_an_optimiser", "NelderMead": "wrap_an_optimiser"}  # fmt: skip


def made(name):
    names = {}
    page = (DOCS / f"{NAMES[name]}.md").read_text()
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL)[:2]:
        exec(block, names)
    task = CountingTask()
    problem = Problem(
        task.space, observation_size=3, num_envs=2, budget=0, max_episode_steps=7, seed=0
    )
    return names[name](problem), engine(task, [0, 1])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_batch_of_bad_costs_alone_is_no_error_and_never_the_best(bad, name):
    tuner, group = made(name)
    for _ in range(2):
        segments = group.rollout(tuner.ask())
        tuner.tell([s.with_costs(np.full(s.length, bad)) for s in segments])
        assert tuner.recommend().tolist() == [0.0, 0.0]  # none is the best
    assert np.isfinite(tuner.tell(group.rollout(tuner.ask()))["best_seen"])


@pytest.mark.parametrize("name", NAMES)
def test_a_restored_tuner_asks_for_the_same(name):
    (tuner, group), (twin, _) = made(name), made(name)
    for _ in range(4):
        tuner.tell(group.rollout(tuner.ask()))
    twin.restore(deepcopy(tuner.state()))
    ours, theirs = tuner.ask(), twin.ask()
    assert [p.x.tolist() for p in ours] == [p.x.tolist() for p in theirs]
    tuner.tell(group.rollout(ours))
    assert len(twin.ask()) == len(theirs)  # they share nothing
