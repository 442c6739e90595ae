"""A `for` loop over a study goes on where a killed one was."""

import threading

import pytest

from tests import commands
from zoac.core.errors import RunFolderError
from zoac.study import loop
from zoac.study.study import Study

CODE = """
import os
from zoac.study.study import Study
study = Study({"kp": (0, 20)}, "rig", experiments=4, tuner="random")
for trial in study:
    if trial.number == 3:
        os._exit(9)
    study.tell(trial, trial.parameters["kp"])
"""


def study(folder, **options):
    return Study({"kp": (0, 20)}, folder, **{"experiments": 4, "tuner": "random", **options})


def test_a_script_killed_in_an_experiment_goes_on_with_that_experiment(tmp_path):
    assert commands.run("-c", CODE, cwd=tmp_path).returncode == 9
    made = study(tmp_path / "rig")
    assert [trial.state for trial in made.trials] == ["told", "told", "pending"]
    assert [made.tell(trial, 1.0).number for trial in made] == [3, 4]
    assert made.finished


def test_a_trial_that_was_told_in_the_meantime_is_not_run_again(tmp_path):
    made = study(tmp_path, baseline={"kp": 1.0})
    made.ask()
    made.ask()
    running = iter(made)
    made.tell(next(running), 1.0)
    Study(folder=tmp_path).tell(2, 1.0)
    assert next(running).number == 3


def test_a_second_loop_does_not_take_the_trial_of_the_first(tmp_path):
    first = iter(study(tmp_path, baseline={"kp": 1.0}))
    assert next(first).number == 1
    assert next(iter(Study(folder=tmp_path))).number == 2
    first.close()
    assert next(iter(Study(folder=tmp_path))).number == 1


def test_with_several_workers_a_loop_says_which_trial_it_waits_for(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(loop, "PATIENCE", 0.05)
    made = study(tmp_path, workers=2, experiments=5)
    lost, other = made.ask(), made.ask()
    made.tell(other, 1.0)
    threading.Timer(0.3, made.abandon, (lost,)).start()
    assert next(iter(Study(folder=tmp_path))).number == 3
    said = capsys.readouterr().err
    assert said.count("waiting: the next experiment depends on trial(s) 1, which have no") == 1


def test_a_loop_over_a_folder_that_cannot_be_written_is_refused(tmp_path):
    made = study(tmp_path)
    (tmp_path / loop.CARRIED_OUT).mkdir()  # which cannot be opened as a file
    with pytest.raises(RunFolderError, match="cannot write"):
        next(iter(made))
