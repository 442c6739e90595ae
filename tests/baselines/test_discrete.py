"""Surrogate models on whole numbers and choices: they believe nothing between the values."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.baselines.support import (
    NUM_ENVS,
    STEPS,
    TARGET,
    Quadratic,
    drive,
    problem,
    tuner_config,
)
from tests.support import needs_its_library
from zoac.baselines.bo import BayesOpt, rounded_points
from zoac.baselines.extras.model_tuner import params_of, point_of
from zoac.baselines.extras.optuna import Optuna
from zoac.config.validate import locate
from zoac.core.parameters import Parameter, ParameterSpace, choice, integer
from zoac.rollout.engine import RolloutEngine

pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")


class Mixed(Quadratic):
    """The quadratic, with an integer and two choices; the best of them are 0, 0.5 and -0.1."""

    space = ParameterSpace(
        [
            Parameter("a", -1.0, 1.0),
            Parameter("b", -1.0, 1.0),
            integer("c", -3, 3),
            choice("d", (-1.0, 0.5, 2.0)),
            choice("e", (-0.1, 1.0)),
        ]
    )


BEST = [0.0, 0.5, -0.1]


def make(tuner, seed=0, num_envs=NUM_ENVS, initial_design=10, **options):
    start = np.zeros(Mixed.space.dimension)
    mixed = problem(seed, 25, space=Mixed.space, start=start, num_envs=num_envs)
    return tuner(mixed, initial_design=initial_design, **options), RolloutEngine(
        Mixed(), range(num_envs), range(num_envs)
    )


def test_the_process_sees_points_that_stand_for_values_and_asks_such():
    tuner, group = make(BayesOpt)
    asked = drive(tuner, group, 13 * STEPS)
    seen = tuner._process.X_train_
    assert len(seen) >= 12
    assert np.array_equal(seen * 2.0 - 1.0, Mixed.space.rounded(seen * 2.0 - 1.0))
    np.testing.assert_allclose(asked[-1], Mixed.space.rounded(asked[-1]), atol=1e-12)


def test_its_real_parameters_stay_as_they_were_drawn():
    drawn = np.random.default_rng(0).uniform(size=(1000, Mixed.space.dimension)) ** 4
    assert np.array_equal(rounded_points(Mixed.space, drawn)[:, :2], drawn[:, :2])


@pytest.mark.parametrize(
    ("tuner", "seed"), [(partial(BayesOpt, noise=0.1), 1), (partial(Optuna, sampler="tpe"), 4)]
)
def test_the_best_values_are_found(tuner, seed):
    """The seeds are such that the random design has not found them yet."""
    tuner, group = make(tuner, seed)
    drive(tuner, group, 10 * STEPS)
    assert Mixed.space.values(tuner.recommend())[2:].tolist() != BEST
    drive(tuner, group, 10 * STEPS)
    found = Mixed.space.values(tuner.recommend())
    assert found[2:].tolist() == BEST
    assert np.abs(found[:2] - TARGET[:2]).max() < 0.4


@pytest.mark.parametrize("name", ["optuna", "botorch"])
def test_a_librarys_model_asks_for_the_best_values_after_a_random_design(name):
    """One in 42 of the random points has them."""
    target = tuner_config(name)["_target_"]
    needs_its_library(target)
    tuner, group = make(locate(target, "tuner"), num_envs=1, initial_design=20)
    *_, last = drive(tuner, group, 22 * STEPS)
    assert Mixed.space.values(last)[2:].tolist() == BEST


def test_smacs_finds_them_too():
    target = tuner_config("smac")["_target_"]
    needs_its_library(target)
    tuner, group = make(locate(target, "tuner"))
    drive(tuner, group, 20 * STEPS)
    assert Mixed.space.values(tuner.recommend())[2:].tolist() == BEST


def test_optuna_knows_them_by_their_own_kinds():
    tuner, _ = make(Optuna)
    kinds = [type(d).__name__ for d in tuner._distributions.values()]
    assert (
        kinds == ["FloatDistribution"] * 2 + ["IntDistribution"] + ["CategoricalDistribution"] * 2
    )


@given(st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8))
def test_a_point_keeps_its_values_through_optunas_parameters(x):
    x = np.array(x)
    params = params_of(x, Mixed.space)
    assert list(params) == list(Mixed.space.names)
    again = point_of(params, Mixed.space)
    assert np.array_equal(again, Mixed.space.rounded(x))
    assert np.array_equal(Mixed.space.values(again), Mixed.space.values(x))
