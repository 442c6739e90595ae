"""A `for` loop over a study goes on where a killed one was."""

import subprocess
import sys
import threading

import pytest

from zoac.core.errors import RunFolderError
from zoac.study import loop
from zoac.study.study import Study

CODE = """
import os, sys
from zoac.study.study import Study
study = Study({"kp": (0, 20)}, sys.argv[1], experiments=4, tuner="random")
for trial in study:
    print(trial.number, flush=True)
    if trial.number == 3 and len(sys.argv) > 2:
        os._exit(9)
    study.tell(trial, trial.parameters["kp"])
"""


def study(folder, **options):
    return Study({"kp": (0, 20)}, folder, **{"experiments": 4, "tuner": "random", **options})


def script(*arguments):
    """Run the script of the documentation; return exit status and numbers of its experiments."""
    done = subprocess.run([sys.executable, "-c", CODE, *map(str, arguments)], timeout=60,
                          stdout=subprocess.PIPE, text=True)  # fmt: skip
    return done.returncode, [int(number) for number in done.stdout.split()]


def test_a_script_killed_in_an_experiment_goes_on_with_that_experiment(tmp_path):
    assert script(tmp_path, "dies") == (9, [1, 2, 3])
    assert script(tmp_path) == (0, [3, 4])
    made = Study(folder=tmp_path)
    assert made.finished
    assert [trial.state for trial in made.trials] == ["told"] * 4


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
    threading.Timer(0.5, made.abandon, (lost,)).start()
    assert next(iter(Study(folder=tmp_path))).number == 3
    said = capsys.readouterr().err
    assert said.count("waiting: the next experiment depends on trial(s) 1, which have no") == 1


def test_a_loop_over_a_folder_that_cannot_be_written_is_refused(tmp_path):
    made = study(tmp_path)
    (tmp_path / loop.CARRIED_OUT).mkdir()  # which cannot be opened as a file
    with pytest.raises(RunFolderError, match="cannot write"):
        next(iter(made))
