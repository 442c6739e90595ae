"""`fidelity=authors_code` against an independent learner that follows the released rules."""

import copy
from functools import cache
from typing import get_type_hints

import numpy as np
import pytest

from tests.algorithm.released_rules import (
    EPOCHS,
    RULES,
    SEGMENTS,
    WORKERS,
    ReleasedLearner,
)  # fmt: skip
from tests.algorithm.support import torch_twin
from tests.support import engine
from zoac.algorithm.zoac import Zoac
from zoac.config.compose import compose_config, resolved
from zoac.config.validate import with_groups
from zoac.core.tuner import Problem
from zoac.tasks.pid_acc import PidAcc, PidAccVecEnv

LIMIT = 35
"""Steps of an episode: no multiple of a segment's ten, so that the time limit cuts segments."""

START = np.array([0.97, -0.99, 0.5, -0.98])
"""Near the edges of the box, with gains that saturate u and end some episodes in a termination."""


@cache
def released_switches():
    """The options of ZOAC under `fidelity=authors_code`, from the command line's configuration."""
    config = resolved(compose_config(["task=pid_acc", "tuner=zoac", "fidelity=authors_code"]))
    options = {key: value for key, value in config["tuner"].items() if key != "_target_"}
    return options, config["task"]["jerk"]


class RecordedEnv(PidAccVecEnv):
    """Keeps what the preceding car does in each episode, which is the experiment's input."""

    def _start(self, env_index, rng, demonstration):
        super()._start(env_index, rng, demonstration)
        self.drawn[env_index].append(self.arrays["preceding"][env_index].copy())


class RecordedTask(PidAcc):
    """Short episodes with strong disturbances."""

    def __init__(self, jerk):
        super().__init__()
        self._jerk, self.drawn = jerk, [[] for _ in range(WORKERS)]

    def make_env(self, n):
        env = RecordedEnv(n, preceding_std=0.3, jerk=self._jerk, max_episode_steps=LIMIT)
        env.drawn = self.drawn
        return env


def compare(iterations, broken=None, **changes):
    """Run both learners side by side and compare all that an iteration computes."""
    options, jerk = copy.deepcopy(released_switches())
    task = RecordedTask(jerk)
    group = engine(task, list(range(WORKERS)), seed=5)
    options["critic"] |= changes
    groups = with_groups(options, get_type_hints(Zoac.__init__))
    ours = Zoac(Problem(task.space, 10, WORKERS, 10**6, LIMIT, 3), **groups)
    ours._theta = START.copy()
    theirs = ReleasedLearner(START, torch_twin(ours._critic), LIMIT, task.drawn, broken)
    ends = []
    for _ in range(iterations):
        segments = group.rollout(ours.ask())
        ends += [(s.terminated, s.truncated, (s.actions != s.commands).any()) for s in segments]
        states = sum(s.length for s in segments)
        stream = copy.deepcopy(ours._critic._rng)
        orders = [stream.permutation(states) for _ in range(EPOCHS)]
        metrics = ours.tell(segments)
        targets = ours._pending[1]
        noise = ours._directions.reshape(SEGMENTS, WORKERS, -1)
        pieces, advantages, expected = theirs.iterate(noise, orders)
        assert [len(piece.costs) for piece in pieces] == [s.length for s in segments]
        for piece, segment in zip(pieces, segments, strict=True):
            np.testing.assert_allclose(segment.observations, piece.states, atol=1e-9)
            np.testing.assert_allclose(segment.costs, piece.costs, rtol=1e-9, atol=1e-9)
        assert metrics["advantage_mean"] == pytest.approx(advantages.mean(), rel=1e-5)
        assert metrics["advantage_std"] == pytest.approx(advantages.std(), rel=1e-5)
        np.testing.assert_allclose(targets, expected, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(ours._theta, theirs.theta, atol=2e-6)
        theirs.theta = ours._theta.copy()  # a limit cycle would amplify the last digits
        ours.background_update()
        for (matrix, bias), linear in zip(ours._critic._layers, theirs.critic[::2], strict=True):
            np.testing.assert_allclose(matrix.t(), linear.weight.detach(), atol=2e-5)
            np.testing.assert_allclose(bias, linear.bias.detach(), atol=2e-5)
    return np.array(ends)


def test_three_iterations_are_those_of_the_released_rules():
    ends = compare(3)
    assert ends.any(axis=0).all()  # terminations, time limits and saturated increments are among it


@pytest.mark.parametrize("rule", RULES)
def test_every_rule_is_seen(rule):
    with pytest.raises(AssertionError):
        compare(3, broken=rule, hidden=(16, 16))  # sooner than the released size
