import dataclasses

import numpy as np
import pytest
from bayes_opt.util import UtilityFunction, acq_max
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern

from tests.baselines.support import STEPS, TARGET, drive, engine, problem, spoiled
from zoac.baselines.acquisition import Acquisition, maximise
from zoac.baselines.bo import BayesOpt, BoundedRegressor, kept_observations
from zoac.baselines.extras.model_tuner import normal_scores
from zoac.baselines.extras.optuna import Optuna
from zoac.core.state import decode, encode
from zoac.rollout.outcomes import CostRange

# The library's estimate of the length scale ends at a bound now and then.
pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")


def data(n=40):
    rng = np.random.default_rng(1)
    points = rng.uniform(size=(n, 3))
    return points, np.sin(5.0 * points).sum(axis=1)


SETTINGS = {"kernel": Matern(nu=2.5), "alpha": 1e-6, "normalize_y": True, "random_state": 0}


def process():
    return GaussianProcessRegressor(**SETTINGS)


def test_unbounded_and_refitted_it_is_the_librarys_process():
    points, _ = data()
    values = np.sin(points).sum(axis=1)  # smooth: its length scale is none of the bounds
    plain, bounded = process(), BoundedRegressor(0.0, None, **SETTINGS)
    for n in (12, 13, 20):
        plain.fit(points[:n], values[:n])
        bounded.fit(points[:n], values[:n])
        assert np.array_equal(plain.predict(points), bounded.predict(points))


def test_the_length_scale_is_estimated_anew_as_observations_grow():
    points, values = data(98)
    bounded = BoundedRegressor(0.5, None, **SETTINGS)
    scales = [bounded.fit(points[:n], values[:n]).kernel_.length_scale for n in (44, 65, 66, 98)]
    assert scales[0] == scales[1] != scales[2] == scales[3]


def test_a_worse_estimate_of_the_length_scale_does_not_replace_a_better():
    points, values = data(66)
    bounded = BoundedRegressor(0.5, None, **SETTINGS)
    good = bounded.fit(points[:44], values[:44]).kernel_.length_scale
    bounded.optimizer = lambda likelihood, start, bounds: (np.log([1e-5]), 0.0)
    bounded.n_restarts_optimizer = 0
    assert bounded.fit(points, values).kernel_.length_scale == good


def test_between_estimates_it_still_learns_from_each_observation():
    points, values = data(29)
    bounded = BoundedRegressor(0.5, None, **SETTINGS)
    bounded.fit(points[:20], values[:20])
    bounded.fit(points, values)
    assert np.allclose(bounded.predict(points), values, atol=1e-3)


def test_best_half_and_latest_half_are_kept():
    values = np.array([9.0, 1.0, 8.0, 2.0, 7.0, 0.0, 3.0, 4.0])
    assert kept_observations(values, 4).tolist() == [0, 2, 6, 7]
    assert kept_observations(values, 8).tolist() == list(range(8))
    assert kept_observations(values, None).tolist() == list(range(8))


def fitted():
    """Return our upper confidence bound and the library's, of one fitted process."""
    points, values = data()
    model = process().fit(points, values)
    utility = UtilityFunction(kind="ucb", kappa=2.576, xi=0.0)
    ours = Acquisition(model, values)
    return ours, lambda x: utility.utility(x, model, values.max())


def test_acquisition_values_are_the_librarys():
    ours, theirs = fitted()
    points = np.random.default_rng(3).uniform(size=(50, 3))
    np.testing.assert_allclose(ours.values(points), theirs(points), rtol=1e-5, atol=1e-7)


def test_acquisition_gradients_are_the_slopes_of_its_values():
    ours, _ = fitted()
    for x in np.random.default_rng(4).uniform(size=(10, 3)):
        value, gradient = ours.value_and_gradient(x)
        steps = 1e-5 * np.eye(3)
        numeric = (ours.values(x + steps) - ours.values(x - steps)) / 2e-5
        np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-5)
        assert value == pytest.approx(ours.values(x[None])[0], rel=1e-7)


def test_the_acquisition_is_maximised_as_the_library_does():
    points, values = data()
    model = process().fit(points, values)
    utility = UtilityFunction(kind="ucb", kappa=2.576, xi=0.0).utility
    bounds = np.array([[0.0, 1.0]] * 3)
    theirs = acq_max(utility, model, values.max(), bounds, np.random.RandomState(0))
    acquisition = Acquisition(model, values)
    ours = maximise(acquisition, bounds, np.random.RandomState(0))
    assert np.allclose(ours, theirs, atol=1e-3)


class Rising:
    """Grows towards the corner (1, ..., 1)."""

    def values(self, points):
        assert np.all((points >= 0.0) & (points <= 1.0))
        return points.sum(axis=1)

    def value_and_gradient(self, x):
        return self.values(x[None])[0], np.ones_like(x)


def test_the_acquisition_is_maximised_inside_the_box():
    bounds = np.array([[0.0, 1.0]] * 3)
    assert maximise(Rising(), bounds, np.random.RandomState(0)).tolist() == [1.0] * 3


def test_bo_describes_the_random_design_it_makes():
    tuner = BayesOpt(problem(episodes=50), start="library")
    assert tuner.describe()["initial_design"] == 7
    for _ in range(7):
        assert not hasattr(tuner._process, "X_train_")
        drive(tuner, engine(), 1)
    tuner.ask()
    assert hasattr(tuner._process, "X_train_")


def test_bo_takes_the_same_point_twice():
    tuner = BayesOpt(problem(), noise=0.1, start="baseline")
    drive(tuner, engine(), 1)
    tuner._optimizer.suggest(np.zeros(5))
    drive(tuner, engine(), 1)
    assert len(tuner._optimizer.bo.space) == 2


def evaluate(tuner, group, z, cost):
    """Let the tuner ask for `x` next and tell it that cost."""
    tuner._optimizer.suggest(z)
    segments = group.rollout(tuner.ask())
    assert np.allclose(segments[0].proposal.x, z)
    tuner.tell([spoiled(segments[0], cost / STEPS)])


def test_bo_can_recommend_the_lowest_posterior_mean():
    """One lucky cost does not sway a model that knows of the noise; ten of a kind do."""
    rng = np.random.default_rng(0)
    tuner, group = (
        BayesOpt(problem(), noise=1.0, recommendation="mean", initial_design=2),
        engine(),
    )
    drive(tuner, group, 3 * STEPS)  # the start and the design
    lucky = np.full(5, -0.9)
    evaluate(tuner, group, lucky, -0.3)
    for _ in range(10):
        evaluate(tuner, group, TARGET + rng.uniform(-0.02, 0.02, 5), rng.normal(0.0, 0.1))
        evaluate(tuner, group, rng.uniform(-1.0, 1.0, 5), 2.0)
    tuner.ask()
    assert np.abs(tuner.recommend() - TARGET).max() < 0.03
    assert np.allclose(tuner._best_points[0], lucky)


def test_normal_scores_are_those_of_a_normal_sample():
    assert np.allclose(normal_scores(np.array([30.0, 1e9, -2.0])), [0.0, 0.9674216, -0.9674216])
    assert normal_scores(np.array([1.0, 1.0])).tolist() == [0.0, 0.0]


def test_optunas_gaussian_process_restores_exactly():
    def make():
        return Optuna(problem(num_envs=2), initial_design=5), engine(num_envs=2)

    tuner, group = make()
    drive(tuner, group, 8 * STEPS)
    twin, twin_group = make()
    twin.restore(decode(encode(tuner.state())))
    twin_group.restore(group.state())
    np.random.seed(3)  # noqa: NPY002
    asked = drive(twin, twin_group, 2 * STEPS)
    assert all(map(np.array_equal, asked, drive(tuner, group, 2 * STEPS)))


@pytest.mark.parametrize("tuner", [BayesOpt, Optuna])
def test_a_model_sees_what_violates_as_worse_than_all_and_of_the_size_of_the_costs(
    tuner, monkeypatch
):
    """At every ask anew: the first episode violates when nothing is known, costs grow later."""
    seen = []
    one, group = tuner(problem(num_envs=2), initial_design=2), engine(num_envs=2)
    prices = CostRange.prices

    def spy(self, outcomes):
        seen.append(prices(self, outcomes))
        return seen[-1]

    monkeypatch.setattr(CostRange, "prices", spy)
    for costs in (1.0, 10.0, 100.0):
        segments = [spoiled(s, costs) for s in group.rollout(one.ask())]
        first = {} if costs > 1.0 else {"violation": 0.5, "costs": np.zeros(STEPS)}
        one.tell([dataclasses.replace(segments[0], **first), *segments[1:]])
    one.ask()
    last = seen[-1]
    assert last[0] == last.max() > last[1:].max()
    assert last.max() < 2 * 100.0 * STEPS
