"""The whole reproduction in small: the smoke experiment, then every analysis command on it."""

import runpy
import sys
from pathlib import Path

import pytest

from tests import commands

ROOT = Path(__file__).parents[1]


def run(module, *arguments, cwd):
    env = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(cwd), "ZOAC_CORES": "1"}
    done = commands.run("-m", module, *arguments, cwd=cwd, env=env)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    folder = tmp_path_factory.mktemp("smoke")
    # With the default solver it takes five times as long; test_auto.py tunes with that one. Each
    # of the experiment's two seeds runs alike; tests/analysis have sweeps of several.
    run("zoac.run", "experiment=smoke", "mpc_solver=riccati", "seed=1", "-m", cwd=folder)
    return folder


def test_every_method_has_its_result(sweep):
    found = {str(p.relative_to(sweep / "runs").parent) for p in sweep.rglob("result.json")}
    rows = [
        ("mpc_tracking", tuner) for tuner in ("zoac", "bo", "cmaes", "nominal")
    ] + [("mpc_tracking_reg", "zoac")]  # fmt: skip
    assert found == {f"{task}/{tuner}/seed=1/variant=smoke" for task, tuner in rows}


@pytest.mark.parametrize(
    ("command", "options", "pattern"),
    [
        ("table2", ["runs"], "*.md"),
        ("curves", ["runs", "--format", "svg"], "*.svg"),
        ("trajectories", ["runs", "--task", "mpc_tracking", "--format", "svg"], "*.svg"),
        ("landscape", ["runs", "--task", "mpc_tracking", "--parameters", "stage_y", "--points", "2",
                       "--episodes", "1", "--format", "svg"], "*.svg"),
        ("report", ["runs/mpc_tracking_reg"], "*.html"),
    ],
)  # fmt: skip
def test_every_analysis_command_runs_on_it(sweep, command, options, pattern, monkeypatch):
    monkeypatch.chdir(sweep)
    module, out = f"zoac.analysis.{command}", f"out/{command}"
    monkeypatch.setattr(sys, "argv", [command, *options, "--out", out])
    monkeypatch.delitem(sys.modules, module, raising=False)  # it may have been imported
    with pytest.raises(SystemExit) as ended:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    assert not ended.value.code
    assert list(Path(out).rglob(pattern))
