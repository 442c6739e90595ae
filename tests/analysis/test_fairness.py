from importlib import import_module

import pytest

from tests.analysis.folders import PID, write_run
from zoac.analysis.data.fairness import refuse_mixed, refuse_unequal
from zoac.analysis.data.load import load
from zoac.core.errors import RunFolderError


def test_seeds_of_different_configurations_are_not_averaged(tmp_path):
    write_run(tmp_path, seed=0)
    write_run(tmp_path, seed=1)
    write_run(
        tmp_path,
        seed=2,
        config={"tuner": {"_target_": "somewhere.zoac", "exploration": {"sigma": 0.2}}},
    )
    with pytest.raises(RunFolderError) as refusal:
        refuse_mixed(load(tmp_path).runs)
    assert str(refusal.value).split("\n") == [
        "the runs of zoac on pid_acc differ in their configuration and do not go together:",
        "  tuner.exploration.sigma: (absent) in seed 0, seed 1; 0.2 in seed 2",
        "set one group apart with variant=NAME, or move it to another folder",
    ]


READERS = [
    ["table2", "--task", "pid_acc"], ["curves"], ["beyond", "--reference", "best"], ["compact"],
    ["report"], ["trajectories"], ["landscape"], ["robustness"],
]  # fmt: skip


@pytest.mark.parametrize("command", READERS, ids=lambda command: command[0])
def test_seeds_on_two_plants_of_one_name_never_count_as_one_method(tmp_path, capsys, command):
    write_run(tmp_path, seed=0, config={"code": {"env": "here.P@1"}})
    write_run(tmp_path, seed=1, config={"code": {"env": "here.P@2"}})
    module = import_module(f"zoac.analysis.{command[0]}")
    out = tmp_path / "out"
    assert module.main([str(tmp_path), *command[1:], "--out", str(out)]) == 1
    assert not out.exists()
    assert "code.env: here.P@1 in seed 0; here.P@2 in seed 1" in capsys.readouterr().err


def test_where_a_run_was_executed_does_not_set_it_apart(tmp_path):
    write_run(tmp_path, seed=0)
    write_run(
        tmp_path, seed=1, config={"executor": {"_target_": "zoac.rollout.executors.base.Process"}}
    )
    refuse_mixed(load(tmp_path).runs)


def test_a_solver_that_the_task_does_not_use_sets_no_run_apart(tmp_path):
    changes = {"mpc_solver": {"_target_": "somewhere.else"}}
    plain = {"task": {"_target_": "somewhere.pid_acc"}}
    write_run(tmp_path, "zoac", seed=0, config=plain)
    write_run(tmp_path, "zoac", seed=1, config={**plain, **changes})
    refuse_mixed(load(tmp_path).runs)
    refuse_unequal(load(tmp_path).runs)


def test_tuners_with_different_budgets_are_not_compared(tmp_path):
    write_run(tmp_path, "zoac")
    write_run(tmp_path, "bo", config={"budget": 500})
    with pytest.raises(
        RunFolderError, match=r"not compared:\n  budget: 500 in bo .*; 1000 in zoac"
    ):
        refuse_unequal(load(tmp_path).runs)


def test_an_untuned_controller_has_no_budget_to_compare(tmp_path):
    write_run(tmp_path, "zoac")
    write_run(tmp_path, "nominal", config={"budget": 5})
    refuse_unequal(load(tmp_path).runs)


def test_different_evaluation_episodes_are_not_compared(tmp_path):
    write_run(tmp_path, "zoac")
    other = {"episodes": 2, "final_episodes": 4, "seed": 1}
    write_run(tmp_path, "nominal", config={"evaluation": other})
    with pytest.raises(RunFolderError, match=r"evaluation.seed: 1 in nominal .*; 0 in zoac"):
        refuse_unequal(load(tmp_path).runs)


def test_budgets_may_differ_where_that_is_said(tmp_path):
    write_run(tmp_path, "zoac")
    write_run(tmp_path, "bo", config={"budget": 500})
    refuse_unequal(load(tmp_path).runs, any_budget=True)


def test_text_and_code_of_the_paper_are_compared_where_they_mean_the_same_cost(tmp_path):
    write_run(tmp_path, config={"fidelity": {"jerk": "rate", "anneal": True}})
    code = {"fidelity": {"jerk": "commanded_increment", "anneal": False}}
    write_run(tmp_path, variant="authors_code", config=code)
    refuse_unequal(load(tmp_path).runs)
    other_cost = {**code, "task": {**PID, "jerk": "commanded_increment"}}
    write_run(tmp_path, variant="other", config=other_cost)
    with pytest.raises(RunFolderError, match=r"jerk: .* commanded_increment in zoac \(other\)"):
        refuse_unequal(load(tmp_path).runs)
