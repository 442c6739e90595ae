from dataclasses import replace

import numpy as np
import pytest

from tests.algorithm.support import grouped
from tests.support import CountingTask, engine
from zoac.algorithm import zoac as zoac_module
from zoac.algorithm.advantage import estimate
from zoac.algorithm.zoac import Zoac
from zoac.core.errors import ConfigError
from zoac.core.tuner import Problem

OPTIONS = {
    "segment_length": 3,
    "segments": 2,
    "sigma": 0.1,
    "step_size": 0.03,
    "last": 0.01,
    "slope": 0.002,
    "hidden": (8,),
    "epochs": 1,
}


def make_zoac(seed=0, num_envs=4, **options):
    problem = Problem(CountingTask.space, 3, num_envs, 1000, 7, seed)
    return Zoac(problem, **grouped(**{**OPTIONS, **options}))


def iterate(tuner, group, times=1):
    for _ in range(times):
        metrics = tuner.tell(group.rollout(tuner.ask()))
    return metrics


def test_asks_for_n_h_segments_of_n_steps_around_the_iterate():
    tuner = make_zoac(num_envs=500, segments=4)
    proposals = tuner.ask()
    assert [p.env_index for p in proposals] == list(range(500)) * 4
    assert {p.horizon for p in proposals} == {3}
    offsets = (np.stack([p.x for p in proposals]) - tuner._theta) / 0.1
    assert abs(offsets.mean()) < 0.1
    assert offsets.std() == pytest.approx(1.0, abs=0.05)


def test_mirrored_environments_use_opposite_noise():
    tuner = make_zoac(num_envs=4, mirrored=True)
    x = np.stack([p.x for p in tuner.ask()]).reshape(2, 4, 2) - tuner._theta
    np.testing.assert_allclose(x[:, 0], -x[:, 1])
    np.testing.assert_allclose(x[:, 2], -x[:, 3])


def test_step_size_falls_linearly_then_holds():
    tuner, group = make_zoac(), engine(CountingTask(), [0, 1, 2, 3])
    sizes = [iterate(tuner, group)["step_size"] for _ in range(14)]
    expected = [max(0.01, 0.03 - 0.002 * i) for i in range(14)]
    np.testing.assert_allclose(sizes, expected)


def test_without_annealing_the_step_size_stays():
    tuner, group = make_zoac(anneal=False), engine(CountingTask(), [0, 1, 2, 3])
    assert [iterate(tuner, group)["step_size"] for _ in range(3)] == [0.03] * 3


def test_goes_down_the_cost():
    """The cost of `CountingTask` grows with parameter a, so a must fall to its lower bound."""
    tuner = make_zoac(num_envs=20, step_size=0.2, last=0.05)
    iterate(tuner, engine(CountingTask(), list(range(20))), 40)
    assert CountingTask.space.denormalise(tuner.recommend())["a"] < 0.2


def test_advantages_come_from_the_critic_before_its_update():
    tuner, group = make_zoac(), engine(CountingTask(), [0, 1, 2, 3])
    segments = group.rollout(tuner.ask())
    values = tuner._critic.values(np.concatenate([s.observations for s in segments]))
    assert tuner.tell(segments)["value_mean"] == float(values.mean())


def test_advantages_may_come_from_a_critic_that_has_learnt_from_the_iteration():
    options = {"epochs": 4, "epochs_before": 3}
    tuner, twin = make_zoac(**options), make_zoac(**options)
    segments = engine(CountingTask(), [0, 1, 2, 3]).rollout(tuner.ask())
    seen = [s.observations for s in segments]
    ends = np.cumsum([len(s) for s in seen])[:-1]

    def values():
        return twin._critic.values(np.concatenate(seen))

    _, targets = estimate(segments, np.split(values(), ends), 0.99, 0.95)
    fitted = np.concatenate([s[:-1] for s in seen]), np.concatenate(targets)
    twin._critic.fit(*fitted, 3)
    advantages, _ = estimate(segments, np.split(values(), ends), 0.99, 0.95)
    numbers = tuner.tell(segments)
    assert numbers["value_mean"] == float(values().mean())
    assert numbers["advantage_std"] == float(advantages.std())
    tuner.background_update()
    twin._critic.fit(*fitted, 1)
    np.testing.assert_equal(tuner._critic.state(), twin._critic.state())


def test_some_epochs_come_after_the_advantages():
    with pytest.raises(ConfigError, match="epochs_before=4: expected fewer than all 4"):
        make_zoac(epochs=4, epochs_before=4)


def test_sgd_moves_by_step_size_times_gradient_against_it():
    tuner = make_zoac(rule="sgd", step_size=1e-3, standardise_advantages=False, project=False)
    before = tuner._theta
    segments = engine(CountingTask(), [0, 1, 2, 3]).rollout(tuner.ask())
    weights = np.array([s.costs.sum() for s in segments])  # a critic that knows nothing, lambda 1
    zero = [np.zeros(len(s.observations)) for s in segments]
    advantages, _ = estimate(segments, zero, 1.0, 1.0)
    np.testing.assert_allclose(advantages, weights)
    tuner._gamma = tuner._lam = 1.0
    tuner._critic.values = lambda observations: np.zeros(len(observations))
    tuner.tell(segments)
    directions = np.stack([s.proposal.x - before for s in segments]) / 0.1
    gradient = weights @ directions / (len(weights) * 0.1)
    np.testing.assert_allclose(tuner._theta, before - 1e-3 * gradient, rtol=1e-9)


def test_it_may_begin_in_the_middle_of_the_box():
    np.testing.assert_array_equal(make_zoac(start="middle").recommend(), [0.0, 0.0])


def test_average_is_recommended_when_asked_for():
    tuner = make_zoac(recommend="average", average_decay=0.5)
    start = tuner.recommend()
    iterate(tuner, engine(CountingTask(), [0, 1, 2, 3]))
    np.testing.assert_allclose(tuner.recommend(), 0.5 * (start + tuner._theta))


def test_costs_that_are_not_finite_count_as_the_worst_seen():
    tuner, group = make_zoac(), engine(CountingTask(), [0, 1, 2, 3])
    segments = group.rollout(tuner.ask())
    worst = max(float(s.costs.max()) for s in segments)
    broken = [segments[0].with_costs(np.full(3, np.nan)), *segments[1:]]
    mended = [segments[0].with_costs(np.full(3, worst)), *segments[1:]]
    twin = make_zoac()
    twin.ask()
    assert tuner.tell(broken) == twin.tell(mended)
    assert np.isfinite(tuner.recommend()).all()


@pytest.mark.parametrize(("project", "leaves"), [(True, False), (False, True)])
def test_the_iterate_stays_in_the_box_unless_told_otherwise(project, leaves):
    tuner = make_zoac(num_envs=10, project=project, step_size=0.2, slope=0.0)
    iterate(tuner, engine(CountingTask(), list(range(10))), 15)
    assert bool((np.abs(tuner._theta) > 1).any()) is leaves
    assert (np.abs(tuner.recommend()) <= 1).all()


def test_when_the_critic_is_updated_changes_no_number():
    early, late = make_zoac(), make_zoac()
    for _ in range(3):
        (metrics, other) = (
            tuner.tell(engine(CountingTask(), [0, 1, 2, 3]).rollout(tuner.ask()))
            for tuner in (early, late)
        )
        assert metrics == other
        recommended = early.recommend()
        early.background_update()
        early.background_update()
        np.testing.assert_array_equal(early.recommend(), recommended)
    np.testing.assert_equal(early.state(), late.state())


def test_critic_is_updated_once_for_each_iteration():
    tuner, group = make_zoac(), engine(CountingTask(), [0, 1, 2, 3])
    asked = [iterate(tuner, group) for _ in range(3)]
    assert "critic_loss" not in asked[0]
    assert asked[1]["critic_loss"] != asked[2]["critic_loss"]
    tuner.background_update()
    weights = tuner._critic.state()["weights"]
    tuner.background_update()
    np.testing.assert_array_equal(tuner._critic.state()["weights"], weights)


def shown(segments, factor=1.0, costs=None):
    """What a plant that runs away shows: huge observations, and costs if given."""
    return [
        replace(
            s,
            observations=s.observations * factor,
            costs=s.costs if costs is None else np.full(s.length, costs[i % len(costs)]),
        )
        for i, s in enumerate(segments)
    ]


@pytest.mark.parametrize("normalise", [False, True])
@pytest.mark.parametrize(
    ("factor", "costs"),
    [
        (1e200, None),
        (-np.inf, None),
        (np.nan, None),
        (1.0, [1e200, 1e30, -1e300]),
        (1e80, [1e150, 3.0]),
    ],
)
def test_what_float32_cannot_hold_leaves_parameters_and_critic_finite(factor, costs, normalise):
    tuner, group = make_zoac(normalise_observations=normalise), engine(CountingTask(), range(4))
    with np.errstate(all="ignore"):
        for _ in range(3):
            tuner.tell(shown(group.rollout(tuner.ask()), factor, costs))
        iterate(tuner, group, 3)  # the plant is itself again
        seen = np.concatenate([s.observations for s in group.rollout(tuner.ask())])
        tuner.background_update()
    assert np.isfinite(tuner.recommend()).all()
    assert np.isfinite(tuner._critic.values(seen)).all()


def test_huge_costs_still_show_the_way():
    """Squares of these costs overflow; their order does not."""
    tuner = make_zoac(num_envs=20, step_size=0.2, last=0.05)
    group = engine(CountingTask(), list(range(20)))
    with np.errstate(all="ignore"):
        for _ in range(40):
            segments = group.rollout(tuner.ask())
            tuner.tell([s.with_costs(1e180 * s.costs) for s in segments])
    assert CountingTask.space.denormalise(tuner.recommend())["a"] < 2.0


def test_an_update_without_a_finite_gradient_is_skipped_and_counted(monkeypatch):
    tuner, group = make_zoac(), engine(CountingTask(), range(4))
    assert "skipped_updates" not in iterate(tuner, group)
    before = tuner.recommend()
    monkeypatch.setattr(zoac_module, "zeroth_order_gradient", lambda *_: np.array([np.nan, 1.0]))
    assert iterate(tuner, group, 2)["skipped_updates"] == 2
    np.testing.assert_array_equal(tuner.recommend(), before)
    twin = make_zoac()
    twin.restore(tuner.state())
    assert twin.tell(group.rollout(twin.ask()))["skipped_updates"] == 3
