"""Metrics, constraints and figures see what the actuator did, not what it was told."""

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete
from gymnasium.wrappers import ClipAction, RescaleAction, TimeLimit

import zoac
from tests.envs.test_adapters import Drift
from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.lane_change.plant import LaneChangeVecEnv
from zoac.tasks.pendulum.plant import PendulumVecEnv
from zoac.tasks.pid_acc.plant import PidAccVecEnv
from zoac.tasks.user_task import user_task


class Weak(Drift):
    """Its actuator reaches 0.3, and it counts the energy that is spent."""

    action_space = Box(-0.3, 0.3, (1,), np.float32)
    spent = 0.0

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        self.spent += float(action[0]) ** 2
        return observation, reward, terminated, truncated, {**info, "spent": self.spent}


def segment_of(env, command):
    task = user_task(
        env=env, controller=lambda p, o: command, space={"k": (0, 1)}, max_episode_steps=4
    )
    group = RolloutEngine(task, [0], [0])
    (segment,) = group.rollout([Proposal(np.zeros(1), 0)])
    return segment, group._env._envs[0]


def test_the_energy_of_a_metric_is_what_the_actuator_spent():
    seen = {}

    def energy(segment):
        seen["commands"] = segment.commands[:, 0]
        return segment.actions[:, 0] ** 2

    env = Weak()
    result = zoac.tune(
        env=env, controller=lambda p, o: -p["k"] * o[0], space={"k": (2, 3)}, budget=0, num_envs=1,
        tuner="nominal", baseline={"k": 3.0}, episodes=1, final_episodes=1, max_episode_steps=30,
        metrics={"energy": energy}, quiet=True,
    )  # fmt: skip
    assert result.record["energy"] <= 0.09 + 1e-6
    assert np.abs(seen["commands"]).max() > 0.3
    segment, plant = segment_of(Weak, 5.0)
    assert (segment.actions[:, 0] ** 2).sum() == plant.spent


def test_a_constraint_on_the_action_holds_where_the_actuator_keeps_it():
    result = zoac.tune(
        env=Weak, controller=lambda p, o: -p["k"] * o[0], space={"k": (2, 3)}, budget=0, num_envs=1,
        tuner="random", episodes=1, final_episodes=2, max_episode_steps=30, quiet=True,
        constraints={"force": lambda s: np.abs(s.actions[:, 0]) - 0.31},
    )  # fmt: skip
    assert result.record["violations"] == 0


class Switched(Drift):
    action_space = Discrete(3, start=-1)

    def step(self, action):
        return super().step(np.array([action]))


@pytest.mark.parametrize(
    ("env", "command", "applied"),
    [
        (Weak, 0.1, float(np.float32(0.1))),
        (Weak, -7.0, -float(np.float32(0.3))),
        (Switched, 0.4, 0.0),
        (Switched, 7.0, 1.0),
        (lambda: ClipAction(Weak()), 7.0, float(np.float32(0.3))),
        (lambda: TimeLimit(ClipAction(TimeLimit(Weak(), 9)), 9), 7.0, float(np.float32(0.3))),
        (lambda: RescaleAction(Weak(), np.float32(-1), np.float32(1)), 0.5, 0.5),
    ],
)
def test_both_what_was_said_and_what_was_done_are_kept(env, command, applied):
    segment, _ = segment_of(env, command)
    assert segment.commands[:, 0].tolist() == [command] * segment.length
    assert segment.actions[:, 0].tolist() == [applied] * segment.length


class Doubling(gymnasium.Wrapper):
    """Takes its actions in other units than what it wraps."""

    def step(self, action):
        return self.env.step(action / 2)


def test_a_wrapper_that_may_change_units_is_not_looked_through():
    segment, plant = segment_of(lambda: Doubling(ClipAction(Weak())), 0.5)
    assert segment.actions[:, 0].tolist() == [0.5] * 4
    assert plant.unwrapped.last_action == np.float32(0.25)


def applied(envs, *commands):
    envs.reset(seed=0)
    return [envs.step(np.array([c]))[4]["actions"][0].tolist() for c in commands]


def test_built_in_plants_tell_what_they_applied():
    assert applied(PendulumVecEnv(), [5.0], [-1.0]) == [[2.0], [-1.0]]
    assert applied(LaneChangeVecEnv(), [9.0, 0.6], [-9.0, 0.4]) == [[2.0, 1.0], [-6.0, 0.0]]
    # Car following: an increment of a command that saturates at 0.6 itself.
    first, second, third = (a for (a,) in applied(PidAccVecEnv(), [0.4], [0.4], [0.4]))
    assert (first, second, third) == (0.4, pytest.approx(0.2), 0.0)
