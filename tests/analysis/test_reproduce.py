"""What a report says of how to make a run again makes it again."""

import json
import re
import shlex
import sys
from html import unescape

import pytest

import zoac
from tests import commands
from tests.analysis.folders import write_run
from zoac.analysis import compact, report
from zoac.analysis.data.load import load
from zoac.analysis.pages.reproduce import reproduce

SHORT = ["budget=120", "eval_every=60", "evaluation.episodes=1", "evaluation.final_episodes=2"]


def way(folder):
    """Return the first code of what a report says about a run."""
    (run,) = load(folder).runs
    return unescape(re.search(r"<pre>(.*?)</pre>", reproduce(run), re.S)[1])


def called(words, where):
    done = commands.run(*words[1:], cwd=where)
    assert done.returncode == 0, done.stderr


def outcome(folder):
    found = json.loads((folder / "result.json").read_text())
    return found["parameters"], found["cost_per_episode"], found["env_steps"]


def command_of(text):
    words = shlex.split(text)
    assert words[0] == "python"
    return [sys.executable, *words[1:]]


def test_the_program_of_a_run_of_tune(tmp_path, monkeypatch):
    zoac.tune(
        env="Pendulum-v1", controller=lambda p, obs: -p["k"] * obs[2], space={"k": (0.0, 5.0)},
        baseline={"k": 1.0}, tuner="random", budget=400, seed=3, episodes=1, final_episodes=2,
        num_envs=2, tuner_options={"recommendation": "best_seen"}, quiet=True,
        folder=tmp_path / "run",
    )  # fmt: skip
    monkeypatch.chdir(tmp_path)
    exec(way(tmp_path / "run"), {})
    assert outcome(tmp_path / "again") == outcome(tmp_path / "run")


def test_the_program_of_a_run_of_tune_on_a_task_of_zoac(tmp_path, monkeypatch):
    zoac.tune(task="pid_acc", tuner="es", budget=120, seed=2, episodes=1, final_episodes=2,
              tuner_options={"population": 4}, quiet=True, folder=tmp_path / "run")  # fmt: skip
    monkeypatch.chdir(tmp_path)
    exec(way(tmp_path / "run"), {})
    assert outcome(tmp_path / "again") == outcome(tmp_path / "run")


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A sweep of two runs whose options come from several places."""
    where = tmp_path_factory.mktemp("swept")
    words = ["task=pid_acc", "tuner=zoac", "seed=1,2", "fidelity=authors_code", *SHORT]
    options = ["tuner.exploration.sigma=0.1", "tuner.critic.hidden=[8,8]", "initial_samples=2"]
    called([sys.executable, "-m", "zoac.run", "-m", *words, *options], where)
    return where


@pytest.fixture
def swept_run(swept):
    (folder,) = {path.parent for path in swept.glob("runs/**/seed=2/**/result.json")}
    return folder


def test_the_command_of_one_run_of_a_sweep(swept, swept_run, tmp_path):
    command = way(swept_run)
    assert " -m seed" not in command
    called(command_of(command), tmp_path)
    (again,) = {path.parent for path in tmp_path.glob("again/**/result.json")}
    assert outcome(again) == outcome(swept_run)
    one, other = (json.loads((f / "run.json").read_text()) for f in (again, swept_run))
    assert one["config_hash"] == other["config_hash"]


def test_a_compact_run_has_a_command_too(swept, swept_run, tmp_path):
    assert compact.main([str(swept_run), "--out", str(tmp_path / "small")]) == 0
    compacted = way(tmp_path / "small")
    assert compacted == way(swept_run)


def test_a_single_run_has_the_command_that_made_it_in_its_report(tmp_path):
    folder = write_run(tmp_path, evaluations=())
    assert report.main([str(folder), "--no-replay", "--out", str(tmp_path)]) == 0
    text = (tmp_path / "report.html").read_text().split("<h3>How to reproduce</h3>")[1]
    command = "python -m zoac.run task=pid_acc tuner=zoac seed=0 runs_dir=again"
    assert text.startswith(f"\n<pre>{command}</pre>")


def test_a_study_of_a_program_has_the_command_that_made_it(tmp_path):
    (tmp_path / "sim.py").write_text("print('{\"cost\": 1.0}')\n")
    words = ["task=program", f"task.command=[{sys.executable},sim.py]", "task.space={kp:[0,20]}"]
    called(
        [sys.executable, "-m", "zoac.run", *words, "task.experiments=3", "tuner=random"], tmp_path
    )
    (folder,) = {path.parent for path in tmp_path.glob("runs/**/result.json")}
    command = command_of(way(folder))
    assert command[1:3] == ["-m", "zoac.run"]
    called(command, tmp_path)
    (again,) = {path.parent for path in tmp_path.glob("again/**/result.json")}
    assert outcome(again) == outcome(folder)
