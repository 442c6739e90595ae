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


COMMANDS = {
    "report": [], "curves": [], "trajectories": [], "table2": [], "beyond": ["--reference=best"],
    "landscape": ["--tuner=random", "--points=2", "--episodes=1"],
    "robustness": ["--vary=preceding_std=0.1,0.2", "--plants=1", "--episodes=1"],
}  # fmt: skip
TABLES = {"table2", "beyond"}


def test_a_command_that_draws_says_what_to_install_and_a_table_needs_none(runs):
    done = without(
        f"""
from importlib import import_module
for name, options in {COMMANDS!r}.items():
    code = import_module("zoac.analysis." + name).main(["runs", *options])
    print("ended:", name, code, file=sys.stderr)
""",
        cwd=runs,
    )
    assert done.returncode == 0, done.stderr
    told = [line for line in done.stderr.splitlines() if line.startswith(("error:", "ended:"))]
    expected = []
    for name in COMMANDS:
        expected += [f"ended: {name} 0"] if name in TABLES else [MESSAGE, f"ended: {name} 1"]
    assert told == expected


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
