"""The same sweep through every launcher that is installed."""

import importlib
import os
import signal

import pytest

from tests.launchers.support import SMALL, finish, results, running_note, start, sweep
from zoac.config import compose_config

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


# Four runs, and two jobs that fail.
SIX = [*SMALL, "tuner=random,es", "seed=0,1,-1"]


@pytest.fixture(scope="module")
def one_after_the_other(tmp_path_factory):
    folder = tmp_path_factory.mktemp("basic")
    code, _, err = sweep(*SIX, cwd=folder)
    assert code == 1, err
    return results(folder / "runs")


@pytest.mark.parametrize("launcher", PLUGINS)
def test_every_launcher_gives_the_same_numbers_and_tells_of_failures(
    launcher, one_after_the_other, tmp_path
):
    needs(launcher)
    code, _, err = sweep(*SIX, f"launcher={launcher}", cwd=tmp_path)
    assert len(one_after_the_other) == 4
    assert results(tmp_path / "runs") == one_after_the_other
    assert code == 1
    assert "4 job(s) of the sweep done\n2 job(s) of the sweep failed:\n" in err
    assert err.count("seed=-1: input should be greater than or equal to 0") >= 2
    assert "Traceback" not in err


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


def test_a_preempted_job_is_requeued_and_ends_on_the_same_bits(tmp_path):
    needs("submitit_local")
    (tmp_path / "whole").mkdir()
    (tmp_path / "parts").mkdir()
    # An iteration of 400 steps or so: the signal arrives long before the end.
    arguments = [*SMALL, "budget=40000", "checkpoint_seconds=0", "seed=0"]
    code, _, err = finish(start(*arguments, cwd=tmp_path / "whole"))
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
    assert log.count("| 0/40,000 steps |") == 1  # it went on, and did not begin anew
    assert results(tmp_path / "parts" / "runs") == results(tmp_path / "whole" / "runs")


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
