"""A run whose answer is worse than what was there says so, everywhere."""

import numpy as np
import pytest

import zoac
from tests.envs.test_adapters import Drift
from tests.runs.training.ziegler_nichols import PI, SPACE, STEPS, Plant
from tests.support import CountingTask
from zoac.analysis import report
from zoac.analysis.data.load import load
from zoac.config.compose import compose_config, resolved
from zoac.core.parameters import Parameter
from zoac.runs.schema import read_metrics, read_result
from zoac.runs.training.answer_checks import warnings
from zoac.runs.training.lifecycle import run_session


def result_of(costs, **more):
    return {
        "cost_per_episode": list(costs), "cost_mean": float(np.mean(costs)), "terminations": 0,
        "x": [0.0], **more,
    }  # fmt: skip


def evaluation(costs, steps=100, x=1.0, **more):
    return {**result_of(costs, **more), "env_steps": steps, "x": [x]}


NOISE = np.random.default_rng(0).normal(10.0, 2.0, 20)


def test_an_answer_as_good_as_the_start_is_nothing_to_warn_of():
    assert warnings(result_of(NOISE), []) == []
    assert warnings(result_of(NOISE, start=result_of(NOISE)), []) == []
    other = np.random.default_rng(1).normal(9.8, 2.0, 20)
    assert warnings(result_of(NOISE, start=result_of(other)), []) == []


def test_an_answer_worse_than_the_start_is_told_with_both_costs():
    (told,) = warnings(result_of(NOISE + 1, baseline=result_of(NOISE)), [])
    assert f"cost {NOISE.mean() + 1:.4g} instead of {NOISE.mean():.4g}" in told
    assert "worse than the baseline values" in told
    assert "same 20 final episodes" in told


@pytest.mark.parametrize("key", ["terminations", "violations"])
def test_an_answer_that_fails_more_often_is_told_even_if_it_is_cheaper(key):
    start = result_of(NOISE, violations=0)
    answer = result_of(NOISE - 5, baseline=start, **{"violations": 0, key: 1})
    (told,) = warnings(answer, [])
    assert "more often than the baseline values: in 1 of 20 final episodes instead of 0" in told


def test_values_at_the_edge_of_a_range_are_told_where_a_spec_is_not_met():
    """Seen on a loop whose feasible integral gains were the lowest 0.4% of their range."""
    parameters = [Parameter("ki", 0.0, 0.5), Parameter("kp", 0.0, 20.0),
                  Parameter("tf", 1e-3, 1.0, "log")]  # fmt: skip
    values = {"ki": 0.0027, "kp": 1.1, "tf": 0.0011}
    unmet = {"spec": "overshoot", "limit": "<= 0.03", "value": 0.06, "broken": 20, "met": False}
    _, told = warnings(result_of(NOISE, specs=[unmet], parameters=values), [], parameters)
    assert told.startswith("ki=0.0027 lies at the edge of its range 0 to 0.5")
    met = {**unmet, "met": True}
    assert warnings(result_of(NOISE, specs=[met], parameters=values), [], parameters) == []


def test_broken_constraints_are_told_by_name():
    broken = {"torque": {"episodes": 3, "steps": 9, "worst": 0.1}, "speed": {"episodes": 0}}
    (told,) = warnings(result_of(NOISE, violations=3, violations_by_constraint=broken), [])
    assert told == "The constraint torque is broken in 3 of 20 final episodes."


def test_a_cost_that_is_not_finite_is_told():
    assert "not finite in 1 of 2" in warnings(result_of([1.0, np.nan]), [])[0]


def test_an_answer_that_fails_at_a_price_is_told():
    def trips(params, obs):
        if obs[0] > 1.0:
            raise RuntimeError("overspeed trip")
        return -params["k"] * obs[0]

    result = zoac.tune(
        env=Drift, controller=trips, space={"k": (0, 2)}, tuner="random", budget=100, quiet=True,
        max_episode_steps=5, final_episodes=4, failure_penalty=0.01,
    )  # fmt: skip
    count = result.record["failed_episodes"]["count"]
    assert 0 < count < 4
    (told,) = result.warnings
    assert told.startswith(f"The answer failed in {count} of 4 final episodes. The first: ")
    assert "RuntimeError: overspeed trip" in told


def test_an_earlier_evaluation_that_was_clearly_better_is_told():
    """Evaluations while tuning are the first of the final episodes."""
    rows = [evaluation(NOISE[:10] + 3), evaluation(NOISE[:10] - 1, steps=200, x=2.0)]
    (told,) = warnings(result_of(NOISE), rows)
    assert "after 200 steps" in told
    assert f"cost {NOISE[:10].mean() - 1:.4g} instead of {NOISE[:10].mean():.4g}" in told


@pytest.mark.parametrize("failed", [np.nan, np.inf, -np.inf])
def test_an_earlier_evaluation_that_failed_hides_none_that_was_better(failed):
    rows = [evaluation([failed] * 10), evaluation(NOISE[:10] - 1, steps=200, x=2.0)]
    (told,) = warnings(result_of(NOISE), rows)
    assert "after 200 steps" in told


def test_an_earlier_evaluation_is_not_better_by_chance_or_by_breaking_constraints():
    rng = np.random.default_rng(2)
    lucky = [evaluation(rng.normal(10.0, 2.0, 10), x=k + 1.0) for k in range(30)]
    assert warnings(result_of(NOISE), lucky) == []
    assert warnings(result_of(NOISE), [evaluation(NOISE[:10] - 0.01)]) == []
    assert warnings(result_of(NOISE, violations=0), [evaluation(NOISE - 5, violations=1)]) == []


def test_of_two_that_break_requirements_as_often_the_cheaper_is_not_called_better():
    assert warnings(result_of(NOISE, violations=20), [evaluation(NOISE - 5, violations=20)]) == []
    assert warnings(result_of(NOISE, violations=20), [evaluation(NOISE - 5, violations=0)]) != []


def test_one_episode_of_several_different_ones_shows_nothing():
    assert warnings(result_of(NOISE), [evaluation(NOISE[:1] - 5)]) == []
    assert warnings(result_of([10.0] * 20), [evaluation([5.0])]) != []


@pytest.mark.parametrize(("episodes", "violations", "told"), [(2, 3, True), (10, 3, False),
                                                             (2, 0, False)])  # fmt: skip
def test_few_held_out_episodes_are_told_where_the_answer_breaks_specs(episodes, violations, told):
    result = result_of(NOISE, violations=violations, held_specs={"episodes": episodes})
    assert any("Only 2 held-out" in sentence for sentence in warnings(result, [])) == told


def tune(tuner, budget=2000, **options):
    return zoac.tune(
        env=Plant, controller=PI(), space=SPACE, max_episode_steps=STEPS, tuner=tuner,
        budget=budget, quiet=True, eval_every=1000, episodes=4, final_episodes=10, **options,
    )  # fmt: skip


def test_from_ziegler_nichols_gains_the_published_method_may_get_worse_and_says_so(tmp_path):
    """As published its answer is the last iterate, here at one and a half times the cost."""
    result = tune("zoac", folder=tmp_path / "run")
    assert result.cost_mean > 1.5 * result.baseline_cost_mean
    worse, earlier = result.warnings
    assert worse.startswith("The answer is worse than the baseline values: cost 1.399")
    assert earlier.startswith("An earlier evaluation, after 0 steps, was clearly better")
    assert worse in " ".join(repr(result).split())
    assert read_result(tmp_path / "run")["warnings"] == [worse, earlier]
    assert zoac.load_result(tmp_path / "run").warnings == [worse, earlier]
    runs = load(tmp_path)
    page = report.report(runs, [runs.finished[0].method.task], replay=False)
    assert worse in page
    assert "the baseline values cost <b>" in page


def test_from_ziegler_nichols_gains_zoac_plus_returns_nothing_worse():
    """If the baseline values are no candidate, the answer costs twice as much."""
    result = tune("zoac_plus", 5000)
    assert result.cost_mean <= result.baseline_cost_mean
    assert result.warnings == []


def test_the_best_evaluated_recommendation_can_be_the_answer_of_any_tuner():
    result = tune("zoac", 3000, select="best_evaluated")
    assert result.cost_mean <= result.baseline_cost_mean
    assert result.warnings == []


def test_results_and_first_evaluations_of_the_command_line_say_what_the_baseline_costs(tmp_path):
    options = ("task=pendulum", "tuner=random", "budget=400", "evaluation.episodes=2",
               "evaluation.final_episodes=2", f"runs_dir={tmp_path}")  # fmt: skip
    result = run_session(resolved(compose_config(options)), "pendulum", "random", [])
    assert result["baseline_cost_mean"] == result["baseline"]["cost_mean"]
    assert len(result["baseline"]["cost_per_episode"]) == 2
    assert "warnings" in result
    (folder,) = (file.parent for file in tmp_path.rglob("metrics.jsonl"))
    first, *others = (r for r in read_metrics(folder) if r["kind"] == "eval")
    assert first["baseline_cost_mean"] == result["baseline_cost_mean"]  # the same two episodes
    assert first["baseline_cost_mean"] != first["cost_mean"]
    assert not any("baseline_cost_mean" in row for row in others)


class Regularised(CountingTask):
    """Tuners are told a hundred more a step than an episode costs."""

    def tuning_costs(self, segment):
        return segment.costs + 100.0


@pytest.mark.parametrize("tuner", ["zoac_plus", "random"])
def test_plain_costs_decide_and_are_logged_where_the_tuner_is_told_more(tuner, tmp_path):
    result = zoac.tune(
        task=Regularised(), tuner=tuner, budget=1000, acceptance_test=0.4,
        num_envs=4, final_episodes=4,
        quiet=True, folder=tmp_path, eval_every=500,
        tuner_options={"recommendation": "reevaluated"} if tuner == "random" else {},
    )  # fmt: skip
    verdict, rows = result.record["acceptance_test"], read_metrics(tmp_path)
    assert abs(verdict["baseline_cost_mean"]) < 100
    assert abs(verdict["candidate_cost_mean"]) < 100
    chosen = {"zoac_plus": "select_best_cost", "random": "reevaluated_best"}[tuner]
    for name in (chosen, "acceptance_baseline_cost", "acceptance_candidate_cost"):
        told = [row[name] for row in rows if name in row]
        assert told
        assert max(map(abs, told)) < 100
    # Seven steps of parameter a = 1, and common noise.
    assert result.baseline_cost_mean == pytest.approx(result.record["baseline"]["cost_mean"])
    assert abs(result.baseline_cost_mean - 7) < 30
