"""An environment with `get_state` and `set_state` is saved by them, its wrappers with it."""

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.wrappers import TimeLimit

import zoac
from zoac.envs.snapshots import restored, saved
from zoac.tasks.user_task import user_task

SHARED = {"copies": 0, "saves": 0}


class Handle:
    """Something outside Python's memory, which cannot be copied."""

    def __init__(self):
        self.x = 0.0

    def __deepcopy__(self, memo):
        raise TypeError("a handle cannot be copied")


class Server(gymnasium.Env):
    """An integrator with noise, whose state lies behind a handle."""

    observation_space = Box(-np.inf, np.inf, (1,), np.float64)
    action_space = Box(-2.0, 2.0, (1,), np.float64)

    def __init__(self):
        self.handle = Handle()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.handle.x = self.np_random.uniform(0.5, 1.5)
        return np.array([self.handle.x]), {}

    def step(self, action):
        self.handle.x += 0.1 * float(action[0]) + 0.01 * self.np_random.standard_normal()
        return np.array([self.handle.x]), -(self.handle.x**2), False, False, {}


class Restorable(Server):
    """The same with a documented way to save it."""

    def get_state(self):
        SHARED["saves"] += 1
        return {"x": self.handle.x}

    def set_state(self, state):
        self.handle.x = state["x"]


class Forgetful(Restorable):
    """One whose `get_state` leaves out what counts."""

    def set_state(self, state):
        pass


class Copied(Server):
    """The same without a handle."""

    def __init__(self):
        self.handle = type("Plain", (), {})()


def p(parameters, seen):
    return -parameters["k"] * seen


def made(kind):
    return TimeLimit(kind(), 30)


def task(kind):
    return user_task(env=lambda: made(kind), controller=p, space={"k": (0.0, 5.0)})


def test_it_makes_segments_possible_where_copies_are_not():
    assert "a handle cannot be copied" in task(Server).restore_fault
    assert task(Restorable).restore_fault is None
    assert task(Restorable).save_fault is None


def test_what_it_leaves_out_is_noticed_and_named():
    assert "get_state() misses a part" in task(Forgetful).restore_fault


def test_the_wrappers_and_the_random_generator_are_saved_too():
    env = made(Restorable)
    env.reset(seed=3)
    for _ in range(10):
        env.step([0.5])
    state = saved(env)
    expected = [env.step([0.5]) for _ in range(20)]
    assert expected[-1][3]  # the time limit
    env.reset(seed=4)
    other = made(Restorable)
    other.reset(seed=5)
    for one in (env, other):
        found = restored(one, state)
        assert found is one
        for (obs, *rest), (seen, *others) in zip(expected, [found.step([0.5]) for _ in range(20)],
                                                 strict=True):  # fmt: skip
            assert obs.tolist() == seen.tolist()
            assert rest == others


@pytest.mark.parametrize("tuner", ["zoac", "zoac_plus"])
def test_a_run_is_the_same_as_with_copies(tuner):
    def tuned(kind):
        return zoac.tune(env=lambda: made(kind), controller=p, space={"k": (0.0, 5.0)},
                         tuner=tuner, budget=600, eval_every=600, num_envs=2, episodes=1,
                         final_episodes=2, quiet=True)  # fmt: skip

    SHARED["saves"] = 0
    result = tuned(Restorable)
    assert SHARED["saves"] > 0
    assert result.parameters == tuned(Copied).parameters
    assert result.record["env_restarts"] == 0


class Late(Copied):
    """Has a state to save only after its first reset, which depends on a number of the plant."""

    gain = 1.0

    def reset(self, *, seed=None, options=None):
        observation, info = super().reset(seed=seed)
        self.x = observation[0]
        return observation, info

    def step(self, action):
        self.x += 0.1 * self.gain * float(action[0])
        return np.array([self.x]), -(self.x**2), False, False, {}

    def get_state(self):
        return self.x

    def set_state(self, state):
        self.x = state


def test_an_environment_that_was_never_reset_is_saved_as_such():
    env, twin = (task(Late).make_env(2) for _ in range(2))
    env.reset(seed=[1, 2], options={"reset_mask": np.array([True, False])})
    state = env.state([0, 1])
    twin.restore([0, 1], state)
    for one in (env, twin):
        one.reset(seed=[3, 4], options={"reset_mask": np.array([False, True])})
    steps = [one.step(np.ones((2, 1)))[0] for one in (env, twin)]
    assert np.array_equal(*steps)


def test_numbers_that_an_episode_drew_are_saved_beside_what_get_state_returns():
    varied = user_task(
        env=lambda: made(Late), controller=p, space={"k": (0.0, 5.0)}, vary={"gain": (0.5, 2.0)}
    )
    assert varied.restore_fault is None
    env = varied.make_env(1)
    env.reset(seed=[1])
    state = env.state([0])
    expected = env.step(np.ones((1, 1)))[0]
    env.reset(seed=[2])
    env.restore([0], state)
    assert np.array_equal(env.step(np.ones((1, 1)))[0], expected)
