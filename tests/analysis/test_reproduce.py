"""What a report says of how to make a run again makes it again."""

from __future__ import annotations

import json
import re
import shlex
import sys
from html import unescape
from pathlib import Path

import pytest

import zoac
from tests import commands
from tests.analysis.folders import write_run
from zoac.analysis import compact, report

SHORT = ["budget=120", "eval_every=60", "evaluation.episodes=1", "evaluation.final_episodes=2"]


def way(folder: Path, out: Path) -> str:
    """Return the first code under "How to reproduce"."""
    assert report.main([str(folder), "--no-replay", "--out", str(out)]) == 0
    text = (out / "report.html").read_text().split("<h3>How to reproduce</h3>")[1]
    return unescape(re.search(r"<pre>(.*?)</pre>", text, re.S)[1])  # type: ignore[index]


def called(words: list[str], where: Path) -> None:
    done = commands.run(*words[1:], cwd=where)
    assert done.returncode == 0, done.stderr


def outcome(folder: Path) -> tuple[object, ...]:
    found = json.loads((folder / "result.json").read_text())
    return found["parameters"], found["cost_per_episode"], found["env_steps"]


def command_of(text: str) -> list[str]:
    words = shlex.split(text)
    assert words[0] == "python"
    return [sys.executable, *words[1:]]


def test_the_program_of_a_run_of_tune(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    zoac.tune(
        env="Pendulum-v1", controller=lambda p, obs: -p["k"] * obs[2], space={"k": (0.0, 5.0)},
        baseline={"k": 1.0}, tuner="random", budget=400, seed=3, episodes=1, final_episodes=2,
        num_envs=2, tuner_options={"recommendation": "best_seen"}, quiet=True,
        folder=tmp_path / "run",
    )  # fmt: skip
    monkeypatch.chdir(tmp_path)
    exec(way(tmp_path / "run", tmp_path / "out"), {})
    assert outcome(tmp_path / "again") == outcome(tmp_path / "run")


def test_the_program_of_a_run_of_tune_on_a_task_of_zoac(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    zoac.tune(task="pid_acc", tuner="es", budget=120, seed=2, episodes=1, final_episodes=2,
              tuner_options={"population": 4}, quiet=True, folder=tmp_path / "run")  # fmt: skip
    monkeypatch.chdir(tmp_path)
    exec(way(tmp_path / "run", tmp_path / "out"), {})
    assert outcome(tmp_path / "again") == outcome(tmp_path / "run")


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep of two runs whose options come from several places."""
    where = tmp_path_factory.mktemp("swept")
    words = ["task=pid_acc", "tuner=zoac", "seed=1,2", "fidelity=authors_code", *SHORT]
    options = ["tuner.exploration.sigma=0.1", "tuner.critic.hidden=[8,8]", "initial_samples=2"]
    called([sys.executable, "-m", "zoac.run", "-m", *words, *options], where)
    return where


@pytest.fixture
def swept_run(swept: Path) -> Path:
    (folder,) = {path.parent for path in swept.glob("runs/**/seed=2/**/result.json")}
    return folder


def test_the_command_of_one_run_of_a_sweep(swept: Path, swept_run: Path, tmp_path: Path) -> None:
    command = way(swept_run, tmp_path / "out")
    assert " -m seed" not in command
    called(command_of(command), tmp_path)
    (again,) = {path.parent for path in tmp_path.glob("again/**/result.json")}
    assert outcome(again) == outcome(swept_run)
    one, other = (json.loads((f / "run.json").read_text()) for f in (again, swept_run))
    assert one["config_hash"] == other["config_hash"]


def test_a_compact_run_has_a_command_too(swept: Path, swept_run: Path, tmp_path: Path) -> None:
    assert compact.main([str(swept_run), "--out", str(tmp_path / "small")]) == 0
    compacted = way(tmp_path / "small", tmp_path / "out")
    assert compacted == way(swept_run, tmp_path / "out")


def test_a_single_run_has_the_command_that_made_it(tmp_path: Path) -> None:
    command = way(write_run(tmp_path), tmp_path / "out")
    assert command == "python -m zoac.run task=pid_acc tuner=zoac seed=0 runs_dir=again"


def test_a_study_of_a_program_has_the_command_that_made_it(tmp_path: Path) -> None:
    (tmp_path / "sim.py").write_text("print('{\"cost\": 1.0}')\n")
    words = ["task=program", f"task.command=[{sys.executable},sim.py]", "task.space={kp:[0,20]}"]
    called(
        [sys.executable, "-m", "zoac.run", *words, "task.experiments=3", "tuner=random"], tmp_path
    )
    (folder,) = {path.parent for path in tmp_path.glob("runs/**/result.json")}
    command = command_of(way(folder, tmp_path / "out"))
    assert command[1:3] == ["-m", "zoac.run"]
    called(command, tmp_path)
    (again,) = {path.parent for path in tmp_path.glob("again/**/result.json")}
    assert outcome(again) == outcome(folder)
