"""A recorded trace is judged by the study's specs as an episode is by a task's."""

import json

import numpy as np
import pandas as pd
import pytest

import zoac
from zoac import specs
from zoac.core.errors import ConfigError, StudyError
from zoac.study.commands import command
from zoac.study.study import Study

HARD = specs.overshoot("y", "r", max=0.05)
SOFT = specs.itae("y", "r", weight=2.0)


def response(zeta, wn=6.0, begins=3.0):
    """Return the step response of a second-order system, its clock not at 0."""
    t = np.arange(0.0, 4.0, 0.01)
    damped = wn * np.sqrt(1.0 - zeta**2)
    y = 1.0 - np.exp(-zeta * wn * t) * (
        np.cos(damped * t) + zeta / np.sqrt(1.0 - zeta**2) * np.sin(damped * t)
    )
    return pd.DataFrame({"time": t + begins, "y": y, "r": 1.0, "note": "text"})


def study(folder=None, **options):
    given = {"specs": [HARD, SOFT], "experiments": 12, "tuner": "random", **options}
    return Study({"zeta": (0.1, 0.99), "other": (0.0, 1.0)}, folder, **given)


def test_specs_with_a_limit_rank_and_the_others_are_the_cost(tmp_path):
    made = study(tmp_path)
    trial = made.tell(made.ask(), trace=response(0.2))
    assert trial.specs[HARD.label] == pytest.approx(np.exp(-np.pi * 0.2 / np.sqrt(0.96)), abs=1e-3)
    assert trial.cost == pytest.approx(2.0 * trial.specs[SOFT.label])
    excess = (trial.specs[HARD.label] - 0.05) / 0.05
    assert trial.violation == pytest.approx(1.0 + excess / (1.0 + excess))
    kept = made.tell(made.ask(), trace=response(0.8))
    assert kept.violation == 0.0
    assert made.best == kept
    again = Study(folder=tmp_path)
    assert again.trials == made.trials
    assert again.settings.specs == (HARD, SOFT)
    assert again.history[HARD.label].tolist() == [t.specs[HARD.label] for t in made.trials]
    made.tell(1, trace=response(0.2))  # the same again
    assert len(made.trials) == 2


def test_a_value_without_bound_is_infinite_for_who_opens_the_study_again(tmp_path):
    never = specs.settling_time("y", "r", max=1.0)
    made = study(tmp_path, specs=[never])
    trial = made.tell(made.ask(), 3.0, trace=response(0.02, wn=2.0))
    assert trial.violation > 1.0
    assert trial.cost == 3.0
    for one in (made, Study(folder=tmp_path)):
        assert one.trial(1).specs == {never.label: np.inf}
        assert one.history[never.label].tolist() == [np.inf]


def test_another_trace_of_the_same_cost_is_another_result():
    made = study(specs=[HARD])
    told = made.tell(made.ask(), 1.0, trace=response(0.2))
    assert made.tell(1, 1.0, trace=response(0.2)) == told
    for other in ({"trace": response(0.8)}, {}):
        with pytest.raises(StudyError, match="trial 1 has a result already"):
            made.tell(1, 1.0, **other)


def test_tuning_by_traces_keeps_the_overshoot():
    made = study(tuner="cmaes", experiments=30)
    for trial in made:
        made.tell(trial, trace=response(trial.parameters["zeta"]))
    assert made.best.violation == 0.0
    assert made.best.parameters["zeta"] > 0.68  # 5% overshoot is a damping of 0.69


@pytest.mark.parametrize(
    ("trace", "given", "says"),
    [
        (response(0.5).drop(columns="time"), {}, "no column 'time'"),
        (response(0.5).rename(columns={"y": "Y"}), {}, "no column 'y'; did you mean 'Y'|no column"),
        (response(0.5).iloc[::-1], {}, "does not increase"),
        (pd.concat([response(0.5), response(0.9)[["y"]]], axis=1), {}, "several columns 'y'"),
        (response(0.5).assign(y=pd.Timedelta(1)), {}, "'y' holds dates or durations"),
        (response(0.5).assign(time=pd.Timestamp(0, tz="UTC")), {}, "expected numbers, the time in"),
        (response(0.5).assign(y="a"), {}, "'y' holds what is no number"),
        (response(0.5).assign(y=np.nan), {}, "'y' holds what is not finite"),
        ("rec.csv", {}, "expected a DataFrame, got a str; read a file with pandas.read_csv"),
        ({"time": [0, 1], "y": [0, 1]}, {}, "got a dict; .* of columns with pandas.DataFrame"),
        (response(0.5), {"cost": 1.0}, "give none beside the trace"),
        (response(0.5), {"failed": "no"}, "one of them"),
    ],
)
def test_a_trace_that_cannot_be_judged_leaves_the_trial_pending(trace, given, says):
    made = study()
    trial = made.ask()
    with pytest.raises(ConfigError, match=says):
        made.tell(trial, trace=trace, **given)
    assert made.pending == [trial]


def test_what_cannot_judge_a_trace_is_refused():
    with pytest.raises(ConfigError, match=r"give the study specs=\[...\]"):
        made = study(specs=[])
        made.tell(made.ask(), trace=response(0.5))
    with pytest.raises(ConfigError, match="needs a cost beside it"):
        made = study(specs=[HARD])
        made.tell(made.ask(), trace=response(0.5))
    own = specs.Spec("mine", ("y",), lambda time, y: 0.0, max=1.0)
    for spec in (own, specs.gain_margin(min=2.0)):
        with pytest.raises(ConfigError, match="cannot keep a function of yours; use such a figure"):
            study(specs=[spec])
    with pytest.raises(ConfigError, match=r"specs\[0\]='overshoot': expected a spec"):
        study(specs=["overshoot"])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("3", "specs.yaml: expected entries by name, or a list"),
        ("- overshoot", "specs[0]='overshoot': expected a spec of zoac.specs, such as {'oversh"),
        ("- {name: iae, signals: [y, r]}", "expected a spec of zoac.specs, such as {'overshoot': "),
        ("- rms: {y: 3}", "specs[0].rms(3): expected the name of a signal"),
        ("- iae: {window: 3}", "iae: window=3, expected (from, to) in sec"),
        ("- rms: {max: 1, over: mean}", "a study has no use for 'over'"),
        ("- settling_time: {bnd: 0.1}", "no argument 'bnd'; did you mean 'ban"),
    ],
)
def test_a_file_that_holds_no_spec_is_answered_with_what_a_spec_is(text, says, tmp_path, capsys):
    (tmp_path / "space.yaml").write_text("zeta: [0.1, 0.99]\n")
    (tmp_path / "specs.yaml").write_text(text)
    assert command(["create", str(tmp_path / "rig"), "--space", str(tmp_path / "space.yaml"),
                    "--specs", str(tmp_path / "specs.yaml")]) == 1  # fmt: skip
    assert says in capsys.readouterr().err


def test_the_command_line_takes_specs_and_traces(tmp_path, capsys):
    (tmp_path / "space.yaml").write_text("zeta: [0.1, 0.99]\nother: [0, 1]\n")
    (tmp_path / "specs.yaml").write_text(
        "- overshoot: {y: y, r: r, max: 0.05}\n- itae: {weight: 2.0}\n"
    )
    response(0.8).to_csv(tmp_path / "trace.csv")
    rig = str(tmp_path / "rig")
    assert command(["create", rig, "--space", str(tmp_path / "space.yaml"), "--specs",
                    str(tmp_path / "specs.yaml")]) == 0  # fmt: skip
    assert zoac.Study(folder=rig).settings.specs == (HARD, SOFT)
    command(["ask", rig])
    capsys.readouterr()
    assert command(["tell", rig, "1", "--trace", str(tmp_path / "trace.csv")]) == 0
    assert json.loads(capsys.readouterr().out)["cost"] > 0
    assert command(["tell", rig, "1", "--trace", str(tmp_path / "absent.csv")]) == 1
    (tmp_path / "specs.yaml").write_text("- overshot: {y: y, r: r}\n")
    assert command(["create", rig + "2", "--space", str(tmp_path / "space.yaml"), "--specs",
                    str(tmp_path / "specs.yaml")]) == 1  # fmt: skip
    assert "did you mean 'overshoot'" in capsys.readouterr().err


@pytest.fixture
def tell_file(tmp_path, capsys):
    """Return a function that tells the next trial a CSV file; it returns cost and errors."""
    made = study(tmp_path / "rig", specs=[SOFT], tuner="random", workers=12)

    def told(text):
        (tmp_path / "trace.csv").write_text(text, encoding="utf-8")
        number = str(made.ask().number)
        command(["tell", str(made.folder), number, "--trace", str(tmp_path / "trace.csv")])
        printed = capsys.readouterr()
        return (json.loads(printed.out)["cost"] if printed.out else None), printed.err

    return told


def test_a_comma_at_the_end_of_each_row_shifts_no_column(tell_file):
    text = response(0.5).to_csv(index=False)
    header, *rows = text.splitlines()
    plain = tell_file(text)
    assert plain[0] > 0
    assert tell_file("\n".join([header, *(f"{row}," for row in rows)])) == plain
    assert tell_file("\n".join(["\ufeff" + header + ",", *(f"{row}," for row in rows)])) == plain


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,y,r\n0,1,1,9\n1,1,1,9\n", "cannot be read as a table: Length of header"),
        ("time,y,r\n0,1,1\n1,1,1,9\n", "Expected 3 fields in line 3, saw 4"),
        ("time,y,r,y\n0,1,1,2\n1,1,1,2\n", "several columns are called 'y'"),
        ("", "cannot be read as a table"),
    ],
)
def test_a_file_whose_values_belong_to_no_column_is_refused(text, says, tell_file):
    cost, said = tell_file(text)
    assert cost is None
    assert says in said
