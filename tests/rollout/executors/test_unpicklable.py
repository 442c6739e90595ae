"""An environment that cannot be saved: it is said, and a resume begins new episodes."""

import copy
import json
import threading

import numpy as np
import pytest
from gymnasium.wrappers import TransformReward

import zoac
from tests.envs.test_adapters import Drift
from tests.rollout.test_probe import Rebuilt
from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.runs import checkpoint
from zoac.tasks.user_task import user_task


def proportional(params, obs):
    return -params["k"] * obs[0]


def tune(folder, env, **options):
    return zoac.tune(**{
        "env": env, "controller": proportional, "space": {"k": (0, 2)}, "budget": 200,
        "num_envs": 2, "tuner": "zoac", "tuner_options": {"critic": {"hidden": [8], "epochs": 1}},
        "eval_every": 400, "episodes": 1, "final_episodes": 2, "quiet": True,
        "max_episode_steps": 10, "folder": folder, **options,
    })  # fmt: skip


class Unpicklable(Drift):
    def __reduce_ex__(self, protocol):
        raise TypeError("no pickle takes it")

    def __deepcopy__(self, memo):
        twin = Unpicklable()
        twin.__dict__.update(copy.deepcopy(self.__dict__, memo))
        return twin


def local_env():
    """Make one of Gymnasium's wrappers around a class of this function."""

    class Local(Drift):
        def __init__(self):
            self.noise = lambda: 0.0

    return TransformReward(Local(), lambda reward: 2.0 * reward)


class Locked(Drift):
    """Holds a lock from a step of an episode on; from -1 on: from the reset."""

    since = -1

    def reset(self, **options):
        self.steps = 0
        self._lock()
        return super().reset(**options)

    def step(self, action):
        self._lock()
        self.steps += 1
        return super().step(action)

    def _lock(self):
        if self.steps > self.since:
            self.lock = threading.Lock()


class LockedLate(Locked):
    """Later than is tried at the start."""

    since = 40

    def step(self, action):
        observation, reward, _, _, info = super().step(action)
        return observation, reward, False, False, info


def stopped(stopping, folder, env, **options):
    """Tune, and stop after the second iteration as by Ctrl-C."""
    stopping(1)
    with pytest.raises(KeyboardInterrupt):
        tune(folder, env, **options)
    stopping(None)


class UnpicklableLate(LockedLate):
    """Can still be copied then."""

    def _lock(self):
        if self.steps > self.since:
            self.part = Unpicklable()


LATE = {"max_episode_steps": 200, "budget": 800}


@pytest.mark.parametrize(
    ("env", "options"),
    [
        (Unpicklable, {}),
        (Rebuilt, {}),
        (Locked, {}),
        (LockedLate, LATE),
        (UnpicklableLate, LATE),
        (LockedLate, {**LATE, "executor": "process"}),
    ],
)
def test_it_is_said_once_and_counted_in_the_result(
    tmp_path, stopping, forked_workers, capsys, env, options
):
    stopped(stopping, tmp_path / "run", env, **options)
    assert capsys.readouterr().err.count("cannot be saved") == 1
    state, _ = checkpoint.load(tmp_path / "run" / "checkpoint")
    assert state["num_envs"] is None
    tune(tmp_path / "run", env, **options)
    assert json.loads((tmp_path / "run" / "result.json").read_text())["env_restarts"] == 1


def test_an_environment_that_cannot_be_copied_any_more_is_tuned_on(tmp_path, capsys):
    options = {
        **LATE,
        "tuner": "zoac_plus",
        "budget": 4000,
        "space": {"k": (0, 2), "other": (0, 1)},
    }
    result = tune(tmp_path / "run", LockedLate, **options)
    assert 3000 < result.env_steps <= 4000
    assert (
        "an environment cannot be copied any more (TypeError: cannot pickle"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("env", [Drift, local_env])
def test_one_that_can_be_saved_is_not_restarted(tmp_path, stopping, capsys, env):
    stopped(stopping, tmp_path / "run", env)
    assert "cannot be saved" not in capsys.readouterr().err
    tune(tmp_path / "run", env)
    assert json.loads((tmp_path / "run" / "result.json").read_text())["env_restarts"] == 0


class Bolted(Drift):
    """Cannot be copied at all."""

    def __deepcopy__(self, memo):
        raise TypeError("bolted to the bench")


@pytest.mark.parametrize("tuner", ["zoac", "zoac_plus", "cmaes"])
def test_an_environment_that_cannot_even_be_copied_is_tuned(tmp_path, tuner):
    result = zoac.tune(
        env=Bolted, controller=proportional, space={"k": (0, 2), "other": (0, 1)}, tuner=tuner,
        budget=400, num_envs=2, episodes=1, final_episodes=2, quiet=True, max_episode_steps=10,
        folder=tmp_path / "run",
    )  # fmt: skip
    assert result.env_steps >= 400


def test_after_a_seeded_run_its_environment_begins_an_episode_of_its_own():
    space = {"k": (0.0, 2.0)}
    task = user_task(env=Bolted, controller=proportional, space=space, max_episode_steps=10)
    x = np.zeros(1)

    def after(seed):
        group = RolloutEngine(task, [0], [1])
        own = [Proposal(x, 0, horizon=3), Proposal(x, 0, horizon=3)]
        return group.rollout([Proposal(x, 0, horizon=3, seed=seed), *own])[1:]

    one, two = after(7)
    assert (one.starts_episode, two.starts_episode) == (True, False)
    assert np.array_equal(one.observations, after(8)[0].observations)
