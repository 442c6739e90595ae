import numpy as np

from tests.support import CountingVecEnv


def make_envs(n=3):
    envs = CountingVecEnv(n, max_episode_steps=5, ends_after=None)
    envs.reset(seed=0)
    return envs


def test_masked_out_environments_stand_still():
    envs = make_envs()
    before = envs.arrays["x"].copy()
    mask = np.array([True, False, True])
    observations, rewards, *_ = envs.step(np.ones((3, 1)), mask)
    assert np.array_equal(observations[1], before[1])
    assert rewards[1] == 0.0
    assert observations[[0, 2], 1].tolist() == [1, 1]


def test_a_masked_out_environment_at_its_time_limit_reports_no_end():
    envs = make_envs(2)
    for _ in range(5):
        envs.step(np.ones((2, 1)))
    *_, truncated, _ = envs.step(np.ones((2, 1)), np.array([True, False]))
    assert truncated.tolist() == [True, False]


def test_reset_mask_leaves_the_other_environments_alone():
    envs = make_envs()
    envs.step(np.ones((3, 1)))
    observations, _ = envs.reset(options={"reset_mask": np.array([False, True, False])})
    assert observations[:, 1].tolist() == [1, 0, 1]


def test_an_environment_draws_from_its_own_stream():
    wide, narrow = make_envs(3), CountingVecEnv(1, 5, None)
    narrow.reset(seed=[1])
    assert wide.arrays["x"][1, 2] == narrow.arrays["x"][0, 2]
    wide.reset(options={"reset_mask": np.array([True, False, True])})
    wide.reset(options={"reset_mask": np.array([False, True, False])})
    narrow.reset()
    assert wide.arrays["x"][1, 2] == narrow.arrays["x"][0, 2]


def test_restored_environments_continue_bit_for_bit():
    envs = make_envs()
    envs.step(np.ones((3, 1)))
    state = envs.state([0, 2])
    first = envs.step(np.ones((3, 1)))[0], envs.reset()[0]
    envs.restore([0, 2], state)
    second = envs.step(np.ones((3, 1)))[0], envs.reset()[0]
    for one, two in zip(first, second, strict=True):
        assert np.array_equal(one[[0, 2]][:, 1:], two[[0, 2]][:, 1:])
