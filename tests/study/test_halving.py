"""Halving over repetitions: many points once, the better ones again, and not one call more."""

from collections import Counter

import numpy as np
import pytest

import zoac
from zoac.core.errors import ConfigError


class Noisy:
    """A cost with noise; remembers what it was called with and what it said."""

    def __init__(self, seed=0, deviation=1.0):
        self.told, self._deviation = {}, deviation
        self._rng = np.random.default_rng(seed)

    def __call__(self, parameters):
        cost = (parameters["k"] - 1.0) ** 2 + self._deviation * self._rng.standard_normal()
        self.told.setdefault(parameters["k"], []).append(cost)
        return cost

    @property
    def calls(self):
        return sum(map(len, self.told.values()))


def tune(cost, experiments=60, **options):
    given = {"space": {"k": (-3.0, 3.0)}, "tuner": "halving", "quiet": True, **options}
    return zoac.tune(cost=cost, experiments=experiments, **given)


@pytest.mark.parametrize("experiments", [2, 3, 5, 12, 61])
def test_so_many_experiments_are_so_many_calls(experiments):
    for workers, baseline in ((3, None), (1, {"k": 2.0})):
        cost = Noisy()
        result = tune(cost, experiments, baseline=baseline, workers=workers)
        assert cost.calls == experiments
        assert result.record["experiments"] == experiments
        assert next(iter(cost.told)) == 2.0 or baseline is None


def test_every_round_measures_the_better_half_again():
    cost = Noisy(deviation=0.0)
    tune(cost, 60)
    times = Counter(map(len, cost.told.values()))
    # 15 once, 8 of them once again, 4 four times more, so that rounds cost alike, and 2 the rest.
    assert sum(times.values()) == 15
    assert (times[1], times[2], times[6]) == (7, 4, 2)
    ranks = sorted(cost.told, key=lambda k: cost.told[k][0])
    counts = [len(cost.told[k]) for k in ranks]
    assert counts == sorted(counts, reverse=True)


def test_the_answer_has_the_least_mean_and_is_not_the_luckiest():
    cost = Noisy(seed=3, deviation=3.0)
    result = tune(cost, 60)
    answer = result.parameters["k"]
    assert result.cost_per_episode == cost.told[answer]
    assert len(cost.told[answer]) >= 10
    most = [k for k, costs in cost.told.items() if len(costs) >= 10]
    assert answer == min(most, key=lambda k: np.mean(cost.told[k]))


def test_one_lucky_experiment_is_not_the_answer():
    first = []

    def cost(parameters):
        first.append(parameters["k"])
        return -100.0 if len(first) == 1 else 1000.0 * (parameters["k"] == first[0])

    result = tune(cost, 60)
    assert first.count(first[0]) > 1
    assert result.parameters["k"] != first[0]
    assert result.cost_mean == 0.0


def test_under_noise_it_finds_better_points_than_the_best_of_many():
    truth = {
        tuner: np.mean([
            (tune(Noisy(seed, 2.0), tuner=tuner, seed=seed).parameters["k"] - 1.0) ** 2
            for seed in range(3)
        ])
        for tuner in ("halving", "random")
    }  # fmt: skip
    assert truth["halving"] < 0.5 * truth["random"]


def test_a_point_that_fails_now_and_then_ranks_behind_those_that_do_not():
    count = Counter()

    def cost(parameters):
        k = parameters["k"]
        count[k] += 1
        if k < 0.0 and count[k] > 1:
            raise RuntimeError("tripped")
        return k

    assert tune(cost, 60).parameters["k"] > 0.0


def test_its_options():
    cost = Noisy()
    result = tune(cost, 40, tuner_options={"points": 4})
    assert len(cost.told) == 4
    assert result.record["experiments"] == 40
    with pytest.raises(ConfigError, match="experiments=1: tuner 'halving' learns from"):
        tune(Noisy(), 1, baseline={"k": 0.0})
