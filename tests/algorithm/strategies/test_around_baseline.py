"""A search around the baseline."""

import pytest

from tests.algorithm.strategies.test_acceptance_test import tune
from zoac.algorithm.strategies.around_baseline import around_baseline
from zoac.core.errors import ConfigError
from zoac.runs import schema


def test_start_sigma_and_step_sizes_are_set():
    options = {
        "start": "random",
        "exploration": {"segments": 5, "sigma": 0.1},
        "step_size": {"rule": "adam", "first": 0.05, "last": None, "anneal": True},
    }
    assert around_baseline(options, 0.3) == {
        "start": "baseline",
        "exploration": {"segments": 5, "sigma": 0.3},
        "step_size": {"rule": "adam", "first": pytest.approx(0.15), "last": None, "anneal": True},
    }
    flat = around_baseline({"start": "random", "sigma": 0.1, "step_size": 0.05}, 0.3)
    assert flat == {"start": "baseline", "sigma": 0.3, "step_size": pytest.approx(0.15)}
    chosen = around_baseline({"start": "random", "initial_sigma": None}, 0.03)
    assert chosen["initial_sigma"] == 0.03


@pytest.mark.parametrize("tuner", ["zoac_plus", "es", "cmaes"])
def test_the_smaller_it_is_the_nearer_the_search_stays(tuner):
    def farthest(sigma):
        folder = tune(tuner=tuner, initial_sigma=sigma, budget=200, eval_every=50).folder
        rows = [r for r in schema.read_metrics(folder) if r["kind"] == "eval"]
        return max(abs(r["parameters"]["k"] - 1.0) for r in rows)

    assert (near := farthest(0.03)) < 0.25
    assert near < farthest(0.3)


def test_a_tuner_of_ones_own_need_not_have_a_step_size():
    assert around_baseline({"start": "random", "sigma": 0.5}, 0.1) == {
        "start": "baseline", "sigma": 0.1,
    }  # fmt: skip


def test_a_tuner_that_knows_no_start_is_refused():
    with pytest.raises(ConfigError, match="initial_sigma=0.1: this tuner has no start"):
        tune(tuner="random", initial_sigma=0.1)
