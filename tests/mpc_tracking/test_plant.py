"""The environment: starts, cost, ends and observations as SPEC section 2 says."""

import math
import warnings

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from zoac.tasks.mpc_tracking import path
from zoac.tasks.mpc_tracking.plant import MpcTrackingVecEnv, make_single
from zoac.tasks.mpc_tracking.vehicle import TRUE_PARAMETERS, BicycleModel


def standing_on_the_path(x: float = 40.0, **errors: float) -> MpcTrackingVecEnv:
    """Return one environment on the path, off by `errors` (y, phi, u, v, omega)."""
    envs = MpcTrackingVecEnv(1)
    envs.reset(seed=0)
    state = {"y": path.lateral(x), "phi": path.heading(x), "u": 18.0, "v": 0.0, "omega": 0.0}
    envs.arrays["state"][0] = [x, *(state[name] + errors.get(name, 0.0) for name in state)]
    return envs


def test_passes_gymnasiums_checker() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(infinity|normalize|symmetric).*")
        check_env(make_single(), skip_render_check=True)


def test_starts_are_distributed_as_specified() -> None:
    observations, _ = MpcTrackingVecEnv(4000).reset(seed=1)
    x, y, phi, u, v, omega = observations[:, :6].T
    off = y - [path.lateral(value) for value in x]
    turned = phi - [path.heading(value) for value in x]
    slip = np.arctan2(v, u)
    for values, low, high in ((x, 0, 100), (u, 17.5, 18.5)):
        assert low <= values.min() < values.max() <= high
        assert values.mean() == pytest.approx((low + high) / 2, abs=0.02 * (high - low))
        assert values.std() == pytest.approx((high - low) / math.sqrt(12), rel=0.03)
    # A normal clipped at c standard deviations; its variance is known in closed form.
    for values, std, bound in (
        (off, 0.2, 0.5), (turned, 0.05, 0.1), (slip, 0.05, 0.1), (omega, 0.05, 0.1),
    ):  # fmt: skip
        c = bound / std
        inside = math.erf(c / math.sqrt(2))
        variance = inside - c * math.sqrt(2 / math.pi) * math.exp(-c * c / 2) + c * c * (1 - inside)
        assert np.abs(values).max() == pytest.approx(bound, abs=1e-9)
        assert values.mean() == pytest.approx(0, abs=4 * std / math.sqrt(4000))
        assert values.std() == pytest.approx(std * math.sqrt(variance), rel=0.04)


def test_demonstration_start() -> None:
    observations, _ = MpcTrackingVecEnv(1).reset(seed=3, options={"demonstration": True})
    expected = [8, path.lateral(8.0) + 0.25, path.heading(8.0) + 0.04, 17.6]
    expected += [17.6 * math.tan(0.03), 0.05]
    np.testing.assert_allclose(observations[0, :6], expected, rtol=1e-15)


def test_observation_is_the_state_and_the_path_ahead_of_it() -> None:
    envs = MpcTrackingVecEnv(2, horizon=4)
    observations, _ = envs.reset(seed=0)
    assert observations.shape == (2, 6 + 12)
    points = np.empty(12)
    path.preview(observations[1, 0], points)
    np.testing.assert_array_equal(observations[1, 6:], points)


def test_a_step_is_the_true_model() -> None:
    envs = MpcTrackingVecEnv(1)
    before, _ = envs.reset(seed=0)
    after = envs.step(np.array([[0.1, -1.0]]))[0]
    expected = BicycleModel().predict(
        np.array([TRUE_PARAMETERS]), before[:, :6].copy(), np.array([[0.1, -1.0]])
    )
    np.testing.assert_array_equal(after[:, :6], expected)


def test_cost_is_taken_at_the_state_after_the_step() -> None:
    envs = standing_on_the_path(y=0.4, phi=-0.1, u=0.7, v=0.2, omega=0.05)
    delta, a = 0.02, 1.5
    observations, rewards, *_, infos = envs.step(np.array([[delta, a]]))
    x, y, phi, u, _, omega = observations[0, :6]
    cost = (
        (u - 18) ** 2
        + 4 * (y - path.lateral(x)) ** 2
        + 10 * (phi - path.heading(x)) ** 2
        + 2 * omega**2
        + 500 * delta**2
        + 5 * a**2
    )
    assert infos["cost"][0] == pytest.approx(cost, rel=1e-14)
    assert rewards[0] == -infos["cost"][0]


@pytest.mark.parametrize(
    ("inside", "outside"),
    [
        ({"y": 3.8}, {"y": 4.2}),
        ({"y": -3.8}, {"y": -4.2}),
        ({"phi": 0.72}, {"phi": 0.85}),
        ({"phi": -0.72}, {"phi": -0.85}),
        ({"u": 3.95}, {"u": 4.05}),
        ({"u": -3.95}, {"u": -4.05}),
        ({}, {"v": math.nan}),
    ],
)
def test_an_episode_ends_where_an_error_is_too_large(inside: dict, outside: dict) -> None:
    # x = 0.01 s of travel later the errors have hardly changed.
    for errors, ends in ((inside, False), (outside, True)):
        envs = standing_on_the_path(x=0.0, **errors)
        if "y" in errors:  # stay beside the path: no heading error to carry it across
            envs.arrays["state"][0, 2] = path.heading(0.9)
        _, _, terminated, truncated, infos = envs.step(np.zeros((1, 2)))
        assert terminated[0] == ends
        assert not truncated[0]
        if not math.isnan(infos["cost"][0]):
            assert (infos["cost"][0] >= 1000) == ends


def test_the_time_limit_truncates() -> None:
    envs = MpcTrackingVecEnv(1)
    envs.reset(seed=0)
    for step in range(200):
        envs.arrays["state"][0] = standing_on_the_path().arrays["state"][0]
        _, _, terminated, truncated, _ = envs.step(np.zeros((1, 2)))
        assert not terminated[0]
        assert truncated[0] == (step == 199)


def test_inputs_saturate() -> None:
    bound = np.array([[2 * math.pi / 15, 3.0]])
    results = []
    for action in (bound, 10 * bound):
        envs = MpcTrackingVecEnv(1)
        envs.reset(seed=0)
        observations, rewards, *_ = envs.step(action)
        results.append((observations, rewards))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])


def test_an_environment_gives_the_same_bits_alone() -> None:
    many, one = MpcTrackingVecEnv(5), MpcTrackingVecEnv(1)
    many.reset(seed=[10, 11, 12, 13, 14])
    one.reset(seed=[13])
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, (30, 5, 2))
    for action in actions:
        together, alone = many.step(action), one.step(action[3:4])
        for a, b in zip(together[:2], alone[:2], strict=True):
            np.testing.assert_array_equal(a[3], b[0])
