"""A MuJoCo environment goes on from a restored state to the same bits."""

from pathlib import Path

import gymnasium
import mujoco  # of the extra `dev`
import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.utils import EzPickle
from gymnasium.wrappers import TimeLimit

import zoac
from tests import commands
from zoac.core.state import decode, encode
from zoac.envs.gymnasium_adapter import GymnasiumVecEnv
from zoac.envs.snapshots import is_mujoco, restored, saved, saved_by
from zoac.tasks.user_task import user_task

MODEL = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <geom type="plane" size="5 5 0.1"/>
    <body name="ball" pos="0 0 0.3">
      <joint name="slide" type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
      <joint type="hinge" axis="0 1 0"/>
      <geom type="sphere" size="0.1" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor joint="slide" gear="1"/></actuator>
</mujoco>
"""


class Ball(gymnasium.Env, EzPickle):
    """A ball that bounces and is pushed to a goal; like those of Gymnasium, built anew by copies.

    As Ant's and Humanoid's, its reward compares body positions before and after a step.
    """

    observation_space = Box(-np.inf, np.inf, (8,), np.float64)
    action_space = Box(-3.0, 3.0, (1,), np.float64)

    def __init__(self):
        EzPickle.__init__(self)
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.data = mujoco.MjData(self.model)
        self.goal = np.zeros(1)

    def _seen(self):
        return np.concatenate([self.data.qpos, self.data.qvel, self.goal, [self.data.time]])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.goal = self.np_random.uniform(0.5, 1.0, 1)
        self.data.qvel[:] = self.np_random.uniform(-0.1, 0.1, 3)
        mujoco.mj_forward(self.model, self.data)
        return self._seen(), {}

    def step(self, action):
        before = float(self.data.body("ball").xpos[0])
        self.data.ctrl[:] = action
        mujoco.mj_step(self.model, self.data, 3)
        moved = float(self.data.body("ball").xpos[0]) - before
        noise = 1e-3 * float(self.np_random.standard_normal())
        return self._seen(), moved + noise - abs(self.goal[0] - before), False, False, {}


class Gymnasiums(Ball):
    """With the method that Gymnasium's have, and a user's other one."""

    def set_state(self, qpos, qvel):
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel

    def get_state(self):
        return self.data.qpos, self.data.qvel


def pd(parameters, seen):
    return parameters["kp"] * (seen[6] - seen[0]) - parameters["kd"] * seen[3]


SPACE = {"kp": (0.0, 5.0), "kd": (0.0, 3.0)}


def made(kind=Ball):
    return TimeLimit(kind(), 60)


def played(env, steps):
    rows = [env.step(np.array([1.5 * np.sin(0.3 * k)])) for k in range(steps)]
    return [(seen.tobytes(), *rest) for seen, *rest in rows]


@pytest.mark.parametrize("kind", [Ball, Gymnasiums])
@pytest.mark.parametrize("before", [1, 20])  # in the air, and after it touched the ground
def test_it_continues_bit_for_bit_here_and_in_another_one(before, kind):
    env, other = made(kind), made(kind)
    env.reset(seed=1)
    played(env, before)
    state = saved(env)
    expected = played(env, 60 - before)
    assert expected[-1][3]  # the time limit
    env.reset(seed=2)
    other.reset(seed=3)
    played(other, 25)
    for one in (env, other, env):
        assert restored(one, state) is one
        assert played(one, 60 - before) == expected


def test_a_checkpoint_holds_it():
    env, other = (GymnasiumVecEnv([made()], None) for _ in range(2))
    env.reset(seed=[4])
    actions = [np.full((1, 1), np.cos(k)) for k in range(30)]
    for action in actions:
        env.step(action)
    state = decode(encode(env.state([0])))
    expected = [env.step(action)[:2] for action in actions[:20]]
    other.restore([0], state)
    for action, (seen, rewards) in zip(actions, expected, strict=False):
        found, given, *_ = other.step(action)
        assert found.tobytes() == seen.tobytes()
        assert given.tobytes() == rewards.tobytes()


def test_tuners_of_segments_tune_it_alike_in_one_process_and_in_several(forked_workers):
    task = user_task(env=made, controller=pd, space=SPACE)
    assert task.restore_fault is None
    assert task.save_fault is None
    results = [
        zoac.tune(task=task, tuner="zoac_plus", budget=800, eval_every=800, num_envs=2, episodes=1,
                  final_episodes=2, executor=executor, quiet=True)
        for executor in ("serial", "process")
    ]  # fmt: skip
    assert results[0].parameters == results[1].parameters
    assert results[0].cost_per_episode == results[1].cost_per_episode
    assert results[0].record["env_restarts"] == 0


def test_it_is_known_by_its_model_and_data():
    assert is_mujoco(Ball())
    assert saved_by(made()) == saved_by(made(Gymnasiums)) == "mj_getState()"
    other = Ball()
    other.data = {"qpos": 0.0}
    assert not is_mujoco(other)


def test_environments_without_it_do_not_import_it():
    script = """
import sys, gymnasium
from zoac.envs.snapshots import restored, saved
env = gymnasium.make("CartPole-v1")
env.reset(seed=0)
restored(env, saved(env))
assert "mujoco" not in sys.modules
"""
    commands.run("-c", script, cwd=Path(__file__).parents[2], check=True)
