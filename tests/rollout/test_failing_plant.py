"""An environment that fails: a message, or with a penalty a terminated episode, counted."""

import json
from contextlib import closing

import numpy as np
import pytest

import zoac
from tests.envs.test_adapters import Drift
from tests.support import CountingTask, CountingVecEnv, engine, proposal, same_segment
from zoac.core.errors import ConfigError, EnvironmentFailure, NothingWorksError
from zoac.core.measures import Constraint, Metric
from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.evaluation import evaluation_row
from zoac.rollout.executors.process import Process
from zoac.runs.schema import read_metrics
from zoac.tasks.user_task import user_task


class Breaking(Drift):
    """Fails where it is pushed by more than 0.5, at the third step or later."""

    made = 0

    def __init__(self, way="raises"):
        type(self).made += 1
        self.way, self.count, self.broken = way, 0, False

    def reset(self, **options):
        assert not self.broken, "used after it raised"
        self.count = 0
        return super().reset(**options)

    def step(self, action):
        assert not self.broken, "used after it raised"
        self.count += 1
        observation, reward, _, _, info = super().step(action)
        if action[0] > 0.5 and self.count >= 3:
            if self.way == "raises":
                self.broken = True
                raise FloatingPointError("diverged")
            if self.way == "observation":
                observation = np.array([np.inf])
            else:
                reward = np.nan
        return observation, reward, False, False, info


def push(params, obs):
    return params["k"]


def task(way="raises", penalty=50.0, **options):
    made = user_task(env=lambda: Breaking(way), controller=push, space={"k": (0.0, 1.0)},
                     max_episode_steps=7, **options)  # fmt: skip
    made.failure_penalty = penalty
    return made


def at(k, env_index=0, **kind):
    return Proposal(np.array([2.0 * k - 1.0]), env_index, **kind)


def group(env_indices, way="raises", penalty=50.0):
    return RolloutEngine(task(way, penalty), env_indices, [100 + index for index in env_indices])


WAYS = pytest.mark.parametrize("way", ["raises", "observation", "cost"])


@WAYS
def test_with_a_penalty_the_episode_terminates_at_that_cost(way):
    bad, good = group([0, 1], way).rollout([at(0.9), at(0.1, 1)])
    assert (bad.length, bad.terminated, bad.truncated, bad.costs[-1]) == (3, True, False, 50.0)
    assert np.isfinite(bad.observations).all()
    assert "step 2 of its episode, parameters: k=0.9" in bad.failure
    assert (good.length, good.truncated, good.failure) == (7, True, None)


@WAYS
def test_without_one_the_run_stops_with_the_place_and_the_remedy(way):
    with pytest.raises(EnvironmentFailure, match=r"step 2 .* k=0.9\. With failure_penalty=<cost>"):
        group([0], way, penalty=None).rollout([at(0.9)])


def test_an_environment_that_raised_is_made_anew_and_one_that_did_not_is_kept():
    for way, anew in (("raises", 1), ("cost", 0)):
        engine = group([0], way)
        before = Breaking.made
        _, after = engine.rollout([at(0.9), at(0.1)])
        assert (Breaking.made - before, after.length, after.starts_episode) == (anew, 7, True)


@WAYS
@pytest.mark.parametrize("kind", [{}, {"horizon": 4}, {"restore": True}, {"seed": 3}])
def test_processes_company_and_a_resume_give_the_same_bits(way, kind):
    first = [at(k, env_index, **kind) for k in (0.9, 0.7) for env_index in (0, 1)]
    then = [at(k, env_index) for k in (0.1, 0.8, 0.2) for env_index in (0, 1)]
    whole = group([0, 1], way)
    expected = [*whole.rollout(first), *whole.rollout(then)]
    alone = [group([env_index], way) for env_index in (0, 1)]
    for env_index in (0, 1):
        mine = [p for p in [*first, *then] if p.env_index == env_index]
        wanted = [s for s in expected if s.proposal.env_index == env_index]
        for one, other in zip(alone[env_index].rollout(mine), wanted, strict=True):
            assert same_segment(one, other)
    stopped, resumed = group([0, 1], way), group([0, 1], way)
    stopped.rollout(first)
    resumed.restore(stopped.state())
    for one, other in zip(resumed.rollout(then), expected[len(first) :], strict=True):
        assert same_segment(one, other)
        assert one.failure == other.failure


def test_an_executor_with_processes_prices_them_alike(forked_workers):
    plan = [at(k, env_index) for k in (0.9, 0.1, 0.7) for env_index in (0, 1)]
    with closing(Process(workers=2)) as executor:
        executor.start(task(), 2, seed=0)
        told = [(s.failure, s.length, s.costs[-1]) for s in executor.rollout(plan)]
    assert [f is not None for f, *_ in told] == [True, True, False, False, True, True]
    assert all((length, cost) == (3, 50.0) for f, length, cost in told if f)


class Stubborn(Drift):
    """Its second reset fails."""

    resets = 0

    def reset(self, **options):
        self.resets += 1
        if self.resets == 2:
            raise OSError("no licence")
        return super().reset(**options)


@pytest.mark.parametrize("kind", [{}, {"restore": True}])
def test_a_reset_that_fails_costs_one_step(kind):
    made = user_task(env=Stubborn, controller=push, space={"k": (0, 1)}, max_episode_steps=3)
    made.failure_penalty = 50.0
    engine = RolloutEngine(made, [0], [1])
    first, failed, third = engine.rollout([at(0.1), at(0.1, **kind), at(0.1)])
    assert (first.length, third.length, third.failure) == (3, 3, None)
    assert (failed.length, failed.terminated, failed.costs.tolist()) == (1, True, [50.0])
    assert "reset raised OSError: no licence. Environment 0, step 0" in failed.failure
    made.failure_penalty = None
    with pytest.raises(EnvironmentFailure, match="no licence.*With failure_penalty"):
        RolloutEngine(made, [0], [1]).rollout([at(0.1), at(0.1)])


class NanLanes(CountingVecEnv):
    def _advance(self, actions):
        costs, ended = super()._advance(actions)
        return np.where(actions[:, 0] > 8, np.nan, costs), ended


class NanTask(CountingTask):
    failure_penalty = 50.0

    def make_env(self, n):
        return NanLanes(n, *self._options)


def test_environments_of_a_vectorised_environment_fail_by_what_is_not_finite():
    bad, good = engine(NanTask(), [0, 1]).rollout([proposal(0, a=9), proposal(1, a=5)])
    assert (bad.costs.tolist(), bad.terminated, good.length) == ([50.0], True, 7)
    assert same_segment(good, engine(NanTask(), [1]).rollout([proposal(1, a=5)])[0])


def test_a_fault_against_the_interface_is_no_failure_of_the_plant():
    class Odd(Drift):
        def step(self, action):
            return np.zeros(1), 0.0, False, {}

    made = user_task(env=Odd, controller=push, space={"k": (0, 1)}, max_episode_steps=3)
    made.failure_penalty = 50.0
    with pytest.raises(Exception, match="step returned 4 values"):
        RolloutEngine(made, [0], [1]).rollout([at(0.1)])


SMALL = {"budget": 300, "num_envs": 2, "episodes": 2, "final_episodes": 2, "quiet": True,
         "max_episode_steps": 7, "env": Breaking, "controller": push, "space": {"k": (0, 1)},
         "tuner": "random"}  # fmt: skip


def tune(**changes):
    return zoac.tune(**{**SMALL, **changes})


@pytest.mark.parametrize("tuner", ["zoac", "zoac_plus", "random"])
def test_failures_are_counted_and_the_first_is_kept(tmp_path, tuner, capsys):
    space = {"k": (0, 1), "other": (0, 1)}
    whole = {"halving_rounds": 1} if tuner == "zoac_plus" else {}  # parts may end before a failure
    result = tune(failure_penalty=100.0, folder=tmp_path / "run", tuner=tuner, quiet=False,
                  space=space, tuner_options=whole)  # fmt: skip
    record = json.loads((tmp_path / "run" / "result.json").read_text())
    assert record["failures"] > 0
    first = record["first_failure"]
    assert "raised FloatingPointError: diverged. " in first
    assert [r["first_failure"] for r in read_metrics(result.folder) if "first_failure" in r] == [
        first
    ]
    counted = [r["failures"] for r in read_metrics(result.folder) if "failures" in r]
    assert counted == sorted(counted)
    assert counted[-1] == record["failures"]
    out = " ".join(capsys.readouterr().out.split())  # as it was before it was wrapped
    assert f"the first step that failed, priced: {first}" in out
    assert f"failures: {record['failures']}, the first: {first}" in out
    assert np.isfinite(result.cost_mean)


def misspelt(params, obs):
    return -params["kp"] * obs[0] - params["Kd"]


def test_a_typo_is_no_result_and_gets_the_nearest_name():
    with pytest.raises(NothingWorksError, match=r"10 episodes .* first step.*'Kd'.*mean 'kd'"):
        tune(controller=misspelt, space={"kp": (0, 5), "kd": (0, 5)}, failure_penalty=100.0)


def test_a_typo_without_a_penalty_gets_the_nearest_name_of_tuned_and_fixed_ones():
    with pytest.raises(Exception, match="did you mean 'kd'. known: kd, kp"):
        tune(controller=misspelt, space={"kp": (0, 5), "kd": 2.0})


def test_a_run_in_which_every_episode_failed_later_has_no_result():
    def later(params, obs):
        return 1.0  # Breaking fails at its third step

    with pytest.raises(NothingWorksError, match="failed before it ended.*diverged"):
        tune(controller=later, failure_penalty=100.0)


def test_metrics_and_constraints_leave_failed_steps_out():
    metrics = [Metric("mean", lambda s: s.diagnostics["a"]),
               Metric("sum", lambda s: s.diagnostics["a"], "sum")]  # fmt: skip
    limits = [Constraint("c", lambda s: s.diagnostics["a"] - 4.0)]
    bad, good = engine(NanTask(), [0, 1]).rollout([proposal(0, a=9), proposal(1, a=5)])
    row = evaluation_row([bad, good], metrics, limits)
    assert (row["mean"], row["sum"], row["violations"]) == (5.0, 35, 1)
    row = evaluation_row([bad], metrics, limits)
    assert (row["mean"], row["sum"], row["violations"]) == (None, 0, 0)
    json.dumps(row, allow_nan=False)


class Sometimes:
    """Fails at its first step for three quarters of the parameters; diagnoses otherwise."""

    def init(self, n):
        return {}

    def act(self, params, obs, memory):
        if (params["k"] > 0.25).any():
            raise ValueError("infeasible")
        return params["k"][:, None], memory, {"effort": params["k"]}


def test_a_metric_of_diagnostics_survives_controllers_that_fail_at_their_first_step():
    result = tune(controller=Sometimes(), failure_penalty=100.0, budget=100,
                  metrics={"effort": lambda s: s.diagnostics["effort"]},
                  constraints={"little": lambda s: s.diagnostics["effort"] - 1.0})  # fmt: skip
    first = next(row for row in read_metrics(result.folder) if row["kind"] == "eval")
    assert np.isnan(first["effort"])  # null in the file
    assert result.record["effort"] == pytest.approx(result.parameters["k"])


def test_a_configuration_error_is_never_priced():
    class Undoes(Drift):
        mass = 1.0

        def reset(self, **options):
            self.mass = 1.0
            return super().reset(**options)

    with pytest.raises(ConfigError, match="reset sets 'mass'"):
        tune(env=Undoes, plant={"mass": 2.0}, failure_penalty=100.0)
