from dataclasses import replace

import nevergrad as ng
import numpy as np
import pytest

from tests.baselines.support import STEPS, drive, engine, problem
from zoac.baselines.cmaes import CmaEs
from zoac.baselines.nevergrad import Nevergrad
from zoac.core.errors import ConfigError
from zoac.core.parameters import Parameter, ParameterSpace

# Differential evolution, chained choices, a swarm, a one-shot design, one that draws from numpy's
# global random state (CMA).
NAMES = ["TwoPointsDE", "NGO", "PSO", "ScrHammersleySearch", "CMA"]


@pytest.mark.parametrize("name", NAMES)
def test_any_optimiser_restores_exactly(name):
    np.random.seed(3)  # noqa: NPY002
    tuner, group = Nevergrad(problem(episodes=500), name=name), engine()
    drive(tuner, group, 15 * STEPS)
    np.random.seed(4)  # noqa: NPY002
    twin, twin_group = Nevergrad(problem(episodes=500), name=name), engine()
    twin.restore(tuner.state())
    twin_group.restore(group.state())
    expected = drive(tuner, group, 15 * STEPS)
    asked = drive(twin, twin_group, 15 * STEPS)
    assert all(map(np.array_equal, asked, expected))
    assert np.array_equal(twin.recommend(), tuner.recommend())


def test_the_global_random_state_is_left_alone():
    np.random.seed(3)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    drive(Nevergrad(problem(episodes=500), name="CMA"), engine(), 20 * STEPS)
    assert np.array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_points_come_one_by_one_where_the_library_allows_no_more():
    assert len(Nevergrad(problem(), name="TinySPSA").ask()) == 1
    assert len(Nevergrad(problem(), name="PSO").ask()) == 5


def test_unknown_name_is_refused_with_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'TwoPointsDE'"):
        Nevergrad(problem(), name="TwoPointDE")


def test_a_package_that_lacks_is_named():
    with pytest.raises(ConfigError, match="fcmaes"):
        Nevergrad(problem(), name="FCMA").ask()


@pytest.mark.parametrize("name", ["Powell", "ChainMetaModelSQP", "NgIohTuned"])
def test_an_optimiser_that_is_or_holds_one_without_ask_and_tell_is_refused(name):
    with pytest.raises(ConfigError, match=r"without ask and tell.*such as TwoPointsDE"):
        Nevergrad(replace(problem(episodes=500), num_envs=1), name=name)


def spread_of_first_generations(tuner, n=60):
    """Standard deviation of points drawn before anything is told."""
    return np.concatenate([[p.x for p in tuner.ask()] for _ in range(n)]).std()


def test_cma_starts_with_the_std_that_it_describes():
    tuner = CmaEs(problem(), start="middle", initial_sigma=0.2, population=20)
    assert tuner.describe()["initial_sigma"] == pytest.approx(0.2)
    assert spread_of_first_generations(tuner, 15) == pytest.approx(0.2, rel=0.05)


def test_the_librarys_own_std_is_described_as_it_is():
    tuner = CmaEs(problem(), start="middle")
    described = tuner.describe()
    assert described["covariance"] == "diagonal"
    assert described["elitist"] is True
    assert spread_of_first_generations(tuner) == pytest.approx(described["initial_sigma"], rel=0.05)


def test_a_generation_is_the_population_asked_for():
    tuner = CmaEs(problem(), population=3)
    assert len(tuner.ask()) == tuner.describe()["population"] == 3


@pytest.mark.parametrize("first", [0.6, 0.9])
def test_parameters_that_do_not_matter_stay_within_a_third_of_the_box(first):
    """With this seed they would reach 0.83 and 1.06."""
    tuner = CmaEs(problem(seed=7), initial_sigma=first, population=6)
    largest = []
    for _ in range(3):
        x = tuner._ask_library(6)
        tuner._tell_library(np.array([point[0] for point in x]))
        largest.append((tuner._strategy.stds * tuner._initial_sigma).max())
    assert max(largest) == pytest.approx(max(2 / 3, first))  # as far as it may


def test_without_options_it_is_the_librarys_cma():
    tuner = CmaEs(problem())
    plain = ng.optimizers.registry["CMA"](
        ng.p.Array(init=tuner.recommend(), lower=-1.0, upper=1.0), budget=100, num_workers=5
    )
    described = CmaEs(problem()).describe()
    tuner.ask()
    plain.ask()
    assert described["population"] == plain.optim.es.popsize
    assert described["initial_sigma"] == pytest.approx(plain.optim.es.sigma0 / 3.0)


def test_mean_recommends_the_mean_of_the_search_distribution():
    tuner = CmaEs(
        problem(), population=100, initial_sigma=0.3, start="middle", recommendation="mean"
    )
    assert np.allclose(tuner.recommend(), 0.0)
    drive(tuner, engine(), STEPS)
    mean = tuner.recommend()
    assert 0.05 < np.linalg.norm(mean) < 0.9
    own = CmaEs(problem(), population=100, initial_sigma=0.3, start="middle")
    drive(own, engine(), STEPS)
    assert not np.array_equal(own.recommend(), mean)


def test_a_single_parameter_is_no_problem_for_cma_es():
    one = replace(problem(), space=ParameterSpace([Parameter("a", 0.0, 1.0)]))
    with pytest.raises(ConfigError, match="needs two parameters or more"):
        CmaEs(one)


@pytest.mark.parametrize("name", ["ScrHammersleySearch", "TwoPointsDE", "EDA"])
def test_an_optimiser_that_ignores_its_initial_value_evaluates_the_baseline_first(name):
    """EDA learns from no point but its own."""
    start = np.full(5, 0.9)
    tuner = Nevergrad(problem(start=start), name=name, start="baseline")
    group = engine()
    first = group.rollout(tuner.ask())
    assert np.allclose(first[0].proposal.x, start)
    assert not any(np.allclose(s.proposal.x, start) for s in first[1:])
    tuner.tell(first)
    assert tuner.ask()
