"""Ratios at several budgets."""

import pytest

from tests.analysis.folders import PID, write_run
from zoac.analysis import beyond
from zoac.analysis.data.load import load


@pytest.fixture
def runs(tmp_path):
    root = tmp_path / "runs"
    write_run(root, "nominal", costs=(2.0, 4.0), evaluations=())
    for seed, cost in ((0, 3.0), (1, 6.0), (100, 12.0)):
        write_run(root, seed=seed, costs=(cost, cost))
        write_run(
            root, seed=seed, costs=(cost / 2, cost / 2), variant="budget=5000",
            config={"budget": 5000},
        )  # fmt: skip
    write_run(root, seed=0, costs=(9.0, 9.0), variant="tuner.exploration.sigma=0.2")
    return root


def rows(root, seeds=None, reference="nominal"):
    finished = load(root).finished
    table = beyond.table(finished, beyond.reference_run(finished, reference), seeds)
    found = {}
    for row in table.itertuples():
        found.setdefault(row.variant, {}).setdefault(row.budget, {})[row.seed] = row.ratio
    return found


def test_a_ratio_is_the_mean_cost_over_the_nominal_one(runs):
    assert rows(runs)[""] == {1000: {0: 1.0, 1: 2.0, 100: 4.0}, 5000: {0: 0.5, 1: 1.0, 100: 2.0}}


def test_the_budget_is_a_column_and_other_options_a_row(runs):
    assert set(rows(runs)) == {"", "tuner.exploration.sigma=0.2"}


def test_tuners_on_other_terms_are_rows_of_their_own(runs):
    write_run(
        runs, seed=0, costs=(1.5, 1.5), variant="initial_samples=40", config={"initial_samples": 40}
    )
    assert rows(runs)["initial_samples=40"] == {1000: {0: 0.5}}


def test_seeds_can_be_kept_apart(runs):
    assert rows(runs, seeds=range(100, 110))[""] == {1000: {100: 4.0}, 5000: {100: 2.0}}


def test_seeds_that_nobody_has_are_refused_with_those_there_are(runs, capsys):
    assert beyond.main([str(runs), "--seeds", "3-9"]) == 1
    told = "no tuned run on pid_acc with these seeds; there are 0, 1, 100"
    assert told in capsys.readouterr().err


def test_the_best_run_can_be_the_reference(runs):
    assert rows(runs, reference="best")[""][5000] == {0: 1.0, 1: 2.0, 100: 4.0}


def lost(root, seed, **more):
    """Write a run with an episode whose cost was not finite."""
    write_run(root, seed=seed, result={"cost_mean": None, "cost_per_episode": [None, 1.0]}, **more)


def test_a_seed_whose_cost_is_not_finite_is_noted_and_its_cell_not_averaged(tmp_path, capsys):
    write_run(tmp_path, "nominal", costs=(2.0, 4.0), evaluations=())
    write_run(tmp_path, seed=0, costs=(3.0, 3.0))
    lost(tmp_path, 1, costs=(1.0, 1.0))
    assert beyond.main([str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "| ZOAC | -- (2) |" in told
    assert "ZOAC, 1,000 steps: the cost of seed 1 is not finite; nothing is averaged" in told


def test_a_row_with_a_cost_that_is_not_finite_comes_last(tmp_path):
    write_run(tmp_path, "nominal", costs=(2.0, 4.0), evaluations=())
    write_run(tmp_path, seed=0, costs=(3.0, 3.0))
    write_run(tmp_path, seed=0, costs=(1.0, 1.0), variant="other")
    lost(tmp_path, 1, costs=(1.0, 1.0), variant="other")
    assert list(rows(tmp_path)) == ["", "other"]


def test_the_best_run_is_one_with_a_finite_cost(tmp_path):
    lost(tmp_path, 0, costs=(1.0, 1.0))
    write_run(tmp_path, seed=1, costs=(3.0, 3.0))
    write_run(tmp_path, seed=2, costs=(6.0, 6.0))
    found = rows(tmp_path, reference="best")[""][1000]
    assert (found[1], found[2]) == (1.0, 2.0)


@pytest.mark.parametrize("cost", [0.0, -3.0, float("nan"), float("inf")])
def test_a_reference_without_a_positive_finite_cost_is_refused(tmp_path, capsys, cost):
    kept = {"cost_mean": cost}
    write_run(tmp_path, "nominal", costs=(2.0, 4.0), evaluations=(), result=kept)
    write_run(tmp_path, costs=(1.0, 1.0))
    assert beyond.main([str(tmp_path)]) == 1
    told = capsys.readouterr().err
    assert f"its cost, {cost:g}, cannot be the reference of a ratio" in told
    assert "needs a finite cost above zero; zoac.analysis.table2 tells differences" in told


def test_the_command_prints_mean_worst_and_number(runs, tmp_path, capsys):
    assert beyond.main([str(runs), "--out", str(tmp_path / "out"), "--seeds", "0-9"]) == 0
    assert "| ZOAC | 1.500, 2.000 (2) | 0.750, 1.000 (2) |" in capsys.readouterr().out
    assert (tmp_path / "out" / "beyond.csv").read_text().count("\n") == 6


def test_terminations_while_tuning_are_told_where_they_were_counted(runs, tmp_path, capsys):
    assert beyond.main([str(runs), "--out", str(tmp_path / "out")]) == 0
    assert "Terminations" not in capsys.readouterr().out
    for seed, count in ((7, 3), (8, 5)):
        write_run(runs, seed=seed, costs=(3.0, 3.0), variant="careful",
                  result={"tuning_terminations": count})  # fmt: skip
    assert beyond.main([str(runs), "--out", str(tmp_path / "out")]) == 0
    assert "| ZOAC [careful] | 400 | -- |" in capsys.readouterr().out
    assert "careful,1000,8,1.0,500.0\n" in (tmp_path / "out" / "beyond.csv").read_text()


def test_without_a_nominal_run_it_says_what_to_do(tmp_path, capsys):
    write_run(tmp_path / "runs")
    assert beyond.main([str(tmp_path / "runs")]) == 1
    assert "tuner=nominal, or give --reference best, or another --task" in capsys.readouterr().err


@pytest.mark.parametrize("changed", [{"task": {**PID, "preceding_std": 0.5}}, {"evaluation": {
    "episodes": 2, "final_episodes": 2, "seed": 5}}])  # fmt: skip
def test_a_reference_on_another_problem_is_refused(tmp_path, capsys, changed):
    write_run(tmp_path, "nominal", costs=(2.0, 4.0), evaluations=(), config=changed)
    write_run(tmp_path, costs=(2.0, 4.0))
    assert beyond.main([str(tmp_path)]) == 1
    told = capsys.readouterr().err
    assert "did not solve the same problem and are not compared" in told
    assert "in nominal on pid_acc; " in told


def test_two_runs_for_one_cell_of_the_table_are_refused_and_named(runs, capsys):
    write_run(runs, seed=1, costs=(1.0, 2.0), variant="mpc_solver=riccati")
    assert beyond.main([str(runs)]) == 1
    told = capsys.readouterr().err
    assert f"budget 1000 and seed 1: {runs}/pid_acc/zoac/seed=1 and {runs}" in told
    assert "/variant=mpc_solver=riccati; budget, mpc_solver, executor tell no rows apart" in told
