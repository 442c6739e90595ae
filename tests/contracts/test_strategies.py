"""Every strategy around every tuner, both found by their files."""

import importlib
import inspect
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import zoac.strategies
from tests.contracts.test_pairs import names
from tests.support import CountingTask, engine
from zoac.config import factory
from zoac.config.compose import compose_config, resolved
from zoac.core.state import decode, encode
from zoac.core.tuner import Problem, Tuner
from zoac.strategies.acceptance_test import AcceptanceTest
from zoac.strategies.base import TunerStrategy
from zoac.strategies.best_evaluated import SELECTION_FRACTION, BestEvaluated
from zoac.strategies.held_out import search_budget
from zoac.strategies.held_specs import FRACTION, HeldSpecs
from zoac.strategies.initial_design import CommonRandomNumbers, InitialDesign

BUDGET, NUM_ENVS, STEPS = 210, 4, 7


def with_budget_left(problem, fraction):
    return replace(problem, budget=search_budget(problem.budget, fraction))


MAKE = {
    AcceptanceTest: lambda p, build: AcceptanceTest(build(with_budget_left(p, 0.4)), p, 0.4),
    BestEvaluated: lambda p, build: BestEvaluated(
        build(with_budget_left(p, SELECTION_FRACTION)), p, every=70
    ),
    InitialDesign: lambda p, build: InitialDesign(p, 6, build),
    HeldSpecs: lambda p, build: HeldSpecs(build(with_budget_left(p, FRACTION)), p),
    CommonRandomNumbers: lambda p, build: CommonRandomNumbers(build(p), p.seed),
}


def strategies():
    for path in Path(zoac.strategies.__file__).parent.glob("*.py"):
        module = importlib.import_module(f"zoac.strategies.{path.stem}")
        for thing in vars(module).values():
            if inspect.isclass(thing) and issubclass(thing, TunerStrategy):
                yield thing


def make(strategy, tuner):
    node = resolved(compose_config([f"tuner={tuner}"]))["tuner"]
    baseline = CountingTask.space.normalise(CountingTask.baseline)
    problem = Problem(CountingTask.space, 3, NUM_ENVS, BUDGET, STEPS, 0, start=baseline,
                      baseline=baseline)  # fmt: skip
    return MAKE[strategy](problem, lambda p: factory.build(node, "tuner", Tuner, problem=p))


def run(made, remake=None):
    """Run to the end of the budget; return what was asked, the answer and the steps of batches."""
    environments, asked, batches = engine(CountingTask(STEPS), list(range(NUM_ENVS))), [], []
    while sum(batches) < BUDGET and (proposals := made.ask()):
        asked += [(p.x, p.env_index, p.horizon, p.restore, p.seed) for p in proposals]
        segments = environments.rollout(proposals)
        batches.append(sum(segment.length for segment in segments))
        made.tell(segments)
        if remake is not None and len(batches) % 3 == 1:
            state = made.state()
            made = remake()
            made.restore(decode(encode(state)))
    return asked, made.recommend(), batches


def test_every_strategy_is_tested_here():
    assert {s for s in strategies() if not inspect.isabstract(s)} - {TunerStrategy} == set(MAKE)


@pytest.mark.parametrize("tuner", names("tuner"))
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
    killed = run(make(strategy, tuner), remake=lambda: make(strategy, tuner))
    np.testing.assert_equal(killed, (asked, answer, batches))
