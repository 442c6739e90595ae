"""Every strategy around every kind of tuner, both found by their files."""

import importlib
import inspect
from copy import deepcopy
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from omegaconf import OmegaConf

import zoac.algorithm.strategies
from tests.baselines.support import tuner_config
from tests.contracts.test_pairs import names
from tests.support import CountingTask, engine
from zoac.algorithm.strategies.acceptance_test import AcceptanceTest
from zoac.algorithm.strategies.base import TunerStrategy
from zoac.algorithm.strategies.final_selection import FinalSelection
from zoac.algorithm.strategies.held_specs import HeldSpecs
from zoac.algorithm.strategies.initial_design import CommonRandomNumbers, InitialDesign
from zoac.algorithm.strategies.successive_halving import SuccessiveHalving
from zoac.config import factory
from zoac.config.compose import compose_config, resolved
from zoac.config.settings import Settings
from zoac.core.errors import ConfigError
from zoac.core.state import decode, encode
from zoac.core.tuner import Problem

BUDGET, NUM_ENVS, STEPS = 210, 4, 7
OPTIONS = {"optuna": {"sampler": "tpe"}}  # the other is slow
LIKE_ANOTHER = ("botorch", "smac", "bo", "nevergrad", "cmaes", "cmaes_full", "cmaes_plus")
"""To a strategy they are what `random`, `optuna` and `zoac_plus` are."""


MAKE = {
    AcceptanceTest: partial(AcceptanceTest, fraction=0.4),
    CommonRandomNumbers: CommonRandomNumbers,
    FinalSelection: partial(FinalSelection, fraction=0.4),
    HeldSpecs: HeldSpecs,
    InitialDesign: partial(InitialDesign, count=6),
    SuccessiveHalving: partial(SuccessiveHalving, rounds=3),
}


def strategies():
    for path in Path(zoac.algorithm.strategies.__file__).parent.glob("*.py"):
        module = importlib.import_module(f"zoac.algorithm.strategies.{path.stem}")
        for thing in vars(module).values():
            if inspect.isclass(thing) and issubclass(thing, TunerStrategy):
                yield thing


def make(strategy, tuner):
    node = tuner_config(tuner) | OPTIONS.get(tuner, {})
    baseline = CountingTask.space.normalise(CountingTask.baseline)
    problem = Problem(CountingTask.space, 3, NUM_ENVS, BUDGET, STEPS, 0, start=baseline,
                      baseline=baseline)  # fmt: skip
    return MAKE[strategy](problem, lambda p: factory.build_tuner_for(node, p, Settings()))


def run(made, remake=None):
    """Run to the end of the budget; return what was asked, the answer and the steps of batches."""
    environments, asked, batches = engine(CountingTask(STEPS), list(range(NUM_ENVS))), [], []
    while sum(batches) < BUDGET and (proposals := made.ask()):
        asked += [(p.x, p.env_index, p.horizon, p.restore, p.seed) for p in proposals]
        segments = environments.rollout(proposals)
        batches.append(sum(segment.length for segment in segments))
        made.tell(segments)
        if remake is not None and len(batches) % 3 == 1:
            encoded = encode(made.state())
            made = remake()
            made.restore(decode(encoded))
    return asked, made.recommend(), batches


def test_every_strategy_is_tested_here():
    assert {s for s in strategies() if not inspect.isabstract(s)} - {TunerStrategy} == set(MAKE)


@pytest.mark.parametrize("tuner", [n for n in names("tuner") if n not in LIKE_ANOTHER])
@pytest.mark.parametrize("strategy", MAKE)
def test_a_strategy_keeps_the_contract_of_a_tuner(strategy, tuner):
    made = make(strategy, tuner)
    asked, answer, batches = run(made)
    assert sum(batches) < BUDGET + max(batches, default=1)
    assert answer.shape == (2,)
    assert np.abs(answer).max() <= 1.0
    before = encode(made.state()).plain
    np.testing.assert_array_equal(made.recommend(), answer)
    assert encode(made.state()).plain == before
    assert bool(encode(made.state()).objects) == (tuner == "optuna")  # no strategy needs a pickle
    killed = run(make(strategy, tuner), remake=lambda: make(strategy, tuner))
    np.testing.assert_equal(killed, (asked, answer, batches))


@cache
def composed_for(tuner):
    return compose_config([f"tuner={tuner}", "budget=400", "num_envs=4"])


def composed(*overrides, tuner="zoac"):
    config = deepcopy(composed_for(tuner))
    for key, value in (text.split("=", 1) for text in overrides):
        OmegaConf.update(config, key, yaml.safe_load(value), force_add=True)
    config = resolved(config)
    return factory.build_tuner(config["tuner"], CountingTask(), factory.build_settings(config))


def test_strategies_are_composed_by_configuration_the_first_the_outermost():
    made = composed(
        "tuner.strategies.successive_halving.fraction=0.25",
        "tuner.strategies.final_selection={candidates: 5}",
        "common_random_numbers=true",
        tuner="es",
    )
    choices = made.describe()
    assert choices["start"] == "successive halving, 25% of the budget"
    assert choices["recommendation"].startswith("best of 6 recommendations")
    assert choices["episodes"] == "common to a batch"
    assert isinstance(made, SuccessiveHalving)
    assert isinstance(made._tuner, FinalSelection)
    asked, answer, _ = run(made)
    assert {p[4] is None for p in asked} == {False}
    assert answer.shape == (2,)


def test_a_strategy_of_ones_own_is_named_by_its_target():
    path = "zoac.algorithm.strategies.initial_design.CommonRandomNumbers"
    made = composed(f"tuner.strategies.mine._target_={path}", tuner="random")
    assert isinstance(made, CommonRandomNumbers)


HALVING = "zoac.algorithm.strategies.successive_halving.SuccessiveHalving"


@pytest.mark.parametrize("setting", ["initial_samples=4", "initial_sigma=0.1"])
def test_a_run_that_says_where_to_begin_has_no_successive_halving(setting):
    made = composed(setting, tuner="cmaes_plus")
    assert isinstance(made, FinalSelection)
    assert "halving" not in made.describe()["start"]


def test_a_run_that_says_how_its_answer_is_selected_selects_once():
    made = composed("select=best_evaluated", "eval_every=100", tuner="cmaes_plus")
    assert isinstance(made, FinalSelection)  # of the whole run, around the halving
    assert isinstance(made._tuner, SuccessiveHalving)
    assert not isinstance(made._tuner._tuner, FinalSelection)


@pytest.mark.parametrize(
    ("overrides", "told"),
    [([], ""), (["tuner.start=baseline"], ", the baseline values take part")],
)
def test_the_tuners_start_takes_part_in_successive_halving(overrides, told):
    made = composed(*overrides, tuner="cmaes_plus")
    assert made.describe()["start"] == f"successive halving, 30% of the budget{told}"


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["tuner.strategies.final_selektion={}"], "did you mean 'final_selection'"),
        (["tuner.strategies=[final_selection]"], "expected options by name"),
        (["tuner.strategies.final_selection=5"], "final_selection=5: expected its options"),
        (["tuner.strategies.mine._target_=os.getcwd"], "tuner.strategies.mine._target_"),
        (
            [f"tuner.strategies.mine._target_={HALVING}", "initial_samples=4"],
            "mine and initial_samples=4: each looks for a start",
        ),
        (["tuner.strategies.final_selection.fraction=2"], "tuner.strategies.final_selection.frac"),
        (["tuner.strategies.successive_halving={}"], "this tuner takes none"),
        (["tuner.strategies.mine._target_=zoac.baselines.es.EvolutionStrategy"], "mine._target_"),
    ],
)
def test_strategies_that_cannot_be_are_refused(overrides, message):
    with pytest.raises(ConfigError, match=message):
        composed(*overrides, tuner="random")


def test_a_start_is_given_or_looked_for():
    with pytest.raises(ConfigError, match="initial_sigma gives"):
        composed("initial_samples=4", "initial_sigma=0.1")
