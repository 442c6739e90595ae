"""Linear loops against a fine simulation in continuous time and against python-control."""

import math

import numpy as np
import pytest

from zoac.core.errors import ConfigError
from zoac.envs.linear_loop import LoopVecEnv, sampled

control = pytest.importorskip("control")

PLANTS = {
    "two lags": ([2.0], [0.1, 0.7, 1.0], 0.1),
    "fractional dead time": ([1.0], [1.0, 1.0], 0.33),
    "less than a sample": ([1.0], [1.0, 1.0], 0.02),
    "none": ([1.0], [1.0, 0.4, 1.0], 0.0),
    "integrating": ([0.5], [1.0, 0.0], 0.47),
    "inverse response": ([-0.5, 1.0], [1.0, 2.0, 1.0], 0.12),
    "unstable": ([1.0], [1.0, -1.0], 0.26),
    "feedthrough": ([1.0, 2.0], [1.0, 1.0], 0.13),
}
SAMPLE_TIME = 0.05
FINE = 50
"""Steps of the fine simulation within one sample."""


def fine(plant, dead_time, inputs):
    """Return outputs at the samples by a Runge-Kutta integration with an explicit delay line."""
    space = control.ss(plant)
    h = SAMPLE_TIME / FINE
    held = np.repeat(inputs, FINE)
    lag = round(dead_time / h)
    delayed = np.concatenate([np.zeros(lag), held])[: len(held) + 1]
    x, outputs = np.zeros(space.nstates), []
    for k, u in enumerate(delayed):
        if k % FINE == 0:
            outputs.append(space.C[0] @ x + space.D[0, 0] * u)

        def slope(x, u=u):
            return space.A @ x + space.B[:, 0] * u

        k1 = slope(x)
        k2 = slope(x + h / 2 * k1)
        k3 = slope(x + h / 2 * k2)
        k4 = slope(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.array(outputs)


def environment(plants, n=1, **options):
    options = {"max_episode_steps": 60, "load_at": 60, **options}
    return LoopVecEnv(plants, n, **options)


@pytest.mark.parametrize("name", PLANTS)
def test_outputs_are_those_of_a_fine_simulation(name):
    numerator, denominator, dead_time = PLANTS[name]
    plant = control.tf(numerator, denominator)
    inputs = np.random.default_rng(0).uniform(-1, 1, 60)
    env = environment([sampled(plant, SAMPLE_TIME, dead_time)])
    env.reset(seed=0)
    found = [env.step(np.array([[u]]))[0][0, 2] for u in inputs]
    expected = fine(plant, dead_time, inputs)[1 : len(found) + 1]
    assert np.allclose(found[: len(expected)], expected, atol=1e-6)


@pytest.mark.parametrize("name", PLANTS)
def test_frequency_response_and_state_space_are_one(name):
    numerator, denominator, dead_time = PLANTS[name]
    plant = sampled(control.tf(numerator, denominator), SAMPLE_TIME, dead_time)
    z = np.exp(1j * np.array([0.01, 0.3, 1.0, 3.0]))
    a, b, c = plant.state_space()
    whole = [c @ np.linalg.solve(at * np.eye(len(c)) - a, b) for at in z]
    assert np.allclose(plant.response(z), whole)
    if dead_time == 0.0:
        theirs = control.sample_system(control.tf(numerator, denominator), SAMPLE_TIME, "zoh")
        assert np.allclose(plant.response(z), theirs(z).reshape(-1))


def test_plants_and_draws_stand_side_by_side():
    two = [sampled(control.tf(*PLANTS[name][:2]), SAMPLE_TIME, PLANTS[name][2])
           for name in ("two lags", "integrating")]  # fmt: skip
    together = environment(two, noises=(0.0, 0.0), loads=(0.3, -0.2), load_at=20)
    pairs = zip(two, (0.3, -0.2), strict=True)
    alone = [environment([p], loads=(w,), load_at=20) for p, w in pairs]
    together.reset(seed=0)
    for env in alone:
        env.reset(seed=0)
    for u in np.random.default_rng(1).uniform(-1, 1, 60):
        whole = together.step(np.full((1, 4), u))[0]
        apart = [env.step(np.array([[u]]))[0][0, 2] for env in alone]
        assert np.array_equal(whole[0, 8:], np.repeat(apart, 2))


def test_the_load_acts_behind_the_limits_and_the_cost_is_the_absolute_error():
    plant = sampled(control.tf([1], [1, 0]), SAMPLE_TIME, 0.0)
    env = environment([plant], input_limits=(-0.5, 0.5), loads=(0.25,), load_at=1, reference=2.0)
    env.reset(seed=0)
    first = env.step(np.array([[3.0]]))
    assert first[0][0, 2] == pytest.approx(0.5 * SAMPLE_TIME)
    second = env.step(np.array([[3.0]]))
    assert second[0][0, 2] == pytest.approx((0.5 + 0.75) * SAMPLE_TIME)
    assert second[4]["cost"][0] == pytest.approx(SAMPLE_TIME * (2.0 - 1.25 * SAMPLE_TIME))


def test_noise_is_measured_but_is_not_in_the_output():
    plant = sampled(control.tf([1], [1, 1]), SAMPLE_TIME, 0.0)
    env = environment([plant], n=2, noises=(0.1, 0.1, 0.3), max_episode_steps=2000, load_at=2000)
    measured = [env.reset(seed=0)[0]]
    for _ in range(2000):
        measured.append(env.step(np.zeros((2, 3)))[0])
    noise = np.stack(measured)[:, :, :3] - np.stack(measured)[:, :, 6:]
    assert noise.std(axis=(0, 1)) == pytest.approx([0.1, 0.1, 0.3], rel=0.05)
    assert np.abs(np.corrcoef(noise.reshape(-1, 6).T) - np.eye(6)).max() < 0.1


def test_a_diverging_output_ends_the_episode():
    plant = sampled(control.tf([1], [1, -1]), SAMPLE_TIME, 0.0)
    env = environment([plant], n=2, max_episode_steps=1000, load_at=1000)
    env.reset(seed=0)
    terminated = np.zeros(2, dtype=bool)
    while not terminated.any():
        _, _, terminated, _, infos = env.step(np.array([[1e3], [0.0]]))
    assert terminated.tolist() == [True, False]
    assert infos["cost"][0] > 1e3 > infos["cost"][1]


@pytest.mark.parametrize(
    ("plant", "dead_time", "said"),
    [
        (3.0, 0.0, "expected a system of python-control"),
        ("of two", 0.0, "2 inputs and 1 outputs"),
        ("discrete", 0.0, "sampled every 0.1 s; expected a continuous system"),
        ("through", 0.0, "output follows its input at once"),
        ("lag", math.nan, "dead_time=nan"),
    ],
)
def test_what_is_no_plant_is_refused(plant, dead_time, said):
    plants = {
        "of two": control.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]),
        "discrete": control.tf([1], [1, -0.5], 0.1),
        "through": control.tf([1, 0], [1, 1]),
        "lag": control.tf([1], [1, 1]),
    }
    with pytest.raises(ConfigError, match=said):
        sampled(plants.get(plant, plant), SAMPLE_TIME, dead_time)
