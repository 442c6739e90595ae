"""A study asks and is told; what it asks depends on results alone."""

import json
import math
import os
import random
import threading
import time

import pandas as pd
import pytest

import zoac
from tests import commands
from tests.support import needs_its_library
from zoac.analysis import report
from zoac.config.files import configuration
from zoac.core.errors import (
    ConfigError,
    NothingWorksError,
    RunFolderError,
    StudyError,
    StudyFinished,
    TrialsPending,
)
from zoac.runs.schema import JOURNAL
from zoac.study.state.settings import TUNERS
from zoac.study.study import Study

SPACE = {
    "kp": {"low": 0.0, "high": 20.0, "unit": "N/m", "baseline": 10.0},
    "ki": {"low": 1e-3, "high": 10.0, "scale": "log", "baseline": 0.1},
    "mode": {"choices": ["fast", "slow"], "baseline": "slow"},
    "ts": 0.01,
}
BASELINE = {"kp": 10.0, "ki": 0.1, "mode": "slow", "ts": 0.01}


def cost(p):
    return (p["kp"] - 3.0) ** 2 + p["ki"] + (p["mode"] == "slow")


QUICK = {name: {"initial_design": 28} for name in ("optuna", "botorch", "smac", "bo")}
"""Fewer models, which take the time."""


def study(folder=None, **options):
    given = {"space": SPACE, "tuner": "random", "experiments": 30, "workers": 4, **options}
    return Study(folder=folder, **{"tuner_options": QUICK.get(given["tuner"]), **given})


def answer(made, trial):
    """Tell what the trial's parameters give; some of them fail."""
    if int(trial.parameters["kp"] * 1e6) % 7 == 0:
        return made.tell(trial, failed="tripped")
    return made.tell(trial, cost(trial.parameters))


def asked(made):
    return [(trial.number, trial.x, trial.parameters, trial.state) for trial in made.trials]


@pytest.mark.parametrize("tuner", TUNERS)
def test_every_experiment_is_asked_once_and_the_baseline_first(tuner, tmp_path):
    needs_its_library(configuration(task=None, tuner=tuner)["tuner"]["_target_"])
    made = study(tmp_path, tuner=tuner)
    calls = []
    for trial in made:
        calls.append(trial.number)
        answer(made, trial)
    assert calls == list(range(1, 31))
    assert made.trials[0].parameters == BASELINE
    assert made.finished
    with pytest.raises(StudyFinished, match="all 30 experiments have been asked for"):
        made.ask()
    told = [trial for trial in made.trials if trial.state == "told"]
    assert made.best == min(told, key=lambda trial: trial.cost)
    if tuner == "nominal":  # which has nothing to ask: its recommendation is measured again
        assert [trial.parameters for trial in made.trials] == [BASELINE] * 30
    elif tuner != "es":
        repeated = [t.number for t in made.trials if t.parameters == BASELINE]
        assert repeated == [1]  # the tuner's own first point is not measured twice


@pytest.mark.parametrize("tuner", ["cmaes_full", "optuna", "random"])
def test_neither_order_nor_restarts_change_what_is_asked(tuner, tmp_path):
    whole = study(tmp_path / "whole", tuner=tuner)
    for trial in whole:
        answer(whole, trial)
    rng = random.Random(1)
    made = study(tmp_path / "parts", tuner=tuner)
    while not made.finished:
        if rng.random() < 0.2:
            made = Study(folder=tmp_path / "parts")
        if made.pending and rng.random() < 0.4:
            answer(made, rng.choice(made.pending))
        try:
            made.ask()
        except TrialsPending:
            answer(made, rng.choice(made.pending))
        except StudyFinished:
            for trial in made.pending:
                answer(made, trial)
    assert asked(made) == asked(whole)
    assert made.best.number == whole.best.number
    kept = ["number", "state", "cost", "kp", "ki", "mode"]
    pd.testing.assert_frame_equal(made.history[kept], whole.history[kept])


def test_failures_teach_the_tuner():
    made = study(tuner="cmaes_full", experiments=100, seed=1)
    for trial in made:
        if trial.parameters["kp"] > 6.0:
            made.tell(trial, failed="unstable")
        else:
            made.tell(trial, 50.0 - trial.parameters["kp"])  # the better, the nearer to failure
    states = [trial.state for trial in made.trials]
    assert states[:40].count("failed") > 15
    assert states[-40:].count("failed") < 15
    assert 5.0 < made.best.parameters["kp"] <= 6.0


def test_the_first_ten_all_failing_stops_it():
    made = study(workers=1, tuner="random", baseline_first=False)
    for _ in range(9):
        made.tell(made.ask(), failed="no licence")
    made.abandon(made.ask(), "gone")
    with pytest.raises(NothingWorksError, match="each of the first 10 .*: no licence; gone"):
        made.ask()
    one_good = study(workers=1, tuner="random")
    one_good.tell(one_good.ask(), 1.0)
    for _ in range(10):
        one_good.tell(one_good.ask(), failed="no licence")
    assert one_good.ask().number == 12


def test_a_result_is_on_the_disk_when_it_was_told(synchronised):
    made = study()
    trial, before = made.ask(), len(synchronised)
    made.tell(trial, 1.0)
    assert len(synchronised) == before + 1


def test_a_result_counts_once_and_another_is_refused(tmp_path):
    made = study(tmp_path)
    trial = made.ask()
    told = made.tell(trial, {"cost": 2.5, "metrics": {"energy": 1.0}})
    lines = (tmp_path / JOURNAL).read_bytes()
    assert made.tell(1, 2.5, metrics={"energy": 1.0}) == told
    assert made.tell(made.history["number"][0], told.cost, metrics=told.metrics) == told
    assert (tmp_path / JOURNAL).read_bytes() == lines
    for other in ({"cost": 3.0}, {"failed": "tripped"}):
        with pytest.raises(StudyError, match=r"trial 1 has a result already: cost 2\.5"):
            made.tell(1, **other)
    with pytest.raises(StudyError, match="there is no trial 2; asked: 1 to 1"):
        made.tell(2, 1.0)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, "a cost, a trace or the reason of a failure"),
        ({"cost": 1.0, "failed": "no"}, "one of them"),
        ({"cost": float("nan")}, "the cost is nan, expected a finite number"),
        ({"cost": "1.0"}, "the cost is '1.0', expected a number"),
        ({"cost": 10**400}, "the cost is 1000.*, expected a number"),
        ({"cost": 1.0, "metrics": {"a": -(10**400)}}, "metrics: 'a' is -1000.*, expected a number"),
        ({"cost": {"costs": 1.0}}, "unknown key 'costs'; did you mean 'cost'"),
        ({"cost": {"metrics": {}}}, "no 'cost'; it has metrics"),
        ({"cost": 1.0, "metrics": {"a": None}}, "metrics: 'a' is None"),
        ({"cost": 1.0, "metrics": 3}, "metrics: expected numbers by name, got 3"),
        ({"cost": 1.0, "metrics": {"cost_mean": 7.0}}, "metric 'cost_mean': .* such as 'my_cost"),
        ({"cost": {"cost": 1.0, "metrics": {"best_trial": 7}}}, "metric 'best_trial': results"),
        ({"failed": False}, "the reason of a failure is False, expected text"),
    ],
)
def test_a_result_that_cannot_be_used_leaves_the_trial_pending(given, says):
    made = study()
    trial = made.ask()
    with pytest.raises(ConfigError, match=says):
        made.tell(trial, **given)
    assert made.pending == [trial]


@pytest.mark.parametrize("trial", [2.7, True, None, "1", float("nan"), float("inf")])
def test_a_result_of_what_is_no_trial_is_refused(trial):
    made = study()
    pending = [made.ask(), made.ask()]
    for end in (lambda: made.tell(trial, 1.0), lambda: made.abandon(trial)):
        with pytest.raises(StudyError, match=f"no trial '?{trial}'?; expected a trial or its numb"):
            end()
    assert made.pending == pending


def test_less_violation_goes_before_less_cost():
    made = study(tuner="random", constraints={"overshoot": 0.05})
    for overshoot, value in ((0.1, 1.0), (0.05, 3.0), (0.2, 0.5), (0.01, 2.0)):
        made.tell(made.ask(), value, constraints={"overshoot": overshoot})
    assert made.best.number == 4
    assert made.trials[0].violation == pytest.approx(1.5)  # 1 + v / (1 + v), v = 1
    assert made.history["overshoot"].tolist() == [0.1, 0.05, 0.2, 0.01]
    with pytest.raises(ConfigError, match="does not say the constraint"):
        made.tell(made.ask(), 1.0)


def test_of_numbers_without_bound_minus_infinity_alone_keeps_a_limit(tmp_path):
    made = study(tmp_path, tuner="random", constraints={"gain": 0.0})
    for gain in ("-inf", "inf", "nan"):
        made.tell(made.ask(), 1.0, constraints={"gain": float(gain)}, metrics={"m": float(gain)})
    for one in (made, Study(folder=tmp_path)):
        assert [trial.violation for trial in one.trials] == [0.0, 2.0, 2.0]
        assert list(map(str, one.history["gain"])) == ["-inf", "inf", "nan"]
        assert list(map(str, one.history["m"])) == ["-inf", "inf", "nan"]
    pd.read_json(tmp_path / JOURNAL, lines=True)


def test_violations_teach_the_tuner(tmp_path):
    def run(limit):
        made = study(
            tmp_path / str(limit), tuner="cmaes", constraints={"kp": limit}, experiments=60
        )
        for trial in made:
            made.tell(trial, cost(trial.parameters), constraints={"kp": -trial.parameters["kp"]})
        return made

    for limit in (0.0, -6.0):
        made = run(limit)
        assert made.best.violation == 0
        assert (6.0 if limit else 2.0) <= made.best.parameters["kp"] < (8.0 if limit else 4.0)
        last = sum(trial.parameters["kp"] < 6.0 for trial in made.trials[-20:])
        assert last < 15 if limit else last > 15


def test_a_trial_that_never_comes_back_is_abandoned_and_its_number_is_gone(tmp_path):
    made = study(tmp_path, workers=1, trial_timeout=0.05)
    made.tell(made.ask(), 1.0)
    lost = made.ask(by="rig 2")
    with pytest.raises(TrialsPending, match=r"trial\(s\) 2, which have no result"):
        made.ask()
    time.sleep(0.06)
    again = Study(folder=tmp_path)
    assert again.ask().number == 3
    assert again.trial(2).state == "abandoned"
    assert again.trial(2).reason == "no result within 0.05 s"
    assert again.trial(2).by == "rig 2"
    with pytest.raises(StudyError, match="trial 2 has a result already: abandoned"):
        made.tell(lost, 3.0)


def test_asking_waits_for_results_of_others():
    made = study(workers=1)
    first = made.ask()
    threading.Timer(0.1, made.tell, (first, 1.0)).start()
    assert made.ask(wait=5.0).number == 2


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"wait": "3"}, "wait='3': expected seconds, 0 or more"),
        ({"wait": math.nan}, "wait=nan: expected seconds"),
        ({"by": 3}, "by=3: input should be a valid string"),
    ],
)
def test_who_cannot_wait_so_asks_for_nothing(given, says):
    made = study()
    with pytest.raises(ConfigError, match=says):
        made.ask(**given)
    assert not made.trials


def test_a_loop_that_forgets_to_tell_is_told_so():
    made = study(workers=1)
    with pytest.raises(StudyError, match="trial 1 has no result; tell or abandon it first"):
        for _ in made:
            pass


def test_a_study_is_its_folder(tmp_path):
    made = study(tmp_path, seed=3)
    made.tell(made.ask(), 1.0)
    assert study(tmp_path, seed=3).trials == made.trials
    assert json.loads((tmp_path / "run.json").read_text())["tuner_name"] == "Random search"
    with pytest.raises(RunFolderError, match="other settings:\n  budget: 30, now 40"):
        study(tmp_path, seed=3, experiments=40)
    with pytest.raises(RunFolderError, match="there is no study in .*; create it"):
        Study(folder=tmp_path / "elsewhere")
    with pytest.raises(ConfigError, match="a study needs a space"):
        Study()


@pytest.mark.parametrize(
    "given",
    [
        {"experiments": 31}, {"seed": 5}, {"tuner": "bo"}, {"tuner_options": {"sigma": 0.1}},
        {"workers": 3}, {"baseline": {"kp": 9.0}}, {"baseline_first": False},
        {"constraints": {"power": 2.0}}, {"specs": [zoac.specs.iae("y", "r")]},
        {"acceptance_test": 0.2}, {"initial_sigma": 0.1}, {"initial_samples": 5},
    ],
)  # fmt: skip
def test_a_study_that_is_opened_by_its_folder_alone_takes_no_settings(given, tmp_path):
    made = study(tmp_path)
    with pytest.raises(ConfigError, match=f"^{next(iter(given))}: .* keeps its own settings"):
        Study(folder=tmp_path, **given)
    assert Study(folder=tmp_path).settings.config == made.settings.config


def test_a_line_that_a_crash_cut_is_survived(tmp_path):
    made = study(tmp_path)
    for _ in range(3):
        made.ask()
    made.tell(1, 1.0)
    made.tell(2, 2.0)
    content = (tmp_path / JOURNAL).read_bytes()
    lines = content.splitlines(keepends=True)
    for cut in (1, len(lines[-1]) // 2, len(lines[-1]) - 1):
        (tmp_path / JOURNAL).write_bytes(b"".join(lines[:-1]) + lines[-1][:cut])
        again = Study(folder=tmp_path)
        assert [t.state for t in again.trials] == ["told", "pending", "pending"]
        again.tell(2, 5.0)
        assert Study(folder=tmp_path).trial(2).cost == 5.0


@pytest.mark.parametrize(
    ("line", "says"),
    [("{", "line 2 is damaged"),
     ('{"kind": "told", "number": 1, "time": 0, "cost": "x"}', "line 2 is damaged"),
     ('{"kind": "told", "number": 1, "cost": 1}', "line 2 is damaged"),
     ('{"kind": "told", "number": 1, "time": 0, "cost": 1, "metrics": 3}', "line 2 is damaged"),
     ('{"kind": "asked", "number": 2, "time": 0, "by": "", "x": [0]}', "line 2 is damaged"),
     ('{"kind": "over", "number": 1, "time": 0}', "line 2 is damaged"),
     ('{"kind": "told", "number": 1, "time": 0, "cost": 1}', "two results of trial 1")],
)  # fmt: skip
def test_other_damage_is_refused(line, says, tmp_path):
    made = study(tmp_path)
    made.ask()
    made.tell(1, 1.0)
    lines = (tmp_path / JOURNAL).read_text().splitlines()
    (tmp_path / JOURNAL).write_text("\n".join([lines[0], line, lines[1], ""]))
    with pytest.raises(RunFolderError, match=says):
        Study(folder=tmp_path)


def test_a_journal_that_became_shorter_is_refused(tmp_path):
    made = study(tmp_path)
    made.ask()
    (tmp_path / JOURNAL).write_bytes(b"")
    with pytest.raises(RunFolderError, match="has become shorter"):
        made.ask()


def test_processes_at_once_lose_and_double_nothing(tmp_path):
    study(tmp_path, tuner="random", experiments=20)
    code = f"""
import os, time
from zoac.study.study import Study
study = Study(folder={str(tmp_path)!r})
open({str(tmp_path)!r} + f"/ready-{{os.getpid()}}", "w")
while not os.path.exists({str(tmp_path)!r} + "/go"):
    time.sleep(0.001)
for trial in study:
    study.tell(trial, trial.parameters["kp"])
    print(trial.number)
"""
    running = [commands.Started("-c", code, cwd=tmp_path) for _ in range(3)]
    while len(list(tmp_path.glob("ready-*"))) < 3:
        assert all(process.poll() is None for process in running)
        time.sleep(0.01)
    (tmp_path / "go").touch()
    numbers = [int(n) for process in running for n in process.communicate()[0].split()]
    assert sorted(numbers) == list(range(1, 21))
    assert [process.returncode for process in running] == [0] * 3
    made = Study(folder=tmp_path)
    assert [t.cost for t in made.trials] == [t.parameters["kp"] for t in made.trials]
    assert made.finished


def test_other_values_for_the_same_results_are_noticed(tmp_path):
    made = study(tmp_path, tuner="cmaes", workers=1)
    for _ in range(3):
        made.tell(made.ask(), 1.0)
    lines = [json.loads(line) for line in (tmp_path / JOURNAL).read_text().splitlines()]
    lines[4]["x"][0] += 0.01
    (tmp_path / JOURNAL).write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(RunFolderError, match="trial 3 has other parameters than tuner 'cmaes'"):
        Study(folder=tmp_path).ask()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"tuner": "zoac"}, "learns from single steps of an episode"),
        ({"tuner": "zoac_plus"}, "known: bo, botorch, cmaes"),
        ({"tuner": "cmase"}, "did you mean"),
        ({"tuner": "es", "experiments": 15}, "learns from 20 at a time, and 14 are left"),
        ({"tuner": "es", "acceptance_test": 0.5}, "learns from 20 at a time, and 14 are left"),
        ({"experiments": 0}, "experiments=0: input should be greater than or equal to 1"),
        ({"workers": 1.5}, "workers=1.5: input should be a valid integer"),
        ({"trial_timeout": 0}, "trial_timeout=0: input should be greater than 0"),
        ({"tuner": "cmaes", "tuner_options": {"populatoin": 3}}, "did you mean 'population'"),
        ({"tuner": "cmaes", "tuner_options": {"population": "x"}}, "population"),
        ({"constraints": ["overshoot"]}, "constraints: expected numbers by name"),
        ({"constraints": {"overshoot": 10**400}}, "'overshoot' is 1000.*, expected a number"),
        ({"constraints": {"overshoot": math.nan}}, r"\['overshoot'\]=nan: expected a finite"),
        ({"constraints": {"overshoot": None}}, "'overshoot' is None, expected a number"),
        ({"acceptance_test": 2.0}, "acceptance_test"),
        ({"baseline": {"kp": 30.0}}, "lies outside"),
        ({"baseline": 5}, "expected values by name"),
        ({"specs": 5}, "expected specs"),
        ({"tuner": 5}, "tuner=5: input should be a valid string"),
        ({"tuner_options": 5}, "tuner_options=5: input should be a valid dictionary"),
        ({"variant": 5}, "variant=5: input should be a valid string"),
        ({"initial_samples": "x"}, "initial_samples='x': input should be a valid integer"),
        ({"initial_sigma": 2.0}, "initial_sigma"),
        ({"acceptance_test": math.nan}, "acceptance_test=nan: input should be a finite"),
        ({"initial_sigma": math.inf}, "initial_sigma=inf: input should be a finite"),
        ({"initial_samples": math.nan}, "initial_samples=nan: input should be a valid integer"),
        ({"trial_timeout": math.inf}, "trial_timeout=inf: input should be a finite number"),
        (
            {"tuner_options": {"sigma": math.nan}},
            r"tuner_options\['sigma'\]=nan: expected a finite",
        ),
        ({"space": {**SPACE, "ts": math.nan}}, r"space\['ts'\]=nan: expected a finite number"),
        ({"baseline_first": "x"}, "baseline_first='x': input should be a valid boolean"),
        ({"baseline_first": None, "space": {"kp": (0, 1)}}, "baseline_first=None"),
    ],
)
def test_settings_that_cannot_be_used_begin_nothing(options, says, tmp_path):
    with pytest.raises(ConfigError, match=says):
        study(tmp_path / "rig", **options)
    assert not (tmp_path / "rig").exists()


def test_an_acceptance_test_decides_the_answer(tmp_path):
    def run(name, function):
        made = study(tmp_path / name, experiments=41, acceptance_test=0.3, tuner="cmaes_full")
        for trial in made:
            made.tell(trial, function(trial))
        return made

    better = run("better", lambda trial: cost(trial.parameters))
    assert better.outcome["acceptance_test"]["accepted"]
    assert better.best.cost < cost(BASELINE)
    lucky = run("lucky", lambda trial: 1.0 / trial.number if trial.number < 20 else 5.0)
    assert not lucky.outcome["acceptance_test"]["accepted"]
    assert lucky.best.parameters == BASELINE
    result = zoac.load_result(lucky.folder)
    assert result.parameters == BASELINE
    assert not result.record["acceptance_test"]["accepted"]


def test_pandas_and_the_report_read_a_finished_study(tmp_path):
    made = study(tmp_path / "rig")
    for trial in made:
        answer(made, trial)
    rows = pd.read_json(tmp_path / "rig" / JOURNAL, lines=True)  # in one line
    assert rows["kind"].value_counts()["asked"] == 30
    assert rows["cost"].min() == pytest.approx(made.best.cost)
    assert not list(tmp_path.glob("rig/*.pkl"))
    assert report.main([str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    assert any((tmp_path / "out").rglob("*.html"))
    result = zoac.load_result(tmp_path / "rig")
    assert result.parameters == made.best.parameters
    assert result.cost_mean == made.best.cost
    assert result.baseline_cost_mean == made.trials[0].cost
    assert result.history["cost_mean"].min() == made.best.cost


def test_a_study_that_was_killed_before_its_result_writes_it_later(tmp_path):
    made = study(tmp_path, tuner="random", experiments=2, workers=1)
    for trial in made:
        made.tell(trial, 1.0)
    os.remove(tmp_path / "result.json")
    Study(folder=tmp_path)
    assert zoac.load_result(tmp_path).cost_mean == 1.0


def test_the_answer_is_exported(tmp_path):
    made = study(tmp_path)
    with pytest.raises(StudyError, match="no experiment has succeeded yet"):
        made.export(tmp_path / "gains.h")
    made.tell(made.ask(), 1.0)
    with pytest.raises(ConfigError, match=r"export to None: expected a file, such as 'gains.yaml'"):
        made.export(None)
    assert "kp = 10.0; /* N/m */" in made.export(tmp_path / "gains.h").read_text()
