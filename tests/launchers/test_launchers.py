"""The same sweep through every launcher that is installed."""

import importlib
import json
import os
import signal
from pathlib import Path

import pytest

from tests.launchers.support import (
    SMALL,
    WAITING,
    all_running,
    alone,
    finish,
    results,
    running_note,
    start,
)  # fmt: skip
from tests.support import end_within
from zoac.config.compose import compose_config

PLUGINS = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    "submitit_local": "hydra_plugins.hydra_submitit_launcher",
    "ray": "hydra_plugins.hydra_ray_launcher",
}


def where_seed_2_fails(folder):
    """Return the folder, in which the run with seed 2 cannot begin."""
    (folder / "runs/lqr/es").mkdir(parents=True)
    (folder / "runs/lqr/es/seed=2").touch()
    return folder


def needs(launcher):
    try:
        importlib.import_module(PLUGINS[launcher])
    except ImportError:
        extra = "ray-launcher" if launcher == "ray" else "launchers"
        pytest.skip(f"launcher={launcher} is not installed: pip install 'zoac[{extra}]'")


counts_by_proc = pytest.mark.skipif(
    not Path("/proc/self/environ").exists(), reason="counts processes by /proc"
)
LEARNING = [*SMALL, *WAITING, "tuner=es", "budget=6000", "eval_every=2500"]
ENDLESS = ["budget=100000000", "eval_every=100000000", "checkpoint_seconds=0"]


@pytest.fixture(scope="module")
def one_after_the_other(tmp_path_factory):
    folder = where_seed_2_fails(tmp_path_factory.mktemp("basic"))
    (folder / "go").touch()
    code, _, err = alone("-m", *LEARNING, "seed=0,2,1", cwd=folder)
    assert code == 1, err
    return results(folder / "runs")


def stop(process, how):
    """Send a signal to the process of a sweep, or Ctrl-C as a terminal does: to all of them."""
    if how == "Ctrl-C":
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(how)


def stop_and_see_its_jobs_end(arguments, how, cwd):
    """Stop a sweep of two jobs; return its code once no process of it is left."""
    process = start("-m", *arguments, cwd=cwd)
    all_running(process, cwd / "runs", 2)
    stop(process, how)
    code, _, err = finish(process)
    assert "Traceback" not in err
    assert end_within(5.0, f"HOME={cwd}")
    notes = [json.loads(p.read_text()) for p in cwd.glob("runs/.sweeps/*/[0-9]*.json")]
    assert {note["state"] for note in notes} <= {"stopped", "failed"}
    assert [note["state"] for note in notes].count("stopped") == 2
    assert results(cwd / "runs") == {}
    return code


@counts_by_proc
@pytest.mark.parametrize(
    ("launcher", "seeds", "how"),
    [
        ("joblib", "0,2,1", "Ctrl-C"),
        ("submitit_local", "0,1", signal.SIGTERM),
        ("ray", "0,2,1", "Ctrl-C"),
    ],
)
def test_a_stopped_sweep_goes_on_and_ends_with_the_numbers_of_jobs_one_after_the_other(
    launcher, seeds, how, one_after_the_other, tmp_path
):
    needs(launcher)
    arguments = [*LEARNING, f"seed={seeds}", f"launcher={launcher}"]
    where_seed_2_fails(tmp_path)
    if launcher == "joblib":
        arguments.append("hydra.launcher.n_jobs=2")
    assert stop_and_see_its_jobs_end(arguments, how, tmp_path) == 130
    (tmp_path / "go").touch()
    code, out, err = finish(start("-m", *arguments, cwd=tmp_path))
    assert len(one_after_the_other) == 2
    assert results(tmp_path / "runs") == one_after_the_other
    assert "Traceback" not in err
    if "2" in seeds:
        assert code == 1
        assert "2 job(s) of the sweep done\n1 job(s) of the sweep failed:\n  " in err
        assert "seed=2: cannot make or use the run folder" in err.partition("failed:")[2]
    else:
        assert code == 0
        assert out.endswith("2 job(s) of the sweep done\n")
    if launcher == "joblib":  # submitit's jobs write into files; ray marks each line
        assert sum(": cost " in line for line in out.splitlines()) == 2
        assert len(out.splitlines()) == 3  # what a line is, and one for each job
    assert "HYDRA" not in out + err


@counts_by_proc
def test_jobs_end_with_a_sweep_that_is_killed(tmp_path):
    needs("joblib")
    arguments = [*SMALL, *ENDLESS, "seed=0,1", "launcher=joblib", "hydra.launcher.n_jobs=2"]
    arguments += ["executor=process", "executor.workers=1"]
    assert stop_and_see_its_jobs_end(arguments, signal.SIGKILL, tmp_path) == -signal.SIGKILL


def test_a_job_that_dies_is_told(tmp_path):
    needs("joblib")
    arguments = [*SMALL, *WAITING, "seed=1", "launcher=joblib", "hydra.launcher.n_jobs=2"]
    process = start("-m", *arguments, "budget=6000", cwd=tmp_path)
    victim = running_note(process, tmp_path / "runs", "seed=1")["pid"]
    os.kill(victim, signal.SIGKILL)
    code, _, err = finish(process)
    assert code == 1
    assert "1 job(s) of the sweep died without a word (killed, or out of memory):\n" in err
    assert "the launcher gave up: TerminatedWorkerError" in err
    assert f"process {victim} on " in err
    assert "Traceback" not in err


def test_a_preempted_job_is_requeued_and_ends_with_the_same_numbers(one_after_the_other, tmp_path):
    needs("submitit_local")
    # resume=overwrite is meant for the sweep, not for each time that a job is put back.
    arguments = [*LEARNING, "seed=0", "launcher=submitit_local", "resume=overwrite"]
    process = start("-m", *arguments, cwd=tmp_path)
    note = running_note(process, tmp_path / "runs", "seed=0")
    os.kill(note["pid"], signal.SIGUSR2)
    (tmp_path / "go").touch()
    code, _, err = finish(process)
    assert code == 0, err
    log = "".join(p.read_text() for p in tmp_path.rglob("*_log.out"))
    assert "Requeued job" in log
    assert log.count(" 0 steps |") == 1  # it went on, and did not begin anew
    ((place, result),) = results(tmp_path / "runs").items()
    assert result == one_after_the_other[place]


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
