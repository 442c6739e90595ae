"""What an evaluation reports beside the cost."""

import json
from contextlib import closing

import numpy as np
import pytest

import zoac
from tests.envs.test_adapters import Drift
from tests.support import CountingTask, engine, proposal
from zoac.core.errors import ConfigError
from zoac.core.measures import RESERVED, Constraint, Metric
from zoac.core.segments import Proposal
from zoac.rollout.constraints import excess
from zoac.rollout.evaluation import evaluation_row
from zoac.rollout.executors.base import Serial
from zoac.rollout.executors.process import Process
from zoac.runs.schema import read_metrics, read_result
from zoac.tasks.user_task import user_task


def segments(episodes=1):
    return engine(CountingTask(10), [0]).rollout([proposal(0)] * episodes)


def reported(values, reduce="sum"):
    metric = Metric("m", lambda segment: np.asarray(values), reduce)
    return evaluation_row(segments(), [metric])["m"]


def test_a_sum_keeps_its_fractions_and_a_count_stays_whole():
    assert reported([0.03] * 10) == pytest.approx(0.3)
    assert np.isnan(reported([1.0] * 9 + [np.nan]))
    assert reported([1.0] * 9 + [np.inf]) == np.inf
    for counted in ([True] * 3 + [False] * 7, [1, 2] + [0] * 8, [1.0, 2.0] + [0.0] * 8):
        assert json.dumps(reported(counted)) == "3"


@pytest.mark.parametrize("returned", [0.5, np.zeros(9), np.zeros((10, 1)), None, ["a"] * 10])
def test_what_returns_no_number_per_step_is_named(returned):
    (segment,) = segments()
    with pytest.raises(ConfigError, match=r"metric 'm' returned .* one number per step, \(10,\)"):
        evaluation_row([segment], [Metric("m", lambda s: returned)])
    with pytest.raises(ConfigError, match=r"constraint 'c' returned .* per step, \(10,\)"):
        excess(segment, [Constraint("c", lambda s: returned)])


def test_the_reserved_names_are_the_keys_of_rows_and_results(tmp_path):
    zoac.tune(
        env=Drift, controller=lambda params, obs: -params["k"] * obs[0], tuner="random",
        space={"k": {"low": 0, "high": 2, "baseline": 1.0}}, budget=400,
        acceptance_test=0.5, num_envs=2,
        select="best_evaluated",
        constraints={"left": lambda s: s.observations[1:, 0]}, signals={"y": zoac.observation(0)},
        specs=[zoac.specs.peak("y", max=1.0)], episodes=1, final_episodes=1,
        max_episode_steps=5, quiet=True, folder=tmp_path,
    )  # fmt: skip
    rows = [row for row in read_metrics(tmp_path) if row["kind"] == "eval"]
    keys = set(read_result(tmp_path)).union(*rows)
    early = {"stopped_by", "finished", "evaluated_after_steps"}  # of a run that was stopped
    others = {"experiments", "best_trial", "failed_episodes"}
    assert keys - {"solver_failures"} | early | others == RESERVED


@pytest.mark.parametrize("name", ["cost_mean", "terminations", "acceptance_test", "finished"])
def test_a_metric_cannot_take_the_place_of_what_is_reported_anyway(name):
    with pytest.raises(ConfigError, match=f"metric '{name}': results have .* 'my_{name}'"):
        zoac.tune(
            env=Drift, controller=lambda params, obs: 0.0, space={"k": (0, 2)}, budget=10,
            metrics={name: lambda s: s.costs}, max_episode_steps=5, quiet=True,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Metric("m", np.ravel, "max"), "unknown reduce 'max'; .*known: mean, sum"),
        (lambda: Metric("m", "tank.level"), "metric 'm': expected a function of a segment"),
        (lambda: Metric(3, np.ravel), "name of a metric must be text, got 3"),
        (lambda: Constraint("c", np.ravel, np.nan), "scale=nan, expected a number above zero"),
        (lambda: Constraint("c", np.ravel, "5"), "scale='5', expected a number above zero"),
    ],
)
def test_a_quantity_that_cannot_be_used_is_refused_where_it_is_made(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


def test_no_function_of_a_segment_changes_what_others_read():
    (segment,) = segments()

    def careless(s):
        costs = s.costs
        costs *= 0.0
        return costs

    before = segment.costs.copy()
    with pytest.raises(ConfigError, match="metric 'm' raised ValueError: .* read-only"):
        evaluation_row([segment], [Metric("m", careless)])
    assert np.array_equal(segment.costs, before)


def test_a_failure_in_an_evaluation_is_told_alike_by_every_executor(forked_workers):
    def picky(params, obs):
        if obs[0] > 1.3:
            raise ValueError("too far")
        return -params["k"] * obs[0]

    task = user_task(env=Drift, controller=picky, space={"k": (1.0, 2.0)}, max_episode_steps=5)
    task.failure_penalty = 9.0
    told = []
    for executor in (Serial(), Process(workers=2)):
        executor.start(task, 2, seed=0)
        with closing(executor):
            asked = [Proposal(np.zeros(1), i, seed=i) for i in range(30)]
            told.append([segment.failure for segment in executor.evaluate(asked)])
    assert told[0] == told[1]
    assert any(told[0])
