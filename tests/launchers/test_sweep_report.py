"""Notes of jobs, and what the end of a sweep makes of them."""

import json
import subprocess
import sys

import numpy as np
import pytest

from zoac.config.compose import compose_config, explain, variant_of
from zoac.core.errors import ConfigError
from zoac.run import sweep_report
from zoac.run.sweep_report import keep_given, noted, report


def job_of_sweep(folder, seed):
    return noted(folder, seed, [f"seed={seed}"], {"task": "lqr", "tuner": "es", "seed": seed})


def test_a_failure_is_noted_and_goes_no_further(tmp_path, capsys):
    with job_of_sweep(tmp_path, 0):
        pass
    with job_of_sweep(tmp_path, 1):
        raise ConfigError("num_envs=0: no environments")
    with job_of_sweep(tmp_path, 2):
        raise ZeroDivisionError("somewhere")
    told, all_done = report(tmp_path)
    assert told == (
        "1 job(s) of the sweep done\n2 job(s) of the sweep failed:\n"
        "  lqr es seed=1: num_envs=0: no environments\n"
        "  lqr es seed=2: ZeroDivisionError: somewhere"
    )
    assert not all_done
    # Somebody's bug: the place of it is worth having, where the job ran and later.
    assert "test_sweep_report.py" in capsys.readouterr().err
    assert "test_sweep_report.py" in json.loads((tmp_path / "2.json").read_text())["traceback"]


def test_a_signal_is_noted_and_goes_on(tmp_path):
    with pytest.raises(KeyboardInterrupt), job_of_sweep(tmp_path, 0):
        raise KeyboardInterrupt
    assert report(tmp_path)[0].endswith("1 job(s) of the sweep stopped:\n  lqr es seed=0")


def test_a_job_knows_that_it_has_begun_before(tmp_path):
    known = []
    for number in (0, 1, 0):
        with job_of_sweep(tmp_path, number) as job:
            known.append(job.again)
    assert known == [False, False, True]


SWEPT = ["tuner=zoac", "tuner.exploration.sigma=0.125", "critic.hidden=[16,16,16,16,16,16]"]


def outcome(folder, **changes):
    result = {"cost_mean": 2.0, "wall_seconds": 61.4, "variant": "v=1", "warnings": ["one"]}
    return sweep_report.outcome({**result, **changes}, folder, done_already=False)


def test_each_job_prints_a_line_and_the_end_a_table_within_80_columns(tmp_path, capsys):
    keep_given(tmp_path, ["budget=400", "seed=0,1"])
    identity = {"task": "pid_acc", "tuner": "zoac"}
    for seed, changes in enumerate([{"baseline_cost_mean": 3.25}, {"cost_mean": np.nan}]):
        job = ["budget=400", f"seed={seed}", *SWEPT]
        with noted(tmp_path, seed, job, {**identity, "seed": seed}) as one:
            one.outcome = outcome(tmp_path / f"pid_acc/zoac/seed={seed}/variant=v=1", **changes)
    with noted(tmp_path, 2, ["budget=400", "seed=2"], {**identity, "seed": 2}):
        raise ConfigError("no such plant")
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("pid_acc zoac seed=0 sigma=0.125 ")
    assert first.endswith("...: cost 3.25 -> 2, 61 s, 1 warning")
    assert second.endswith(": cost not finite, 61 s, 1 warning")
    lines = report(tmp_path)[0].splitlines()
    assert lines[1].split() == ["task", "tuner", "seed", "cost", "before", "after", "seconds"]
    assert lines[2].split()[:7] == ["pid_acc", "zoac", "0", "3.25", "->", "2", "61"]
    assert "pid_acc zoac 2 failed" in [" ".join(line.split()) for line in lines]
    assert f"folders: {tmp_path}/<task>/<tuner>/seed=<seed>/variant=v=1" in lines
    assert "  pid_acc zoac seed=2: no such plant" in lines
    assert all(len(line) <= 80 for line in [first, second, *lines] if str(tmp_path) not in line)


def test_a_dead_process_is_told_from_one_that_still_runs(tmp_path):
    with job_of_sweep(tmp_path, 0):
        told, all_done = report(tmp_path)
    assert (
        "1 job(s) of the sweep not at their end: still running, or dead:\n  lqr es seed=0 (" in told
    )
    assert not all_done
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    note = json.loads((tmp_path / "0.json").read_text())
    (tmp_path / "0.json").write_text(json.dumps({**note, "state": "running", "pid": gone.pid}))
    assert "1 job(s) of the sweep died without a word" in report(tmp_path)[0]


def test_the_launcher_makes_no_variant():
    config = {"variant": None}
    assert (
        variant_of(config, ["launcher=joblib", "seed=1", "tuner.exploration.sigma=0.2"])
        == "tuner.exploration.sigma=0.2"
    )


def test_a_launcher_that_is_not_installed_is_named_with_its_extra():
    error = Exception("Could not find 'hydra/launcher/ray'")
    assert explain(error).endswith("pip install 'zoac[ray-launcher]'")


def test_an_unknown_launcher_gets_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'joblib'"):
        compose_config(["launcher=jobli"])
