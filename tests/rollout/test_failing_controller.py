"""A controller that fails: a message, or with a penalty a terminated episode."""

from contextlib import closing

import numpy as np
import pytest

import zoac
from tests.envs.test_adapters import Drift
from tests.support import CountingTask, EchoController, engine, proposal, same_segment
from zoac.core.errors import ConfigError, ControllerError
from zoac.rollout.executors.process import Process


class Failing(EchoController):
    """Fails in one of several ways where parameter a is above 8, from its third step on."""

    def __init__(self, way):
        self._way = way

    def act(self, params, obs, memory):
        actions, memory, diagnostics = super().act(params, obs, memory)
        bad = (params["a"] > 8) & (memory["count"] >= 3)
        if bad.any() and self._way == "raises":
            raise ArithmeticError("gain too high")
        if bad.any() and self._way == "wrong shape":
            return actions[:, :0], memory, diagnostics
        actions[bad] = {"NaN": np.nan, "infinity": np.inf}.get(self._way, 0.0)
        return actions, memory, diagnostics


class FailingTask(CountingTask):
    def __init__(self, way, penalty=50.0):
        super().__init__()
        self._way, self.failure_penalty = way, penalty

    def make_controller(self):
        return Failing(self._way)


WAYS = pytest.mark.parametrize("way", ["raises", "NaN", "infinity", "wrong shape"])


@WAYS
def test_with_a_penalty_the_episode_terminates_at_that_cost(way):
    group = engine(FailingTask(way), [0, 1])
    bad, good = group.rollout([proposal(0, a=9), proposal(1, a=5)])
    assert (bad.length, bad.terminated, bad.truncated) == (3, True, False)
    assert bad.costs[-1] == 50.0
    assert bad.actions[-1] == 0.0
    assert (good.length, good.terminated) == (7, False)
    (after,) = group.rollout([proposal(0, a=5, horizon=1)])
    assert after.starts_episode


@WAYS
def test_environments_beside_a_failing_one_do_not_notice(way):
    (_, beside) = engine(FailingTask(way), [0, 1]).rollout([proposal(0, a=9), proposal(1)])
    assert same_segment(beside, engine(FailingTask(way), [1]).rollout([proposal(1)])[0])


def test_processes_give_the_bits_of_serial(forked_workers):
    plan = [proposal(env_index, a=a) for a in (9, 5) for env_index in (0, 1, 2)]
    serial = engine(FailingTask("raises"), [0, 1, 2]).rollout(plan)
    with closing(Process(workers=2)) as executor:
        executor.start(FailingTask("raises"), 3, seed=0)
        for one, two in zip(executor.rollout(plan), serial, strict=True):
            assert same_segment(one, two)


@WAYS
def test_without_one_it_ends_the_run_with_its_place(way):
    with pytest.raises(ControllerError, match="controller"):
        engine(FailingTask(way, penalty=None), [0]).rollout([proposal(0, a=9)])


def fails_at_once(params, obs):
    return float("nan") if params["k"] > 1.5 else -params["k"] * obs[0]


def test_tune_survives_bad_gains():
    options = {
        "env": Drift, "controller": fails_at_once, "space": {"k": (0, 2)}, "budget": 300,
        "num_envs": 2, "episodes": 1, "final_episodes": 2, "quiet": True, "max_episode_steps": 10,
        "tuner": "zoac",
    }  # fmt: skip
    result = zoac.tune(**options, failure_penalty=100.0)
    assert np.isfinite(result.cost_mean)
    with pytest.raises(ControllerError, match="every number must be finite.*k="):
        zoac.tune(**options)
    with pytest.raises(ConfigError, match="failure_penalty=nan: input should be a finite number"):
        zoac.tune(**options, failure_penalty=float("nan"))
