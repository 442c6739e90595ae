"""`select=best_evaluated`: the answer is the best of the recommendations that were evaluated."""

import numpy as np
import pytest

import zoac
from tests.runs.training.test_trainer import RUN
from tests.support import CountingTask, engine
from zoac.algorithm.strategies import acceptance_test
from zoac.algorithm.strategies.final_selection import FinalSelection, best_evaluated
from zoac.config import factory
from zoac.config.compose import compose_config, resolved
from zoac.core.errors import ConfigError
from zoac.core.measures import CLOCKS
from zoac.core.segments import Proposal
from zoac.core.tuner import Problem, Tuner
from zoac.rollout.evaluation import evaluation_proposals
from zoac.rollout.executors.base import Serial
from zoac.runs.log import RunLog
from zoac.runs.schema import read_metrics
from zoac.runs.training.trainer import Interrupted, Trainer


class Wanderer(Tuner):
    """Recommends the next of some values of parameter a after every episode."""

    def __init__(self, path):
        self.path, self.at = list(path), 0

    def ask(self):
        return [Proposal(self.recommend(), 0)]

    def tell(self, segments):
        self.at += 1
        return {}

    def recommend(self):
        return np.array([self.path[min(self.at, len(self.path) - 1)], 0.0])

    def state(self):
        return self.at

    def restore(self, state):
        self.at = state


PATH = (0.9, 0.3, -0.4, 0.2, 0.5, 0.7, 0.8)
"""The cost of an episode grows with a: the third recommendation is the best."""


def make(path=PATH, budget=1000, every=7, baseline=None, **more):
    x = None if baseline is None else np.array([baseline, 0.0])
    problem = Problem(CountingTask.space, 3, 4, budget, 7, 0, x, baseline=x)
    return best_evaluated(problem, lambda _: Wanderer(path), every=every, **more)


def drive(tuner, group=None, batches=None):
    group, told = group or engine(CountingTask(), range(4)), []
    while (batches is None or len(told) < batches) and (proposals := tuner.ask()):
        segments = group.rollout(proposals)
        tuner.tell(segments)
        told.append(segments)
    return told


def test_a_tuner_that_passed_the_best_and_went_on_returns_to_it():
    tuner = make()
    batches = drive(tuner)
    assert tuner.recommend()[0] == -0.4
    assert tuner.outcome()["select"]["recommended_at"] == 2 * 7
    assert sum(s.length for batch in batches for s in batch) <= 1000


def test_the_baseline_is_a_candidate_and_may_win():
    tuner = make(baseline=-0.6)
    drive(tuner)
    assert tuner.recommend()[0] == -0.6
    assert tuner.outcome()["select"]["recommended_at"] is None


def test_only_what_was_evaluated_is_a_candidate():
    tuner = make(every=21)
    drive(tuner)
    assert tuner.recommend()[0] == 0.2  # after 0, 3, 6 ... episodes; the best was passed between


def test_it_is_chosen_on_episodes_that_nothing_else_sees():
    held_out = {
        s.proposal.seed for batch in drive(make()) for s in batch if s.proposal.seed is not None
    }
    final = {p.seed for p in evaluation_proposals(np.zeros(2), 100, 0)}
    assert len(held_out) > 5
    assert not held_out & final


def test_all_candidates_of_a_round_meet_the_same_episodes_and_half_of_them_stay():
    fields = []
    for batch in drive(make()):
        if batch[0].proposal.seed is None:
            continue
        candidates = {s.proposal.x[0] for s in batch}
        for seed in {s.proposal.seed for s in batch}:
            assert {s.proposal.x[0] for s in batch if s.proposal.seed == seed} == candidates
        fields.append(len(candidates))
    assert sorted(set(fields), reverse=True) == [7, 4, 2]
    assert fields == sorted(fields, reverse=True)


def test_a_small_budget_has_fewer_candidates_and_keeps_the_last_one():
    tuner = make(budget=5 * 14)  # a fifth of it is an episode of two candidates
    batches = drive(tuner)
    chosen_from = {s.proposal.x[0] for b in batches for s in b if s.proposal.seed is not None}
    assert len(chosen_from) <= 2
    assert PATH[-1] in chosen_from


@pytest.mark.parametrize(("episodes", "rounds"), [(7, [7]), (14, [7, 4]), (21, [7, 4, 2])])
def test_there_are_as_many_rounds_as_the_reserved_steps_pay_for(episodes, rounds):
    batches = drive(make(budget=5 * 7 * episodes + 7))
    among = [len({s.proposal.x[0] for s in b}) for b in batches if b[0].proposal.seed is not None]
    assert sorted(set(among), reverse=True) == rounds


def test_a_small_fraction_is_raised_to_an_episode_of_two_candidates():
    problem = Problem(CountingTask.space, 3, 4, 100, 7, 0)
    batches = drive(FinalSelection(problem, lambda _: Wanderer(PATH), fraction=0.01))
    held_out = [s for batch in batches for s in batch if s.proposal.seed is not None]
    assert len({s.proposal.x[0] for s in held_out}) == 2
    assert sum(s.length for batch in batches for s in batch) <= 100


def test_a_budget_for_no_choice_is_spent_to_its_end_by_the_search():
    problem = Problem(CountingTask.space, 3, 4, 20, 7, 0)  # episodes of 7, and a choice takes 14
    batches = drive(FinalSelection(problem, lambda _: Wanderer(PATH)))
    assert [s.length for batch in batches for s in batch] == [7, 7, 7]


def test_a_budget_for_no_choice_is_refused_with_what_is_needed():
    with pytest.raises(ConfigError, match="may take 14 steps.* is 13; give a budget of 70"):
        make(budget=65)


def test_it_goes_together_with_the_acceptance_test():
    baseline = np.array([0.0, 0.0])
    whole = Problem(CountingTask.space, 3, 4, 2000, 7, 0, baseline, baseline=baseline)
    tuner = acceptance_test.AcceptanceTest(
        whole, lambda left: make(budget=left.budget, baseline=0.0), fraction=0.5
    )
    drive(tuner)
    assert tuner.recommend()[0] == -0.4
    assert tuner.outcome()["acceptance_test"]["accepted"]


def test_last_is_what_a_run_does_anyway(tmp_path):
    def run(select):
        folder = tmp_path / str(select)
        return zoac.tune(
            task=CountingTask(), tuner="random", budget=300, num_envs=2, quiet=True, select=select,
            folder=folder, eval_every=50,
        )  # fmt: skip

    assert run("last").parameters == run(None).parameters
    result = run("best_evaluated")
    evaluated = [r for r in read_metrics(tmp_path / "best_evaluated") if r["kind"] == "eval"]
    assert result.parameters in [row["parameters"] for row in evaluated] or (
        result.parameters == CountingTask.baseline
    )
    assert result.env_steps <= 300


def test_another_word_is_refused():
    with pytest.raises(ConfigError, match="select='best'"):
        zoac.tune(task=CountingTask(), budget=300, select="best", quiet=True)


@pytest.mark.parametrize("tuner", ["zoac_plus", "random"])
def test_a_run_killed_at_any_batch_gives_the_bits_of_one_that_was_not(tuner, tmp_path):
    """With selection and acceptance test, through checkpoints."""
    overrides = [f"tuner={tuner}", "acceptance_test=0.3", "select=best_evaluated",
                 "budget=500", "num_envs=4",
                 "eval_every=200", "evaluation.episodes=2",
                 "evaluation.final_episodes=3"]  # fmt: skip
    config = resolved(compose_config(overrides))
    settings = factory.build_settings(config)

    def run(folder, stop):
        task, executor = CountingTask(), Serial()
        made = factory.build_tuner(config["tuner"], task, settings)
        executor.start(task, settings.num_envs, settings.seed)
        log = RunLog(folder, RUN)
        try:
            return Trainer(task, made, executor, settings, log, stop).run()
        except Interrupted:
            return None
        finally:
            log.close()

    folders = [tmp_path / name for name in ("whole", "killed")]
    for folder in folders:
        folder.mkdir()
    whole, killed, kills = run(folders[0], lambda: False), None, 0
    while killed is None:  # every process carries out one batch and is stopped
        killed, kills = run(folders[1], lambda: True), kills + 1
    assert kills > 15
    assert whole["acceptance_test"]["pairs"] > 5
    assert without_clocks(killed) == without_clocks(whole)
    rows = [list(map(without_clocks, read_metrics(folder))) for folder in folders]
    assert rows[0] == rows[1]


def without_clocks(row):
    return {key: value for key, value in row.items() if key not in CLOCKS}
