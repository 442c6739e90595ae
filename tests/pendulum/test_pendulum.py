"""The plant is Gymnasium's; the controller does what it says."""

import gymnasium
import numpy as np
import pytest

from zoac.analysis.data.replay import costs
from zoac.tasks.pendulum import EnergyPd, Pendulum, PendulumVecEnv


def test_the_plant_is_gymnasiums():
    theirs, ours = gymnasium.make("Pendulum-v1").unwrapped, PendulumVecEnv(1)
    theirs.reset(seed=0)
    ours.reset(seed=[0])
    ours.arrays["angle"][0], ours.arrays["speed"][0] = theirs.state
    rng = np.random.default_rng(1)
    for _ in range(200):
        torque = rng.uniform(-3.0, 3.0, 1)
        seen, reward, *_ = theirs.step(torque)
        observations, rewards, *_ = ours.step(torque[None])
        np.testing.assert_allclose(observations[0], seen, atol=1e-5)  # theirs are float32
        assert rewards[0] == pytest.approx(reward, abs=1e-6)


@pytest.mark.parametrize(("option", "value"), [("mass", 1.5), ("length", 0.8)])
def test_mass_and_length_are_gymnasiums(option, value):
    theirs, ours = gymnasium.make("Pendulum-v1").unwrapped, PendulumVecEnv(1, **{option: value})
    setattr(theirs, {"mass": "m", "length": "l"}[option], value)
    theirs.reset(seed=0)
    ours.reset(seed=[0])
    ours.arrays["angle"][0], ours.arrays["speed"][0] = theirs.state
    seen, *_ = theirs.step(np.array([1.0]))
    np.testing.assert_allclose(ours.step(np.array([[1.0]]))[0][0], seen, atol=1e-6)


def test_the_hand_gains_swing_up_and_hold():
    task = Pendulum()
    env, controller = task.make_env(1), task.make_controller()
    params = {name: np.array([value]) for name, value in task.baseline.items()}
    obs, _ = env.reset(options={"demonstration": True})
    env.arrays["speed"][0] = 0.1
    for _ in range(200):
        obs, *_ = env.step(controller.act(params, obs, {})[0])
    assert obs[0, 0] > 0.99


def test_without_missing_energy_nothing_pushes():
    params = {"energy": np.ones(1), "kp": np.ones(1), "kd": np.ones(1), "switch": np.full(1, 0.1)}
    falling = np.array([[0.0, 1.0, np.sqrt(30.0)]])  # horizontal, with the energy of upright
    assert EnergyPd().act(params, falling, {})[0][0, 0] == pytest.approx(0.0, abs=1e-12)


def test_each_gain_matters_to_the_cost():
    task = Pendulum()
    start = task.space.normalise(task.baseline)
    points = np.stack([start, *(start + 0.3 * row for row in np.eye(4))])
    assert len(set(costs(task, points, 4, 0).mean(axis=1))) == 5
