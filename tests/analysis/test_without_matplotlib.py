"""Matplotlib is an extra: what draws names it, what does not draw needs it not."""

import subprocess
import sys
from pathlib import Path

import pytest

import zoac

ROOT = Path(__file__).parents[2]
MESSAGE = "error: figures need Matplotlib: pip install 'zoac[figures]'"
HIDDEN = "import sys; sys.modules['matplotlib'] = None; "


def without(code, cwd):
    return subprocess.run(
        [sys.executable, "-c", HIDDEN + code], cwd=cwd, capture_output=True, text=True,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(cwd)}, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    zoac.tune(
        task="pid_acc", tuner="random", budget=400, num_envs=2, episodes=1, final_episodes=2,
        quiet=True, folder=folder / "runs" / "pid_acc" / "random" / "seed=0",
    )  # fmt: skip
    return folder


@pytest.mark.parametrize(
    "command",
    [
        "report", "curves", "landscape --tuner=random --points=2 --episodes=1", "trajectories",
        "robustness --vary preceding_std=0.1,0.2 --plants=1 --episodes=1",
    ],
)  # fmt: skip
def test_a_command_that_draws_says_what_to_install(runs, command):
    name, *options = command.split()
    options = ["runs", *options]
    done = without(
        f"from zoac.analysis import {name}; sys.exit({name}.main({options!r}))", cwd=runs
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == MESSAGE
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("command", ["table2", "beyond --reference=best"])
def test_a_table_needs_none(runs, command):
    name, *options = command.split()
    done = without(
        f"from zoac.analysis import {name}; sys.exit({name}.main({['runs', *options]!r}))", cwd=runs
    )
    assert done.returncode == 0, done.stderr


def test_tuning_and_its_result_need_none_and_a_plot_says_what_to_install(tmp_path):
    code = """
import gymnasium
import zoac
from zoac import specs
from tests.envs.test_adapters import Drift, Integrator

result = zoac.tune(
    env=Drift, controller=Integrator(), space={"k": (0, 1)}, max_episode_steps=9, budget=100,
    signals={"y": zoac.observation(0)}, specs=[specs.peak("y", max=9.0)], quiet=True,
    folder="run",
)
print(result)
try:
    result.plot()
except zoac.core.errors.ConfigError as error:
    print("error:", error)
try:
    gymnasium.make_vec("zoac/PidAcc-v0", num_envs=1, render_mode="rgb_array").render()
except zoac.core.errors.ConfigError as error:
    print("no frame:", error)
"""
    done = without(code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert MESSAGE in done.stdout
    assert "no frame: figures need Matplotlib" in done.stdout
