import gymnasium
import numpy as np
import pytest

import zoac  # noqa: F401 (registers the environments)
from zoac.core.errors import ConfigError
from zoac.tasks.pid_acc import PidAccVecEnv

IDS = ["zoac/PidAcc-v0", "zoac/MpcTracking-v0"]


@pytest.mark.parametrize("env_id", IDS)
def test_the_picture_follows_the_plant(env_id):
    env = gymnasium.make(env_id, render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    assert (first.ndim, first.shape[2], first.dtype) == (3, 3, np.uint8)
    assert np.array_equal(first, env.render())
    for _ in range(5):
        env.step(env.action_space.high)
    assert not np.array_equal(first, env.render())


@pytest.mark.parametrize("env_id", IDS)
def test_every_environment_has_its_picture(env_id):
    envs = gymnasium.make_vec(env_id, num_envs=2, render_mode="rgb_array")
    envs.reset(seed=0)
    assert len(envs.render()) == 2


def test_without_a_render_mode_there_is_no_picture():
    env = gymnasium.make(IDS[0])
    env.reset(seed=0)
    assert env.unwrapped.render() is None


def test_an_unknown_render_mode_gets_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'rgb_array'"):
        PidAccVecEnv(render_mode="rgb_arry")
