import numpy as np
import pytest

from tests.support import CountingTask, EchoController, engine, proposal, same_segment
from zoac.core.errors import ControllerError
from zoac.rollout.engine import RolloutEngine


def test_segments_go_on_where_the_environment_stands():
    group = engine(CountingTask(max_episode_steps=100), [0])
    first, second = group.rollout([proposal(0, horizon=3), proposal(0, horizon=2)])
    (third,) = group.rollout([proposal(0, horizon=1)])
    steps = [s.observations[:, 1].tolist() for s in (first, second, third)]
    assert steps == [[0, 1, 2, 3], [3, 4, 5], [5, 6]]
    assert [s.starts_episode for s in (first, second, third)] == [True, False, False]


def test_a_segment_ends_where_its_episode_ends_and_the_next_one_starts_anew():
    group = engine(CountingTask(max_episode_steps=5), [0])
    one, two, three = group.rollout([proposal(0, horizon=3)] * 3)
    assert [s.length for s in (one, two, three)] == [3, 2, 3]
    assert (two.truncated, two.terminated) == (True, False)
    assert three.starts_episode
    assert three.observations[:, 0].tolist() == [2, 2, 2, 2]


def test_termination_is_not_truncation():
    group = engine(CountingTask(max_episode_steps=5, ends_after=5), [0])
    (segment,) = group.rollout([proposal(0)])
    assert (segment.terminated, segment.truncated) == (True, False)


def test_a_whole_episode_begins_at_a_start():
    group = engine(CountingTask(max_episode_steps=5), [0])
    group.rollout([proposal(0, horizon=2)])
    (segment,) = group.rollout([proposal(0)])
    assert segment.observations[:, 1].tolist() == [0, 1, 2, 3, 4, 5]


def test_environments_with_different_lengths_do_not_disturb_each_other():
    together = engine(CountingTask(max_episode_steps=4), [0, 1, 2])
    plan = [
        *[proposal(0, a=1, horizon=3)] * 3,
        proposal(1, a=2, horizon=2),
        *[proposal(2, a=3)] * 2,
    ]
    mixed = together.rollout(plan)
    for env_index in (0, 1, 2):
        alone = engine(CountingTask(max_episode_steps=4), [env_index])
        own = [i for i, p in enumerate(plan) if p.env_index == env_index]
        for i, segment in zip(own, alone.rollout([plan[i] for i in own]), strict=True):
            assert same_segment(segment, mixed[i])


def test_a_restored_segment_leaves_the_environment_where_it_stood():
    branched = engine(CountingTask(max_episode_steps=6), [0, 1])
    straight = engine(CountingTask(max_episode_steps=6), [0, 1])
    for group in (branched, straight):
        group.rollout([proposal(0, horizon=2)])
    branch, after = branched.rollout(
        [proposal(0, a=9, horizon=20, restore=True), proposal(0, horizon=20)]
    )
    (expected,) = straight.rollout([proposal(0, horizon=20)])
    assert same_segment(after, expected)
    assert branch.observations[0].tolist() == after.observations[0].tolist()
    assert same_segment(branched.rollout([proposal(0)])[0], straight.rollout([proposal(0)])[0])


def test_both_segments_of_a_finished_environment_begin_at_the_same_new_episode():
    group = engine(CountingTask(max_episode_steps=3), [0])
    group.rollout([proposal(0)])
    one, two = group.rollout([proposal(0, horizon=2, restore=True), proposal(0, horizon=2)])
    assert one.observations.tolist() == two.observations.tolist()


def test_a_seeded_episode_leaves_the_environments_own_stream_alone():
    disturbed = engine(CountingTask(), [0])
    quiet = engine(CountingTask(), [0])
    disturbed.rollout([proposal(0, horizon=2)])
    quiet.rollout([proposal(0, horizon=2)])
    disturbed.rollout([proposal(0, seed=123)])
    for kind in ({"horizon": 2}, {}):
        (one,), (two,) = (g.rollout([proposal(0, **kind)]) for g in (disturbed, quiet))
        assert same_segment(one, two)


def test_the_same_seed_gives_the_same_episode_in_any_environment():
    group = engine(CountingTask(), [0, 1])
    one, two = group.rollout([proposal(0, seed=5), proposal(1, seed=5)])
    assert one.observations[0, 2] == two.observations[0, 2]


def test_stored_observations_are_not_overwritten_by_later_steps():
    group = engine(CountingTask(max_episode_steps=50), [0])
    (segment,) = group.rollout([proposal(0, horizon=3)])
    before = segment.observations.copy()
    group.rollout([proposal(0, horizon=30)])
    assert np.array_equal(segment.observations, before)


def test_memory_begins_anew_with_an_episode_and_outlives_a_parameter_change():
    group = engine(CountingTask(max_episode_steps=5), [0])
    segments = group.rollout([proposal(0, a=a, horizon=3) for a in (1, 2, 3)])
    counts = [s.diagnostics["count"].tolist() for s in segments]
    assert counts == [[1, 2, 3], [4, 5], [1, 2, 3]]


def test_parameters_are_clipped_to_the_box():
    group = engine(CountingTask(), [0])
    (segment,) = group.rollout([proposal(0, a=99, horizon=1)])
    assert segment.actions.tolist() == [[10.0]]


def test_restored_environments_continue_bit_for_bit():
    group = engine(CountingTask(), [0, 1, 2])
    group.rollout([proposal(0, horizon=3), proposal(1, horizon=2)])
    twin = engine(CountingTask(), [0, 1, 2], seed=9)
    twin.restore(group.state())
    plan = [proposal(env_index, horizon=6) for env_index in (0, 1, 2)] * 2
    for one, two in zip(group.rollout(plan), twin.rollout(plan), strict=True):
        assert same_segment(one, two)


class _Broken(EchoController):
    def __init__(self, actions):
        self._actions = actions

    def act(self, params, obs, memory):
        return self._actions, memory, {}


def _broken_group(actions):
    task = CountingTask()
    task.make_controller = lambda: _Broken(actions)
    return RolloutEngine(task, [4, 7], [0, 1])


def test_an_action_that_is_not_finite_is_named_by_environment_and_parameters():
    group = _broken_group(np.array([[0.0], [np.nan]]))
    with pytest.raises(ControllerError, match=r"Environment 7, step 0 .* parameters: a=5, b=5"):
        group.rollout([proposal(4, horizon=1), proposal(7, horizon=1)])


def test_actions_of_the_wrong_shape_are_refused():
    group = _broken_group(np.zeros(2))
    with pytest.raises(ControllerError, match=r"shape \(2,\), expected \(2, 1\)"):
        group.rollout([proposal(4, horizon=1), proposal(7, horizon=1)])
