import numpy as np

from tests.support import CountingLanes


def make_lanes(n=3):
    lanes = CountingLanes(n, max_episode_steps=5, ends_after=None)
    lanes.reset(seed=0)
    return lanes


def test_masked_out_lanes_stand_still():
    lanes = make_lanes()
    before = lanes.arrays["x"].copy()
    mask = np.array([True, False, True])
    observations, rewards, *_ = lanes.step(np.ones((3, 1)), mask)
    assert np.array_equal(observations[1], before[1])
    assert rewards[1] == 0.0
    assert observations[[0, 2], 1].tolist() == [1, 1]


def test_a_masked_out_lane_at_its_time_limit_reports_no_end():
    lanes = make_lanes(2)
    for _ in range(5):
        lanes.step(np.ones((2, 1)))
    *_, truncated, _ = lanes.step(np.ones((2, 1)), np.array([True, False]))
    assert truncated.tolist() == [True, False]


def test_reset_mask_leaves_the_other_lanes_alone():
    lanes = make_lanes()
    lanes.step(np.ones((3, 1)))
    observations, _ = lanes.reset(options={"reset_mask": np.array([False, True, False])})
    assert observations[:, 1].tolist() == [1, 0, 1]


def test_a_lane_draws_from_its_own_stream():
    wide, narrow = make_lanes(3), CountingLanes(1, 5, None)
    narrow.reset(seed=[1])
    assert wide.arrays["x"][1, 2] == narrow.arrays["x"][0, 2]
    wide.reset(options={"reset_mask": np.array([True, False, True])})
    wide.reset(options={"reset_mask": np.array([False, True, False])})
    narrow.reset()
    assert wide.arrays["x"][1, 2] == narrow.arrays["x"][0, 2]


def test_restored_lanes_go_on_to_the_same_bits():
    lanes = make_lanes()
    lanes.step(np.ones((3, 1)))
    state = lanes.state([0, 2])
    first = lanes.step(np.ones((3, 1)))[0], lanes.reset()[0]
    lanes.restore([0, 2], state)
    second = lanes.step(np.ones((3, 1)))[0], lanes.reset()[0]
    for one, two in zip(first, second, strict=True):
        assert np.array_equal(one[[0, 2]][:, 1:], two[[0, 2]][:, 1:])
