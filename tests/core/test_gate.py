"""Starting from today's gains: how far the search goes, and that the answer is never worse."""

from dataclasses import replace

import numpy as np
import pytest

import zoac
from tests.core.test_adapters import Drift
from tests.support import CountingTask, lane_group
from zoac import build, gate, records
from zoac.config import compose_config, resolved
from zoac.errors import ConfigError
from zoac.segments import Proposal
from zoac.tuner import Problem, Tuner

SMALL = {"lanes": 2, "episodes": 1, "final_episodes": 2, "quiet": True}


class Stubborn(Tuner):
    """Asks for nothing and recommends what it was given."""

    def __init__(self, z):
        self.z = np.array(z)

    def ask(self):
        return []

    def tell(self, segments):
        return {}

    def recommend(self):
        return self.z

    def state(self):
        return None

    def restore(self, state):
        pass


def gated(candidate, start=(0.5, 0.0), share=0.5, budget=6 * 14):
    problem = Problem(CountingTask.space, 3, 4, budget, 7, 0, np.array(start))
    return gate.Gate(Stubborn(candidate), problem, share)


def driven(tuner, task=None, mend=lambda segment: segment):
    group = lane_group(task or CountingTask(), [0, 1, 2, 3])
    while proposals := tuner.ask():
        tuner.tell([mend(segment) for segment in group.rollout(proposals)])
    return tuner


def test_the_cheaper_candidate_passes_and_the_dearer_one_does_not():
    """Cost per step is the action, parameter a, and noise that both have in common."""
    good, bad = driven(gated([0.4, 0.0])), driven(gated([0.6, 0.0]))
    assert good.recommend().tolist() == [0.4, 0.0]
    assert bad.recommend().tolist() == [0.5, 0.0]
    verdict = bad.outcome()["gate"]
    assert (verdict["accepted"], verdict["pairs"]) == (False, 6)
    # Seven steps; 0.1 of the mapped box is 0.5 of parameter a.
    assert verdict["candidate_cost_mean"] - verdict["start_cost_mean"] == pytest.approx(3.5)


def test_before_the_last_pair_the_start_stays():
    tuner, group = gated([0.4, 0.0]), lane_group(CountingTask(), [0, 1, 2, 3])
    for _ in range(2):
        tuner.tell(group.rollout(tuner.ask()))
        assert tuner.recommend().tolist() == [0.5, 0.0]
    tuner.tell(group.rollout(tuner.ask()))
    assert tuner.recommend().tolist() == [0.4, 0.0]


@pytest.mark.parametrize("pairs", [0, 1, 4])
def test_too_few_pairs_accept_nothing_and_say_so_before_and_after(pairs):
    tuner = driven(gated([0.4, 0.0], budget=14 * pairs + 13, share=1.0))
    assert tuner.recommend().tolist() == [0.5, 0.0]
    assert f"pay for {pairs} pairs of episodes, and fewer than 5" in tuner.describe()["gate"]
    text = tuner.outcome()["gate"]["text"]
    assert ("could not be run" if pairs == 0 else "fewer than 5 pairs accept nothing") in text


def test_a_search_that_recommends_the_start_values_needs_no_test_and_no_warning():
    result = tune(tuner="nominal", budget=100, gate=0.5)
    verdict = result.record["gate"]
    assert (verdict["accepted"], verdict["pairs"], result.env_steps) == (False, 0, 0)
    assert verdict["text"] == "the search recommends the start values themselves"
    assert result.warnings == []


class Greedy(Stubborn):
    """Asks for three whole episodes at a time, and never has enough."""

    def ask(self):
        return [Proposal(self.z, lane) for lane in range(3)]


@pytest.mark.parametrize("budget", [84, 130, 200, 411])
def test_the_search_leaves_the_reserved_steps_untouched(budget):
    problem = Problem(CountingTask.space, 3, 4, budget, 7, 0, np.array([0.5, 0.0]))
    tuner = gate.Gate(Greedy([0.4, 0.0]), problem, 0.5)
    group, steps, searched = lane_group(CountingTask(), [0, 1, 2, 3]), 0, 0
    while proposals := tuner.ask():
        segments = group.rollout(proposals)
        tuner.tell(segments)
        steps += sum(s.length for s in segments)
        searched += sum(s.length for s in segments if s.proposal.seed is None)
    assert searched == budget // 2 // 21 * 21
    assert steps <= budget
    assert tuner.outcome()["gate"]["pairs"] == (budget - searched) // 14


@pytest.mark.parametrize("tuner", ["zoac_plus", "random", "cmaes_full", "es"])
def test_a_search_that_would_spend_the_test_is_stopped_and_no_untested_answer_given(tuner):
    """Cruise control with episodes of 1000 steps: a batch is half of this budget."""
    folder_of = {"tuner": tuner, "gate": 0.2, "seed": 0, "quiet": True, "episodes": 1}
    result = zoac.tune(task="pid_acc", budget=25_000, final_episodes=3, **folder_of)
    verdict = result.record["gate"]
    assert not verdict["accepted"]  # with so few pairs nothing is
    assert verdict["pairs"] >= 2 or verdict["candidate_is_start"]
    assert result.env_steps <= 25_000
    assert result.cost_mean == result.start_cost_mean


@pytest.mark.parametrize(
    ("budget", "why"),
    [(60, "the test could not be run"), (100, "fewer than 5 pairs accept nothing")],
)
def test_a_gate_that_pays_for_too_little_gives_the_start_values_and_warns(budget, why, capsys):
    result = tune(tuner="random", budget=budget, gate=0.3, quiet=False)
    (warning,) = result.warnings
    assert "answer is the start values" in warning
    assert why in result.record["gate"]["text"]
    out = capsys.readouterr().out
    assert warning in out
    assert why in out
    assert result.parameters == {"k": pytest.approx(1.0), "bias": pytest.approx(0.0)}


def test_episodes_that_are_longer_than_planned_leave_the_start_values():
    """Without a time limit the longest episode is not known."""
    start = np.array([0.5, 0.0])
    problem = Problem(CountingTask.space, 3, 4, 200, 7, 0, start)
    tuner = gate.Gate(Greedy([0.4, 0.0]), problem, 0.5)
    group, steps = lane_group(CountingTask(max_episode_steps=21), [0, 1, 2, 3]), 0
    while steps < 200 and (proposals := tuner.ask()):
        segments = group.rollout(proposals)
        tuner.tell(segments)
        steps += sum(s.length for s in segments)
        if steps == 63:  # after one batch it is known, and the next one is not begun
            assert all(p.seed is not None for p in tuner.ask())
    assert steps == 63 + 3 * 42
    assert tuner.recommend().tolist() == [0.5, 0.0]


def test_a_test_that_was_not_finished_accepts_nothing():
    tuner, group = gated([0.4, 0.0], budget=20 * 14), lane_group(CountingTask(), [0, 1, 2, 3])
    for _ in range(9):
        tuner.tell(group.rollout(tuner.ask()))
    verdict = tuner.outcome()["gate"]
    assert (verdict["accepted"], verdict["pairs"]) == (False, 18)
    assert verdict["text"] == "the test was not finished: 18 of 20 pairs of episodes were run"
    assert tuner.recommend().tolist() == [0.5, 0.0]


def test_a_candidate_that_terminates_where_the_start_does_not_is_not_accepted():
    def crash(segment):
        crashed = segment.proposal.z[0] == 0.4 and segment.observations[0, 2] > 0.5
        return replace(segment, terminated=bool(crashed))

    tuner = driven(gated([0.4, 0.0], budget=20 * 14), mend=crash)
    verdict = tuner.outcome()["gate"]
    assert 0 < verdict["candidate_failures"] < 10
    assert verdict["candidate_cost_mean"] < verdict["start_cost_mean"]
    assert not verdict["accepted"]
    assert "in which the start values did not" in verdict["text"]


def test_what_all_episodes_end_in_is_no_failure_of_one_side():
    """A goal that is reached ends the episode as well."""
    task = CountingTask(ends_after=5)
    assert driven(gated([0.4, 0.0]), task).recommend().tolist() == [0.4, 0.0]


def test_a_candidate_that_violates_constraints_is_not_accepted():
    def violate(segment):
        return replace(segment, violation=float(segment.proposal.z[0] == 0.4))

    assert driven(gated([0.4, 0.0]), mend=violate).recommend().tolist() == [0.5, 0.0]


def test_broken_constraints_reach_the_gate_as_failures():
    result = tune(tuner="random", gate=0.5, constraints={"never": lambda s: np.ones(s.length)})
    verdict = result.record["gate"]
    failures = verdict["start_failures"], verdict["candidate_failures"]
    assert failures == (verdict["pairs"], verdict["pairs"]) != (0, 0)


def test_plain_costs_are_compared_whatever_the_tuner_is_told():
    def regularised(segment):
        more = 100.0 if segment.proposal.z[0] == 0.4 else 0.0
        return replace(segment, costs=segment.costs + more, reported_costs=segment.costs)

    tuner = driven(gated([0.4, 0.0]), mend=regularised)
    assert tuner.recommend().tolist() == [0.4, 0.0]
    assert tuner.outcome()["gate"]["candidate_cost_mean"] < 50


def test_pairs_meet_the_same_episode_and_no_episode_twice():
    group, tuner = lane_group(CountingTask(), [0, 1, 2, 3]), gated([0.4, 0.0])
    noise = []
    for _ in range(2):
        segments = group.rollout(tuner.ask())
        noise += [float(s.observations[0, 2]) for s in segments]
        tuner.tell(segments)
    assert noise[0::2] == noise[1::2]
    assert len(set(noise)) == len(noise) / 2


def test_a_restored_gate_goes_on_to_the_same_answer():
    one, other = gated([0.4, 0.0]), gated([0.4, 0.0])
    one.tell(lane_group(CountingTask(), [0, 1, 2, 3]).rollout(one.ask()))
    other.restore(one.state())
    assert [p.seed for p in one.ask()] == [p.seed for p in other.ask()]
    assert driven(one).outcome() == driven(other).outcome()


def act(params, obs):
    return -params["k"] * obs[0] + params["bias"]


def tune(**changes):
    options = {"env": Drift, "controller": act, "max_episode_steps": 20, "budget": 1000,
               "space": {"k": {"low": 0, "high": 2, "start": 1.0},
                         "bias": {"low": -1, "high": 1, "start": 0.0}}}  # fmt: skip
    return zoac.tune(**{**options, **SMALL, **changes})


def test_the_gate_is_paid_from_the_budget_and_told_in_the_result():
    result = tune(tuner="random", gate=0.5)
    verdict = result.record["gate"]
    assert 1000 - 40 - 2 * 20 < result.env_steps <= 1000
    assert verdict["pairs"] >= 12
    # k = 1 is the best there is: what random search believes to be better is not.
    assert (verdict["accepted"], result.parameters["k"]) == (False, pytest.approx(1.0))


def test_a_gate_without_start_values_is_refused():
    with pytest.raises(ConfigError, match="no start values"):
        tune(space={"k": (0, 2), "bias": 0.0}, gate=0.2)


def test_trust_sets_start_and_spread():
    options = {"start": "random", "sigma": 0.1, "step_size": 0.05}
    assert gate.trusted(options, 0.0) == {
        "start": "nominal", "sigma": pytest.approx(0.3), "step_size": pytest.approx(0.15)
    }  # fmt: skip
    assert gate.trusted({"start": "random", "spread": None}, 1.0)["spread"] == pytest.approx(0.03)


@pytest.mark.parametrize("tuner", ["zoac", "zoac_plus", "es", "cmaes"])
def test_the_more_trust_the_nearer_the_search_stays(tuner):
    def farthest(trust):
        folder = tune(tuner=tuner, trust=trust, budget=300, eval_every=50).folder
        rows = [r for r in records.read_metrics(folder) if r["kind"] == "eval"]
        return max(abs(r["parameters"]["k"] - 1.0) for r in rows)

    assert farthest(1.0) < 0.25
    assert farthest(1.0) < farthest(0.0)


def test_trust_leaves_steps_that_are_not_set():
    options = {"start": "random", "sigma": 0.1, "step_size": 0.02, "step_size_end": None}
    trusting = gate.trusted(options, 1.0)
    assert (trusting["step_size"], trusting["step_size_end"]) == (pytest.approx(0.006), None)


def test_trust_in_a_tuner_that_knows_no_start_is_refused():
    with pytest.raises(ConfigError, match="trust needs a tuner with a start and a spread"):
        tune(tuner="random", trust=0.5)


def test_keys_that_are_null_leave_the_runs_of_before_alone():
    before = {"task": {"a": 1}, "seed": 0}
    now = {**before, "trust": None, "gate": None}
    assert records.config_hash(now) == records.config_hash(before)
    assert records.differing_keys(now, before) == {}
    assert records.config_hash({**now, "gate": 0.2}) != records.config_hash(before)


def test_the_command_line_has_the_same_keys():
    config = resolved(compose_config(["task=pendulum", "tuner=cmaes", "trust=1", "gate=0.2"]))
    tuner = build.build_tuner(
        config["tuner"], build.build_task(config), build.build_settings(config)
    )
    assert isinstance(tuner, gate.Gate)
    assert tuner.describe()["spread"] == pytest.approx(0.03)
    with pytest.raises(ConfigError, match="gate=2"):
        build.build_settings({**config, "gate": 2.0})


def test_the_gate_leaves_the_tuner_its_time_beside_rollouts(monkeypatch):
    calls = []
    monkeypatch.setattr(Stubborn, "meanwhile", lambda self: calls.append(1))
    gated((0.0, 0.0)).meanwhile()
    assert calls == [1]
