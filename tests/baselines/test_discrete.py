"""Surrogate models on whole numbers and choices: they believe nothing between the values."""

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


EPISODES = 25


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


def make(tuner, **options):
    mixed = problem(episodes=EPISODES, space=Mixed.space, start=np.zeros(Mixed.space.dimension))
    return tuner(mixed, initial_design=10, **options), RolloutEngine(
        Mixed(), range(NUM_ENVS), range(NUM_ENVS)
    )


def test_the_process_sees_points_that_stand_for_values_and_asks_such():
    tuner, group = make(BayesOpt)
    asked = drive(tuner, group, 20 * STEPS)
    seen = tuner._process.X_train_
    assert len(seen) >= 15
    assert np.array_equal(seen * 2.0 - 1.0, Mixed.space.rounded(seen * 2.0 - 1.0))
    np.testing.assert_allclose(asked[-1], Mixed.space.rounded(asked[-1]), atol=1e-12)


def test_its_real_parameters_stay_as_they_were_drawn():
    drawn = np.random.default_rng(0).uniform(size=(1000, Mixed.space.dimension)) ** 4
    assert np.array_equal(rounded_points(Mixed.space, drawn)[:, :2], drawn[:, :2])


@pytest.mark.parametrize(
    "tuner", [(BayesOpt, {"noise": 0.1}), (Optuna, {}), (Optuna, {"sampler": "tpe"})]
)
def test_the_best_values_are_found(tuner):
    tuner, group = make(tuner[0], **tuner[1])
    drive(tuner, group, EPISODES * STEPS)
    found = Mixed.space.values(tuner.recommend())
    assert found[2:].tolist() == [0.0, 0.5, -0.1]
    assert np.abs(found[:2] - TARGET[:2]).max() < 0.4


@pytest.mark.parametrize("name", ["botorch", "smac"])
def test_a_librarys_model_that_is_made_anew_finds_them_too(name):
    target = tuner_config(name)["_target_"]
    needs_its_library(target)
    tuner, group = make(locate(target, "tuner"))
    drive(tuner, group, 20 * STEPS)
    assert Mixed.space.values(tuner.recommend())[2:].tolist() == [0.0, 0.5, -0.1]


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
