"""`task=program` on the command line runs experiments, and nothing else."""

import json
import sys

import pytest

import zoac
from tests import commands
from zoac.check import __main__ as check
from zoac.config.compose import compose_config, resolved
from zoac.config.factory import PROGRAM
from zoac.config.validate import locate
from zoac.core.errors import ConfigError, RunFolderError
from zoac.study.experiments import run_experiments
from zoac.study.program import ProgramTask

SIMULATE = """
import json, sys
open("calls", "a").write("x")
p = json.load(sys.stdin)
if p["kp"] > 18:
    print("warming up", file=sys.stderr)
    sys.exit("too stiff")
print(json.dumps({"cost": (p["kp"] - 3) ** 2 + p["ki"]}))
"""


OVERRIDES = [
    "task=program", f"task.command=[{sys.executable},-S,-E,simulate.py]",
    "task.space={kp:{low:0,high:20,baseline:9},ki:[0,5]}", "task.baseline={ki:1}",
    "task.experiments=6", "tuner=random", "variant=mine",
]  # fmt: skip


@pytest.fixture
def tuned(tmp_path, monkeypatch):
    """Return a function that runs `task=program` with a small program in a folder."""
    (tmp_path / "simulate.py").write_text(SIMULATE)
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        tuner = next((a[6:] for a in arguments if a.startswith("tuner=")), "random")
        config = resolved(compose_config([*OVERRIDES, *arguments]))
        return run_experiments(config, "program", tuner)

    return run


def test_it_runs_so_many_experiments_and_answers_with_the_best(tuned, tmp_path):
    done = commands.run("-m", "zoac.run", *OVERRIDES, "executor.workers=3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len((tmp_path / "calls").read_text()) == 6
    folder = tmp_path / "runs/program/random/seed=0/variant=mine"
    result = json.loads((folder / "result.json").read_text())
    assert (result["task"], result["tuner"], result["variant"]) == ("program", "random", "mine")
    assert result["experiments"] == 6
    assert result["baseline_cost_mean"] == 37.0
    study = zoac.Study(folder=folder)
    assert result["parameters"] == study.best.parameters
    assert study.settings.workers == 3
    assert f"cost {result['cost_mean']:.6g}, experiment {study.best.number} of 6; " in done.stdout
    assert "baseline values: cost 37\n" in done.stdout
    assert tuned("executor.workers=3") == result
    assert len((tmp_path / "calls").read_text()) == 6  # it is done
    with pytest.raises(RunFolderError, match="use resume=auto"):
        tuned("executor.workers=3", "resume=never")
    tuned("executor.workers=2", "resume=overwrite")
    assert len((tmp_path / "calls").read_text()) == 12


def test_a_failure_is_told_by_its_first_and_last_words(tuned, capsys):
    tuned("task.space={kp:{low:17,baseline:17.5}}")
    text = capsys.readouterr().out
    assert "failed (python" in text
    assert "ended with exit status 1: too stiff)\n" in text


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["task.command=null"], "^task.command: a value is needed"),
        (["task.space=null"], "task.space: a value is needed"),
        (["tuner=zoac"], "tuner='zoac' learns from single steps of an episode"),
        (["budget=100"], "budget=100: experiments of a program have no such setting"),
        (["task.experiments=0"], "task.experiments=0"),
        (["task.retries=half"], "task.retries='half'"),
        (["tuner=cmaes", "tuner.populatoin=3"], "tuner.populatoin"),
    ],
)
def test_what_cannot_be_used_is_named_before_anything_runs(arguments, says, tuned, tmp_path):
    with pytest.raises(ConfigError, match=says):
        tuned(*arguments)
    assert not (tmp_path / "runs").exists()


def test_options_of_the_tuner_count(tuned, tmp_path):
    tuned("tuner=cmaes_full", "tuner.start=middle", "task.experiments=11",
          'task.command=[echo,"{\\"cost\\": 1}"]')  # fmt: skip
    (folder,) = tmp_path.glob("runs/program/cmaes_full/seed=0/*")
    record = json.loads((folder / "run.json").read_text())
    assert record["config"]["tuner"]["start"] == "middle"


def test_other_commands_say_that_there_is_no_environment(capsys):
    assert locate(PROGRAM, "") is ProgramTask
    with pytest.raises(ConfigError, match="task=program has no environment"):
        zoac.make_task("program")
    assert check.main(OVERRIDES) == 1
    assert "task=program has no environment" in capsys.readouterr().err
