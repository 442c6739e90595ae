"""Matplotlib is an extra: what draws names it, what does not draw needs it not."""

from pathlib import Path

import pytest

from tests import commands

ROOT = Path(__file__).parents[2]
MESSAGE = "error: figures need Matplotlib: pip install 'zoac[figures]'"
COMMANDS = {
    "report": [], "curves": [], "trajectories": [], "table2": [], "beyond": ["--reference=best"],
    "landscape": ["--tuner=random", "--points=2", "--episodes=1"],
    "robustness": ["--vary=preceding_std=0.1,0.2", "--plants=1", "--episodes=1"],
}  # fmt: skip
TABLES = {"table2", "beyond"}
CODE = f"""
import sys

for name in [name for name in sys.modules if name.startswith("matplotlib.")]:
    del sys.modules[name]
sys.modules["matplotlib"] = None
from importlib import import_module

import gymnasium
import zoac
from zoac import specs
from zoac.core.errors import ConfigError

short = {{
    "task": "pid_acc", "tuner": "random", "budget": 400, "num_envs": 2, "episodes": 1,
    "final_episodes": 2, "quiet": True,
}}
zoac.tune(**short, folder="runs/pid_acc/random/seed=0")
signals, peak = {{"y": zoac.observation(0)}}, specs.peak("y", max=9.0)
result = zoac.tune(**short, signals=signals, specs=[peak], folder="run")
print(result)
try:
    result.plot()
except ConfigError as error:
    print("no plot:", error)
try:
    gymnasium.make_vec("zoac/PidAcc-v0", num_envs=1, render_mode="rgb_array").render()
except ConfigError as error:
    print("no frame:", error)
for name, options in {COMMANDS!r}.items():
    code = import_module("zoac.analysis." + name).main(["runs", *options])
    print("ended:", name, code, file=sys.stderr)
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    env = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(folder)}
    done = commands.run("-c", CODE, cwd=folder, env=env)
    assert done.returncode == 0, done.stderr
    return done


def test_a_command_that_draws_says_what_to_install_and_a_table_needs_none(done):
    told = [line for line in done.stderr.splitlines() if line.startswith(("error:", "ended:"))]
    expected = []
    for name in COMMANDS:
        expected += [f"ended: {name} 0"] if name in TABLES else [MESSAGE, f"ended: {name} 1"]
    assert told == expected


def test_tuning_and_its_result_need_none_and_a_plot_says_what_to_install(done):
    assert "peak(y)" in done.stdout
    assert f"no plot: {MESSAGE.removeprefix('error: ')}" in done.stdout
    assert "no frame: figures need Matplotlib" in done.stdout
