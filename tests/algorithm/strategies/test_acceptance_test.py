"""Starting from today's gains: how far the search goes, and that the answer is never worse."""

from dataclasses import replace

import numpy as np
import pytest

import zoac
from tests.envs.test_adapters import Drift
from tests.support import CountingTask, engine
from zoac.algorithm.strategies import acceptance_test
from zoac.config import factory
from zoac.config.compose import compose_config, resolved
from zoac.core.errors import ConfigError
from zoac.core.segments import Proposal
from zoac.core.tuner import Problem, Tuner
from zoac.runs import schema

SMALL = {"num_envs": 2, "episodes": 1, "final_episodes": 2, "quiet": True}


class Stubborn(Tuner):
    """Asks for nothing and recommends what it was given."""

    def __init__(self, x):
        self.x = np.array(x)

    def ask(self):
        return []

    def tell(self, segments):
        return {}

    def recommend(self):
        return self.x

    def state(self):
        return None

    def restore(self, state):
        pass


def run_test(candidate, start=(0.5, 0.0), share=0.5, budget=6 * 14):
    problem = Problem(CountingTask.space, 3, 4, budget, 7, 0, baseline=np.array(start))
    return acceptance_test.AcceptanceTest(problem, lambda _: Stubborn(candidate), fraction=share)


def driven(tuner, task=None, mend=lambda segment: segment):
    group = engine(task or CountingTask(), [0, 1, 2, 3])
    while proposals := tuner.ask():
        tuner.tell([mend(segment) for segment in group.rollout(proposals)])
    return tuner


def test_the_cheaper_candidate_passes_and_the_dearer_one_does_not():
    """Cost per step is the action, parameter a, and noise that both have in common."""
    good, bad = driven(run_test([0.4, 0.0])), driven(run_test([0.6, 0.0]))
    assert good.recommend().tolist() == [0.4, 0.0]
    assert bad.recommend().tolist() == [0.5, 0.0]
    verdict = bad.outcome()["acceptance_test"]
    assert (verdict["accepted"], verdict["pairs"]) == (False, 6)
    # Seven steps; 0.1 of the mapped box is 0.5 of parameter a.
    assert verdict["candidate_cost_mean"] - verdict["baseline_cost_mean"] == pytest.approx(3.5)


def test_before_the_last_pair_the_start_stays():
    tuner, group = run_test([0.4, 0.0]), engine(CountingTask(), [0, 1, 2, 3])
    for _ in range(2):
        tuner.tell(group.rollout(tuner.ask()))
        assert tuner.recommend().tolist() == [0.5, 0.0]
    tuner.tell(group.rollout(tuner.ask()))
    assert tuner.recommend().tolist() == [0.4, 0.0]


@pytest.mark.parametrize("pairs", [0, 1, 4])
def test_too_few_pairs_accept_nothing_and_say_so_before_and_after(pairs):
    tuner = driven(run_test([0.4, 0.0], budget=14 * pairs + 13, share=1.0))
    assert tuner.recommend().tolist() == [0.5, 0.0]
    assert (
        f"pay for {pairs} pairs of episodes, and fewer than 5"
        in tuner.describe()["acceptance_test"]
    )
    text = tuner.outcome()["acceptance_test"]["text"]
    assert ("could not be run" if pairs == 0 else "fewer than 5 pairs accept nothing") in text


def test_a_search_that_recommends_the_start_values_needs_no_test_and_no_warning():
    result = tune(tuner="nominal", budget=100, acceptance_test=0.5)
    verdict = result.record["acceptance_test"]
    assert (verdict["accepted"], verdict["pairs"], result.env_steps) == (False, 0, 0)
    assert verdict["text"] == "the search recommends the baseline values themselves"
    assert result.warnings == []


class Greedy(Stubborn):
    """Asks for three whole episodes at a time, and never has enough."""

    def ask(self):
        return [Proposal(self.x, env_index) for env_index in range(3)]


@pytest.mark.parametrize("budget", [84, 130, 200, 411])
def test_the_search_leaves_the_reserved_steps_untouched(budget):
    problem = Problem(CountingTask.space, 3, 4, budget, 7, 0, baseline=np.array([0.5, 0.0]))
    tuner = acceptance_test.AcceptanceTest(problem, lambda _: Greedy([0.4, 0.0]), fraction=0.5)
    group, steps, searched = engine(CountingTask(), [0, 1, 2, 3]), 0, 0
    while proposals := tuner.ask():
        segments = group.rollout(proposals)
        tuner.tell(segments)
        steps += sum(s.length for s in segments)
        searched += sum(s.length for s in segments if s.proposal.seed is None)
    assert searched == budget // 2 // 21 * 21
    assert steps <= budget
    assert tuner.outcome()["acceptance_test"]["pairs"] == (budget - searched) // 14


@pytest.mark.parametrize("tuner", ["zoac_plus", "random", "es"])
def test_a_search_that_would_spend_the_test_is_stopped_and_no_untested_answer_given(tuner):
    """A batch of ten episodes is half of this budget."""
    task = zoac.make_task("pid_acc", max_episode_steps=50)
    options = {"tuner": tuner, "acceptance_test": 0.2, "num_envs": 10, "episodes": 1}
    result = zoac.tune(task=task, budget=1250, seed=0, final_episodes=3, quiet=True, **options)
    verdict = result.record["acceptance_test"]
    assert not verdict["accepted"]  # with so few pairs nothing is
    assert verdict["pairs"] >= 2 or verdict["candidate_is_start"]
    assert result.env_steps <= 1250
    assert result.cost_mean == result.baseline_cost_mean


@pytest.mark.parametrize(
    ("budget", "why"),
    [(60, "the test could not be run"), (100, "fewer than 5 pairs accept nothing")],
)
def test_an_acceptance_test_that_pays_for_too_little_gives_the_start_values_and_warns(
    budget, why, capsys
):
    result = tune(tuner="random", budget=budget, acceptance_test=0.3, quiet=False)
    (warning,) = result.warnings
    assert "answer is the baseline values" in warning
    assert why in result.record["acceptance_test"]["text"]
    out = " ".join(capsys.readouterr().out.split())  # as it was before it was wrapped
    assert warning in out
    assert why in out
    assert result.parameters == {"k": pytest.approx(1.0), "bias": pytest.approx(0.0)}


def test_episodes_that_are_longer_than_planned_leave_the_start_values():
    """Without a time limit the longest episode is not known."""
    start = np.array([0.5, 0.0])
    problem = Problem(CountingTask.space, 3, 4, 200, 7, 0, baseline=start)
    tuner = acceptance_test.AcceptanceTest(problem, lambda _: Greedy([0.4, 0.0]), fraction=0.5)
    group, steps = engine(CountingTask(max_episode_steps=21), [0, 1, 2, 3]), 0
    while steps < 200 and (proposals := tuner.ask()):
        segments = group.rollout(proposals)
        tuner.tell(segments)
        steps += sum(s.length for s in segments)
        if steps == 63:  # after one batch it is known, and the next one is not begun
            assert all(p.seed is not None for p in tuner.ask())
    assert steps == 63 + 3 * 42
    assert tuner.recommend().tolist() == [0.5, 0.0]


def test_a_test_that_was_not_finished_accepts_nothing():
    tuner, group = run_test([0.4, 0.0], budget=20 * 14), engine(CountingTask(), [0, 1, 2, 3])
    for _ in range(9):
        tuner.tell(group.rollout(tuner.ask()))
    verdict = tuner.outcome()["acceptance_test"]
    assert (verdict["accepted"], verdict["pairs"]) == (False, 18)
    assert verdict["text"] == "the test was not finished: 18 of 20 pairs of episodes were run"
    assert tuner.recommend().tolist() == [0.5, 0.0]


def test_a_candidate_that_terminates_where_the_start_does_not_is_not_accepted():
    def crash(segment):
        crashed = segment.proposal.x[0] == 0.4 and segment.observations[0, 2] > 0.5
        return replace(segment, terminated=bool(crashed))

    tuner = driven(run_test([0.4, 0.0], budget=20 * 14), mend=crash)
    verdict = tuner.outcome()["acceptance_test"]
    assert 0 < verdict["candidate_failures"] < 10
    assert verdict["candidate_cost_mean"] < verdict["baseline_cost_mean"]
    assert not verdict["accepted"]
    assert "in which the baseline values did not" in verdict["text"]


def test_what_all_episodes_end_in_is_no_failure_of_one_side():
    """A goal that is reached ends the episode as well."""
    task = CountingTask(ends_after=5)
    assert driven(run_test([0.4, 0.0]), task).recommend().tolist() == [0.4, 0.0]


def test_a_candidate_that_violates_constraints_is_not_accepted():
    def violate(segment):
        return replace(segment, violation=float(segment.proposal.x[0] == 0.4))

    assert driven(run_test([0.4, 0.0]), mend=violate).recommend().tolist() == [0.5, 0.0]


def test_broken_constraints_reach_the_acceptance_test_as_failures():
    result = tune(
        tuner="random", acceptance_test=0.5, constraints={"never": lambda s: np.ones(s.length)}
    )
    verdict = result.record["acceptance_test"]
    failures = verdict["start_failures"], verdict["candidate_failures"]
    assert failures == (verdict["pairs"], verdict["pairs"]) != (0, 0)


def test_plain_costs_are_compared_whatever_the_tuner_is_told():
    def regularised(segment):
        more = 100.0 if segment.proposal.x[0] == 0.4 else 0.0
        return replace(segment, costs=segment.costs + more, reported_costs=segment.costs)

    tuner = driven(run_test([0.4, 0.0]), mend=regularised)
    assert tuner.recommend().tolist() == [0.4, 0.0]
    assert tuner.outcome()["acceptance_test"]["candidate_cost_mean"] < 50


def test_pairs_meet_the_same_episode_and_no_episode_twice():
    group, tuner = engine(CountingTask(), [0, 1, 2, 3]), run_test([0.4, 0.0])
    noise = []
    for _ in range(2):
        segments = group.rollout(tuner.ask())
        noise += [float(s.observations[0, 2]) for s in segments]
        tuner.tell(segments)
    assert noise[0::2] == noise[1::2]
    assert len(set(noise)) == len(noise) / 2


def act(params, obs):
    return -params["k"] * obs[0] + params["bias"]


def tune(**changes):
    options = {"env": Drift, "controller": act, "max_episode_steps": 20, "budget": 1000,
               "space": {"k": {"low": 0, "high": 2, "baseline": 1.0},
                         "bias": {"low": -1, "high": 1, "baseline": 0.0}}}  # fmt: skip
    return zoac.tune(**{**options, **SMALL, **changes})


def test_the_acceptance_test_is_paid_from_the_budget_and_told_in_the_result():
    result = tune(tuner="random", acceptance_test=0.5)
    verdict = result.record["acceptance_test"]
    assert 1000 - 40 - 2 * 20 < result.env_steps <= 1000
    assert verdict["pairs"] >= 12
    # k = 1 is the best there is: what random search believes to be better is not.
    assert (verdict["accepted"], result.parameters["k"]) == (False, pytest.approx(1.0))


def test_an_acceptance_test_without_start_values_is_refused():
    with pytest.raises(ConfigError, match="no baseline values"):
        tune(space={"k": (0, 2), "bias": 0.0}, acceptance_test=0.2)


def test_keys_that_are_null_leave_the_runs_of_before_alone():
    before = {"task": {"a": 1}, "seed": 0}
    now = {**before, "initial_sigma": None, "acceptance_test": None}
    assert schema.config_hash(now) == schema.config_hash(before)
    assert schema.differing_keys(now, before) == {}
    assert schema.config_hash({**now, "acceptance_test": 0.2}) != schema.config_hash(before)


def test_the_command_line_has_the_same_keys():
    config = resolved(
        compose_config(
            ["task=pendulum", "tuner=cmaes", "initial_sigma=0.03", "acceptance_test=0.2"]
        )
    )
    tuner = factory.build_tuner(
        config["tuner"], factory.build_task(config), factory.build_settings(config)
    )
    assert isinstance(tuner, acceptance_test.AcceptanceTest)
    assert tuner.describe()["initial_sigma"] == pytest.approx(0.03)
    with pytest.raises(ConfigError, match="acceptance_test=2"):
        factory.build_settings({**config, "acceptance_test": 2.0})


def test_the_acceptance_test_leaves_the_tuner_its_time_beside_rollouts(monkeypatch):
    calls = []
    monkeypatch.setattr(Stubborn, "background_update", lambda self: calls.append(1))
    run_test((0.0, 0.0)).background_update()
    assert calls == [1]
