"""Tuners over many problems: scores, profiles, who is better how often, tables."""

from itertools import product

import numpy as np
import pandas as pd
import pytest

from tests import commands
from zoac.analysis import suite
from zoac.analysis.statistics import profiles
from zoac.core.errors import RunFolderError

SEEDS = range(5)


def runs(costs, experiments=30):
    """A frame of {(problem, tuner): costs of the seeds}."""
    return pd.DataFrame(
        [
            {"problem": p, "parameters": 2, "tuner": t, "experiments": experiments, "seed": s,
             "cost": c, "seconds": 1.0}
            for (p, t), values in costs.items()
            for s, c in enumerate(values)
        ]
    )  # fmt: skip


def test_a_score_is_the_part_of_the_way_from_the_best_to_random_search():
    frame = runs({("a", "random"): [10, 14, 12], ("a", "bo"): [2, 7, np.nan]})
    scored = profiles.with_scores(frame).set_index(["tuner", "seed"])["score"]
    assert scored["bo", 0] == 0.0
    assert scored["bo", 1] == 0.5
    assert scored["bo", 2] == np.inf
    assert scored["random", 2] == 1.0


def test_a_run_that_failed_is_worse_than_one_that_did_not():
    frame = runs({("a", "random"): [5, 6, 7], ("a", "bo"): [np.nan, np.nan, 1.0],
                  ("a", "es"): [3, 3, 3]})  # fmt: skip
    scored = profiles.with_scores(frame)
    bo, es = (scored[scored["tuner"] == name] for name in ("bo", "es"))
    assert profiles.improvement(bo, es).estimate == pytest.approx(1 / 3)


def test_a_tuner_that_fails_in_every_seed_of_a_problem_is_compared_on_all():
    frame = runs({(p, t): costs for p in "ab"
                  for t, costs in {"random": [5, 6, 7], "bo": [1, 1, 1]}.items()})  # fmt: skip
    frame.loc[(frame["problem"] == "a") & (frame["tuner"] == "bo"), "cost"] = np.nan
    frame.loc[len(frame)] = ["a", 2, "es", 30, 0, 1.0, 1.0]  # something beats random search there
    scored = profiles.with_scores(frame)
    bo, random = (scored[scored["tuner"] == name] for name in ("bo", "random"))
    assert profiles.improvement(bo, random).estimate == 0.5


def test_random_search_that_fails_is_no_reference():
    frame = runs({("a", "random"): [5, 6, 7], ("a", "bo"): [1, 1, 1],
                  ("b", "random"): [9, np.nan, np.nan], ("b", "bo"): [1, 1, 1]})  # fmt: skip
    assert set(profiles.with_scores(frame)["problem"]) == {"a"}
    text = suite.markdown(profiles.failures_last(frame), "random")
    assert "random search fails in half of its runs there, or more: b." in text


def test_the_median_cost_of_a_tuner_counts_the_runs_that_failed(tmp_path, capsys):
    frame = runs({("a", "random"): [5, 6, 7], ("a", "bo"): [np.nan, np.nan, 1.0],
                  ("a", "es"): [3, np.nan, 4]})  # fmt: skip
    frame.to_csv(tmp_path / "suite.csv", index=False)
    arguments = [str(tmp_path / "suite.csv"), "--out", str(tmp_path / "out"), "--format", "svg"]
    assert suite.main(arguments) == 0
    assert "| a | 30 | failed | **4** | 6 |" in capsys.readouterr().out


def test_the_reference_is_random_search_with_the_fewest_experiments():
    few, many = runs({("a", "random"): [12.0]}), runs({("a", "random"): [2.0]}, 300)
    scored = profiles.with_scores(pd.concat([few, many]))
    assert list(scored["score"]) == [1.0, 0.0]


def test_a_problem_that_random_search_solves_tells_nothing():
    frame = runs({("easy", "random"): [1, 1, 1], ("easy", "bo"): [1, 2, 1],
                  ("a", "random"): [5, 6, 7], ("a", "bo"): [1, 2, 3]})  # fmt: skip
    assert set(profiles.with_scores(frame)["problem"]) == {"a"}
    assert "or no run beats it: easy." in suite.markdown(frame, "random")


def test_scores_need_runs_of_random_search():
    both = runs({("a", "random"): [5.0], ("a", "bo"): [1.0], ("b", "bo"): [1.0]})
    assert set(profiles.with_scores(both)["problem"]) == {"a"}
    with pytest.raises(RunFolderError, match="scores need runs of tuner=random"):
        profiles.with_scores(runs({("a", "bo"): [1.0]}))


def test_the_probability_of_improvement_is_that_of_all_pairs():
    rng = np.random.default_rng(0)
    a = {(p, "bo"): rng.normal(size=5) for p in "abc"}
    b = {(p, "es"): rng.normal(0.3, 1.0, 5) for p in "abcd"}
    b["a", "es"][0] = a["a", "bo"][0]  # equal costs count half
    pairs = [
        np.mean([(x < y) + 0.5 * (x == y) for x, y in product(a[p, "bo"], b[p, "es"])])
        for p in "abc"
    ]
    found = profiles.improvement(runs(a), runs(b))
    assert found.estimate == pytest.approx(np.mean(pairs))
    assert found.low < found.estimate < found.high


def test_intervals_cover_the_spread_between_problems():
    """All seeds of a problem agree, so the interval is that of a mean over the problems."""
    values = {(str(k), "bo"): [float(k % 2)] * 5 for k in range(40)}
    frame = runs(values).assign(score=lambda f: f["cost"])
    found = profiles.mean_score(frame)
    assert found.estimate == 0.5
    half = 1.96 * 0.5 / np.sqrt(40)
    assert found.low == pytest.approx(0.5 - half, abs=0.03)
    assert found.high == pytest.approx(0.5 + half, abs=0.03)


def test_a_mean_score_counts_each_score_at_most_once():
    frame = runs({("a", "bo"): [0.0, 1e9], ("b", "bo"): [np.inf, 0.0]})
    assert profiles.mean_score(frame.assign(score=frame["cost"])).estimate == 0.5


def test_experiments_needed_are_the_fewest_with_which_most_runs_are_near():
    at = {30: [0.9, 0.01, 0.9], 100: [0.01, 0.04, 0.9], 300: [0.0, 0.0, 0.0]}
    frame = pd.concat(
        [runs({("a", "bo"): scores, ("a", "es"): [0.5] * 3}, n) for n, scores in at.items()]
    )
    needed = profiles.experiments_needed(frame.assign(score=frame["cost"]))
    assert needed.loc["a", "bo"] == 100
    assert np.isnan(needed.loc["a", "es"])


def test_a_profile_counts_the_scores_up_to_each_limit():
    assert list(profiles.share_within(np.array([0.0, 0.5, np.inf]), [0.0, 0.5, 9.0])) == [
        pytest.approx(1 / 3), pytest.approx(2 / 3), pytest.approx(2 / 3),
    ]  # fmt: skip


def test_seeds_that_a_problem_lacks_are_not_compared():
    whole = runs({("a", "bo"): [1.0, 2.0, 3.0], ("b", "bo"): [1.0, 2.0]})
    assert profiles.mean_score(whole.assign(score=[0.0, 1.0, 1.0, 0.0, 0.0])).estimate == 0.25


@pytest.fixture
def file(tmp_path):
    frame = runs({(p, t): [k + j for k in SEEDS] for p in "ab"
                  for j, t in enumerate(("bo", "es", "random"))})  # fmt: skip
    frame.to_csv(tmp_path / "suite.csv", index=False)
    return tmp_path / "suite.csv"


def test_the_command_reads_what_it_wrote(file, tmp_path, capsys):
    first, again = tmp_path / "first", tmp_path / "again"
    assert suite.main([str(file), "--out", str(first), "--format", "svg"]) == 0
    assert suite.main([str(first / "suite.csv"), "--out", str(again), "--format", "svg"]) == 0
    for name in ("suite.csv", "suite.md", "suite.svg"):
        assert (first / name).read_bytes() == (again / name).read_bytes()
    assert "| BO |" in (first / "suite.md").read_text()


def test_a_tuner_without_runs_is_named(file, capsys):
    assert suite.main([str(file), "--out", str(file.parent), "--against", "bp"]) == 1
    assert "no run of tuner 'bp'; did you mean 'bo'?" in capsys.readouterr().err


def test_a_file_of_something_else_and_a_run_twice_are_refused(file, tmp_path, capsys):
    other = tmp_path / "other.csv"
    other.write_text("a,b\n1,2\n")
    assert suite.main([str(other), "--out", str(tmp_path)]) == 1
    assert "no column 'problem'" in capsys.readouterr().err
    frame = pd.read_csv(file)
    pd.concat([frame, frame.head(1)]).to_csv(file, index=False)
    assert suite.main([str(file), "--out", str(tmp_path)]) == 1
    assert "two runs of problem a, tuner bo, experiments 30, seed 0" in capsys.readouterr().err
    frame.assign(cost=["two", *frame["cost"][1:]]).to_csv(file, index=False)
    assert suite.main([str(file), "--out", str(tmp_path)]) == 1
    assert "column 'cost': expected numbers only" in capsys.readouterr().err


def test_runs_of_a_sweep_are_read(tmp_path):
    sweep = ["experiment=suite", "-m", "task=suite/lqr", "tuner=random", "seed=1",
             "experiments=10,20", f"runs_dir={tmp_path}"]  # fmt: skip
    commands.run("-m", "zoac.run", *sweep, cwd=tmp_path, check=True)
    assert suite.main([str(tmp_path), "--out", str(tmp_path / "out"), "--format", "svg"]) == 0
    frame = suite.read(tmp_path / "out" / "suite.csv")
    assert len(frame) == 2
    assert set(frame["seed"]) == {1}
    assert set(frame["experiments"]) == {10, 20}
    assert set(frame["parameters"]) == {2}
