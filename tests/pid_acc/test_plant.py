"""The plant against equations (11) and (14), written out again for one car."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import zoac  # noqa: F401 (registers the environments)
from zoac.tasks.pid_acc import PidAccVecEnv
from zoac.tasks.pid_acc.plant import demonstration_profile, make_single

A = np.array([[0, 1, -2.5], [0, 0, -1], [0, 0, -1 / 0.45]])
B = np.array([0, 0, 1 / 0.45])
D = np.array([0, 1, 0])


def independent_episode(w, increments, jerk):
    """Forward Euler in matrix form; returns observations, costs, and whether it terminated."""
    x, older, oldest, u = np.zeros(3), np.zeros(3), np.zeros(3), 0.0
    weight = 0.1 / 0.1**2 if jerk == "rate" else 0.1
    observations, costs = [], []
    for w_t, du in zip(w, increments, strict=False):
        u_next = np.clip(u + np.clip(du, -1.5, 0.6), -1.5, 0.6)
        x_next = x + 0.1 * (A @ x + B * u_next + D * w_t)
        x, older, oldest = x_next, x, older
        dd, dv, af = x
        squared = np.clip(du, -1.5, 0.6) if jerk == "commanded_increment" else u_next - u
        r = 0.1 * dv**2 + 0.06 * dd**2 + u_next**2 + weight * squared**2
        r += 0.5 * (0.25 * dv + 0.02 * dd - af) ** 2
        u = u_next
        over = abs(dd) > 5 or abs(dv) > 1
        observations.append([*x, *older, *oldest, u])
        costs.append(r + 1000 * over)
        if over:
            return np.array(observations), np.array(costs), True
    return np.array(observations), np.array(costs), False


@pytest.mark.parametrize("jerk", ["rate", "increment", "commanded_increment"])
@pytest.mark.parametrize("scale", [0.02, 3.0])
def test_steps_and_costs_match_an_independent_simulation(jerk, scale):
    envs = PidAccVecEnv(num_envs=4, jerk=jerk)
    envs.reset(seed=3)
    rng = np.random.default_rng(0)
    increments = rng.normal(0, scale, (200, 4, 1))
    w = envs.arrays["preceding"].copy()
    expected = [independent_episode(w[i], increments[:, i, 0], jerk) for i in range(4)]
    over = np.zeros(4, dtype=bool)
    for t in range(200):
        observations, rewards, terminated, _, infos = envs.step(increments[t], ~over)
        for env_index in np.flatnonzero(~over):
            states, costs, ends = expected[env_index]
            np.testing.assert_allclose(observations[env_index], states[t], atol=1e-12)
            assert infos["cost"][env_index] == pytest.approx(costs[t], abs=1e-12)
            assert rewards[env_index] == -infos["cost"][env_index]
            assert terminated[env_index] == (ends and t == len(costs) - 1)
        over |= terminated


def test_an_episode_is_cut_at_1000_steps():
    envs = PidAccVecEnv(num_envs=1, preceding_std=0.0)
    envs.reset(seed=0)
    ends = [envs.step(np.zeros((1, 1)))[3][0] for _ in range(1000)]
    assert ends == [False] * 999 + [True]


def test_preceding_car_holds_its_acceleration_for_3_seconds_and_stays_in_bounds():
    envs = PidAccVecEnv(num_envs=50, preceding_std=0.5)
    envs.reset(seed=0)
    blocks = envs.arrays["preceding"].reshape(50, -1, 30)
    assert (blocks == blocks[:, :, :1]).all()
    assert blocks.min() == -1.5
    assert blocks.max() == 0.6


def test_005_is_the_standard_deviation():
    envs = PidAccVecEnv(num_envs=200)
    envs.reset(seed=0)
    draws = envs.arrays["preceding"][:, ::30]
    assert draws.std() == pytest.approx(0.05, rel=0.03)


def test_demonstration_profile_is_that_of_figure_5():
    profile = demonstration_profile(1000)
    changes = [0, *(np.flatnonzero(np.diff(profile)) + 1)]
    assert [(int(t), float(profile[t])) for t in changes] == [
        (0, 0.05), (91, 0.15), (121, -0.10), (151, 0.0), (181, -0.20), (211, 0.15),
        (241, 0.05), (271, 0.0),
    ]  # fmt: skip


def test_demonstration_is_an_option_of_reset():
    env = make_single()
    env.reset(options={"demonstration": True})
    assert np.array_equal(env.vec_env.arrays["preceding"][0], demonstration_profile(1020))


def test_gymnasiums_checker_is_content():
    check_env(gymnasium.make("zoac/PidAcc-v0").unwrapped, skip_render_check=True)


def test_the_single_environment_is_one_environment_of_the_vectorised_one():
    single = gymnasium.make("zoac/PidAcc-v0")
    envs = gymnasium.make_vec("zoac/PidAcc-v0", num_envs=2).unwrapped
    assert isinstance(envs, PidAccVecEnv)
    single.reset(seed=8)
    envs.reset(seed=[5, 8])
    for _ in range(5):
        one = single.step(np.array([0.1]))
        all_ = envs.step(np.full((2, 1), 0.1))
        assert np.array_equal(one[0], all_[0][1])
        assert one[1] == all_[1][1]
        assert one[4]["cost"] == all_[4]["cost"][1]
