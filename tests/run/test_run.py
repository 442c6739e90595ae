"""The command line as a user types it."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from stress.bad_inputs import answer
from tests import commands
from zoac.run import command
from zoac.run.command import multirun_first
from zoac.run.help import usage

ROOT = Path(__file__).parents[2]
SMALL = [
    "budget=400", "eval_every=400", "evaluation.episodes=2", "evaluation.final_episodes=3",
    "task.max_episode_steps=50", "variant=small",
]  # fmt: skip


def environment(home):
    return {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(home)}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))


def result(folder, task="pid_acc", tuner="zoac", seed=0):
    path = folder / "runs" / task / tuner / f"seed={seed}" / "variant=small" / "result.json"
    return json.loads(path.read_text())


def test_multirun_flag_may_stand_anywhere():
    arguments = ["task=pid_acc", "tuner=zoac", "-m", "seed=0,1"]
    assert multirun_first(arguments) == ["-m", "task=pid_acc", "tuner=zoac", "seed=0,1"]
    assert multirun_first(["seed=0"]) == ["seed=0"]


def test_without_arguments_it_runs(monkeypatch):
    begun = []
    monkeypatch.setattr(command, "_job", lambda: begun.append(sys.argv[1:]))
    monkeypatch.setattr(sys, "argv", ["zoac.run"])
    command.main()
    assert begun == [[]]


def test_a_sweep_writes_a_folder_per_seed_and_a_second_launch_does_nothing_again(tmp_path):
    command = ["task=pid_acc", "tuner=random", "-m", "seed=0,1", *SMALL]
    code, _, errors = answer(*command)
    assert code == 0, errors
    one, two = (result(tmp_path, tuner="random", seed=seed) for seed in (0, 1))
    assert one["x"] != two["x"]
    assert (one["task"], one["tuner"], one["seed"], one["variant"]) == (
        "pid_acc",
        "random",
        0,
        "small",
    )
    assert len(one["cost_per_episode"]) == len(one["episode_lengths"]) == 3
    _, out, _ = answer(*command)
    assert out.count("done already") == 2
    assert result(tmp_path, tuner="random") == one


def test_one_failing_job_leaves_its_siblings_alone_and_is_told_at_the_end(tmp_path):
    code, _, errors = answer("-m", "tuner=cmaes", "tuner.initial_sigma=-1,0.1", *SMALL[:-1])
    assert code == 1
    assert "1 job(s) of the sweep failed" in errors
    assert "tuner.initial_sigma=-1: input should be greater than 0" in errors
    assert "Traceback" not in errors
    assert len(list(tmp_path.rglob("result.json"))) == 1


@pytest.mark.parametrize("mode", [[], ["-m"]])
def test_a_folder_may_have_any_name_and_begin_with_a_tilde(tmp_path, mode):
    code, _, errors = answer(*mode, r"runs_dir='~/\${x} y'", "tuner=random", *SMALL)
    assert code == 0, errors
    assert len(list((tmp_path / "${x} y").rglob("result.json"))) == 1
    assert [p.name for p in tmp_path.iterdir() if p.name[0] != "."] == ["${x} y"]


FOLDER = "runs/pid_acc/zoac/seed=0/variant=small"


def test_signals_stop_cleanly_and_the_same_command_ends_with_the_same_numbers(tmp_path):
    longer = [*SMALL, "budget=2000"]
    metrics = tmp_path / FOLDER / "metrics.jsonl"
    seen = 0
    for number in (signal.SIGINT, signal.SIGTERM):
        process = commands.Started(
            "-m", "zoac.run", *longer, cwd=tmp_path, env=environment(tmp_path)
        )
        while not (metrics.exists() and metrics.stat().st_size > seen):
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(number)
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 130
        assert "Traceback" not in errors
        assert re.search(f"stopped after .* steps; the same command goes on from {FOLDER}", errors)
        seen = metrics.stat().st_size
    assert answer(*longer)[0] == 0
    assert answer(*longer, f"runs_dir={tmp_path}/undisturbed/runs")[0] == 0
    assert result(tmp_path)["x"] == result(tmp_path / "undisturbed")["x"]


@pytest.mark.parametrize("module", ["hydra", "torch"])
def test_a_signal_while_modules_are_imported_is_no_traceback(module, tmp_path):
    (tmp_path / f"{module}.py").write_text(
        "import os, time\nos.kill(os.getpid(), 2)\ntime.sleep(9)"
    )
    code = f"""
import runpy, sys
# As where nothing is imported beforehand.
known = [name for name in sys.modules if name.partition(".")[0] == "{module}"]
kept = [sys.modules.pop(name) for name in known]
sys.argv[1:] = {SMALL}
runpy.run_module("zoac.run", run_name="__main__", alter_sys=True)
"""
    done = commands.run("-c", code, cwd=tmp_path, env=environment(tmp_path))
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_a_second_signal_stops_at_once(tmp_path):
    # One iteration of this takes far longer than the test would wait.
    endless = ["tuner=es", "tuner.population=100000", "budget=100000000", "evaluation.episodes=1"]
    process = commands.Started(
        "-m", "zoac.run", "task=pid_acc", *endless, cwd=tmp_path, env=environment(tmp_path)
    )
    try:
        for file, text in enumerate((" | cost ", "once more stops at once")):
            while text not in process.written()[file]:
                assert process.poll() is None
                time.sleep(0.01)
            assert process.poll() is None
            process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=300)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert list(tmp_path.rglob("run.json"))


def test_help_loads_nothing_heavy():
    heavy = "{'torch', 'cvxpy', 'wandb', 'nevergrad', 'pandas', 'numba', 'scipy', 'matplotlib'}"
    code = f"import sys, zoac.run.command; print({heavy} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "set()"


def test_help_lists_every_choice_and_key():
    code, out, _ = answer("--help")
    assert code == 0
    for group in ("task", "tuner", "executor", "mpc_solver", "fidelity", "logger", "experiment"):
        for path in (ROOT / "conf" / group).glob("*.yaml"):
            assert path.stem in out
    for key in ("seed", "budget", "num_envs", "eval_every", "runs_dir", "variant", "resume"):
        assert f"\n{key}: " in out


def test_an_experiment_without_its_sweep_is_refused(tmp_path):
    code, _, told = answer("experiment=table2")
    assert (code, told) == (1, "error: experiment=table2 is a sweep over method, seed: add -m\n")
    assert list(tmp_path.iterdir()) == []


def test_the_helps_own_examples_are_understood():
    assert "--cfg job" in usage()
    code, out, _ = answer("task=mpc_tracking", "tuner=bo", "--cfg", "job")
    assert code == 0
    assert "max_observations: 300" in out


def test_options_of_the_search_are_told_where_they_belong():
    assert "search:" not in usage()
    for override in ("search=zoac", "search.trials=3"):
        code, _, told = answer(override)
        assert code == 1
        assert f"{override}: this belongs to python -m zoac.search" in told
