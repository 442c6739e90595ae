"""The same sweep through every launcher that is installed."""

import importlib
import json
import os
import signal
from pathlib import Path

import pytest

from tests.launchers.support import (
    SMALL,
    all_running,
    alone,
    finish,
    results,
    running_note,
    start,
    sweep,
)  # fmt: skip
from tests.support import end_within
from zoac.config.compose import compose_config

PLUGINS = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    "submitit_local": "hydra_plugins.hydra_submitit_launcher",
    "ray": "hydra_plugins.hydra_ray_launcher",
}


def needs(launcher):
    try:
        importlib.import_module(PLUGINS[launcher])
    except ImportError:
        extra = "ray-launcher" if launcher == "ray" else "launchers"
        pytest.skip(f"launcher={launcher} is not installed: pip install 'zoac[{extra}]'")


# Two runs, and a job that fails between them.
THREE = [*SMALL, "tuner=es", "seed=0,-1,1"]


@pytest.fixture(scope="module")
def one_after_the_other(tmp_path_factory):
    folder = tmp_path_factory.mktemp("basic")
    code, _, err = alone("-m", *THREE, cwd=folder)
    assert code == 1, err
    return results(folder / "runs")


@pytest.mark.parametrize("launcher", PLUGINS)
def test_every_launcher_gives_the_same_numbers_and_tells_of_failures(
    launcher, one_after_the_other, tmp_path
):
    needs(launcher)
    code, out, err = sweep(*THREE, f"launcher={launcher}", cwd=tmp_path)
    assert len(one_after_the_other) == 2
    assert results(tmp_path / "runs") == one_after_the_other
    assert code == 1
    assert "2 job(s) of the sweep done\n1 job(s) of the sweep failed:\n  " in err
    assert "seed=-1: input should be greater than or equal to 0\n" in err.partition("failed:")[2]
    assert "Traceback" not in err
    if launcher == "joblib":  # submitit's jobs write into files; ray marks each line
        assert sum(": cost " in line for line in out.splitlines()) == 2
        assert len(out.splitlines()) == 3  # what a line is, and one for each job
    assert "HYDRA" not in out + err


def test_a_job_that_dies_is_told(tmp_path):
    needs("joblib")
    arguments = [*SMALL, "launcher=joblib", "hydra.launcher.n_jobs=2", "seed=0,1"]
    endless = ["budget=100000000", "eval_every=100000000", "checkpoint_seconds=0"]
    process = start("-m", *arguments, *endless, cwd=tmp_path)
    victim = running_note(process, tmp_path / "runs", "seed=1")["pid"]
    os.kill(victim, signal.SIGKILL)
    code, _, err = finish(process)
    assert code == 1
    assert "of the sweep died without a word (killed, or out of memory):\n" in err
    assert "the launcher gave up: TerminatedWorkerError" in err
    assert f"process {victim} on " in err
    assert "Traceback" not in err


def test_a_preempted_job_is_requeued_and_ends_with_the_same_numbers(tmp_path):
    needs("submitit_local")
    (tmp_path / "whole").mkdir()
    (tmp_path / "parts").mkdir()
    # An iteration of 400 steps or so: the signal arrives long before the end.
    arguments = [*SMALL, "budget=40000", "checkpoint_seconds=0", "seed=0"]
    code, _, err = alone(*arguments, cwd=tmp_path / "whole")
    assert code == 0, err
    # resume=overwrite is meant for the sweep, not for each time that a job is put back.
    again = [*arguments, "launcher=submitit_local", "resume=overwrite"]
    process = start("-m", *again, cwd=tmp_path / "parts")
    note = running_note(process, tmp_path / "parts" / "runs", "seed=0")
    os.kill(note["pid"], signal.SIGUSR2)
    code, _, err = finish(process)
    assert code == 0, err
    log = "".join(p.read_text() for p in (tmp_path / "parts").rglob("*_log.out"))
    assert "Requeued job" in log
    assert log.count(" 0 steps |") == 1  # it went on, and did not begin anew
    assert results(tmp_path / "parts" / "runs") == results(tmp_path / "whole" / "runs")


def stop(process, how):
    """Send a signal to the process of a sweep, or Ctrl-C as a terminal does: to all of them."""
    if how == "Ctrl-C":
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(how)


# Each launcher is killed outright, and told to stop in one of the two ways.
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="counts by /proc")
@pytest.mark.parametrize(
    ("launcher", "how", "executor"),
    [
        ("joblib", signal.SIGKILL, "process"),
        ("joblib", "Ctrl-C", "serial"),
        ("submitit_local", signal.SIGTERM, "serial"),
        ("submitit_local", signal.SIGKILL, "serial"),
    ],
)
def test_jobs_end_with_their_sweep_and_the_same_command_goes_on_with_all(
    launcher, how, executor, tmp_path
):
    needs(launcher)
    jobs = [*SMALL, "seed=0,1", "budget=60000", "checkpoint_seconds=0"]
    through = [f"launcher={launcher}", f"executor={executor}"]
    if executor == "process":
        through.append("executor.workers=1")
    if launcher == "joblib":
        through.append("hydra.launcher.n_jobs=2")
    process = start("-m", *jobs, *through, cwd=tmp_path)
    all_running(process, tmp_path / "runs", 2)
    stop(process, how)
    code, _, err = finish(process)
    assert code == (-signal.SIGKILL if how == signal.SIGKILL else 130), err
    assert "Traceback" not in err
    assert end_within(5.0, f"HOME={tmp_path}")
    notes = [json.loads(p.read_text()) for p in tmp_path.glob("runs/.sweeps/*/[0-9]*.json")]
    assert [note["state"] for note in notes] == ["stopped", "stopped"]
    assert results(tmp_path / "runs") == {}
    if how == signal.SIGKILL:  # what folders hold then is not the launcher's matter
        code, out, err = alone("-m", *jobs, cwd=tmp_path)
    else:
        code, out, err = sweep(*jobs, *through, cwd=tmp_path)
    assert code == 0, err
    assert "2 job(s) of the sweep done" in out
    assert len(results(tmp_path / "runs")) == 2


def test_slurm_is_asked_for_nothing_it_does_not_know():
    slurm = pytest.importorskip("submitit.slurm.slurm")
    needs("submitit_local")
    composed = compose_config(["launcher=slurm", "hydra.launcher.partition=cpu"])
    launcher = dict(composed.hydra.launcher)
    for key in ("_target_", "submitit_folder", "max_num_timeout", "name", "tasks_per_node"):
        del launcher[key]
    minutes, memory = launcher.pop("timeout_min"), launcher.pop("mem_gb")
    options = {**launcher, "time": minutes, "mem": f"{memory}GB"}
    sheet = slurm._make_sbatch_string("true", "folder", **options)
    for line in ("--requeue", "--partition=cpu", "--cpus-per-task=1", "--signal=USR2@120"):
        assert f"#SBATCH {line}" in sheet
