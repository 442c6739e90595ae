"""`python -m zoac.study`: JSON and nothing else on standard output, exit statuses for scripts."""

import json
import sys
from pathlib import Path

import pytest

from tests import commands
from zoac.runs.lock import locked
from zoac.study.commands import command
from zoac.study.loop import CARRIED_OUT
from zoac.study.study import Study

ROOT = Path(__file__).parents[2]
SPACE = "kp: {low: 0, high: 20, unit: N/m, baseline: 10}\nki: [0.0, 5.0]\n"


@pytest.fixture
def rig(tmp_path, capsys):
    """A study of five random experiments."""
    (tmp_path / "space.yaml").write_text(SPACE)
    (tmp_path / "baseline.yaml").write_text("ki: 1\n")
    folder = str(tmp_path / "rig")
    assert command(["create", folder, "--space", str(tmp_path / "space.yaml"),
                    "--baseline", str(tmp_path / "baseline.yaml"), "--experiments", "5",
                    "--tuner", "random"]) == 0  # fmt: skip
    assert json.loads(capsys.readouterr().out) == {"folder": folder, "tuner": "random"}
    return folder


def run(capsys, *arguments):
    """Return exit status, what was printed as JSON, and what was said."""
    status = command(arguments)
    printed = capsys.readouterr()
    return status, json.loads(printed.out) if printed.out else None, printed.err


def test_a_script_asks_and_tells(rig, capsys):
    status, trial, said = run(capsys, "ask", rig)
    assert (status, trial, said) == (0, {"number": 1, "parameters": {"kp": 10.0, "ki": 1.0}}, "")
    status, told, _ = run(capsys, "tell", rig, "1", "--cost", "-1e-3", "--metric", "energy=2")
    assert (status, told["cost"], told["metrics"]) == (0, -1e-3, {"energy": 2.0})
    run(capsys, "ask", rig)
    assert run(capsys, "tell", rig, "2", "--failed", "motor tripped")[1]["state"] == "failed"
    run(capsys, "ask", rig, "--by", "rig 2")
    assert run(capsys, "abandon", rig, "3", "--reason", "power cut")[1]["reason"] == "power cut"
    assert run(capsys, "ask", rig)[1]["number"] == 4
    status, state, _ = run(capsys, "status", rig)
    best = state.pop("best")
    assert state == {"experiments": 5, "asked": 4, "told": 1, "failed": 1, "abandoned": 1,
                     "pending": [4], "finished": False}  # fmt: skip
    assert run(capsys, "best", rig)[1] == best == told
    file = f"{rig}/gains.json"
    assert run(capsys, "export", rig, file)[1] == {"file": file}
    assert json.loads(Path(file).read_text()) == {"kp": 10.0, "ki": 1.0}


def test_exit_statuses_tell_waiting_from_the_end_and_from_errors(rig, capsys):
    run(capsys, "ask", rig)
    run(capsys, "ask", rig)
    status, printed, said = run(capsys, "ask", rig)
    assert (status, printed) == (3, None)
    assert "depends on trial(s) 1, 2" in said
    for number in range(1, 6):
        run(capsys, "tell", rig, str(number), "--cost", "1")
        run(capsys, "ask", rig)
    status, printed, said = run(capsys, "ask", rig)
    assert (status, printed) == (4, None)
    assert "all 5 experiments" in said
    for arguments, says in (
        (("tell", rig, "9", "--cost", "1"), "there is no trial 9"),
        (("tell", rig, "1", "--cost", "nan"), "the cost is nan"),
        (("tell", rig, "1", "--cost", "1", "--metric", "energy"), "expected name=number"),
        (("tell", rig, "1", "--cost", "2"), "has a result already"),
        (("ask", rig + "x"), "there is no study in"),
        (("create", rig, "--space", "space.yaml"), "holds a study or run already"),
        (("create", rig + "x", "--space", "absent.yaml"), "absent.yaml: No such file"),
        (("export", rig, "gains.txt"), "known: .h, .json"),
    ):
        status, printed, said = run(capsys, *arguments)
        assert (status, printed) == (1, None)
        assert said.startswith("error: ")
        assert says in said
    assert "needs a cost, a trace or the reason" in run(capsys, "tell", rig, "1")[2]
    with pytest.raises(SystemExit) as usage:
        command(["tell", rig])
    assert usage.value.code == 2


def test_a_program_carries_the_study_out(rig, capsys):
    code = "import json, sys; print(json.dumps({'cost': json.load(sys.stdin)['kp']}))"
    status, best, _ = run(capsys, "run", rig, "--timeout", "30", "--", sys.executable, "-c", code)
    assert status == 0
    assert best["cost"] == best["parameters"]["kp"] <= 10.0
    assert Study(folder=rig).finished


def test_two_programs_do_not_run_the_same_experiments(rig, capsys):
    with locked(Path(rig) / CARRIED_OUT):
        status, _, said = run(capsys, "run", rig, "--", sys.executable, "-c", "print(1)")
    assert (status, said) == (1, f"error: {rig}: another process carries out this study\n")
    assert Study(folder=rig).trials == []


def test_a_person_is_asked_for_the_cost(rig, monkeypatch, capsys):
    typed = iter(
        ["repeat", "baseline", "much", "12 5", "nan", "3.4", "failed motor tripped", "", "stop"]
    )
    monkeypatch.setattr("builtins.input", lambda prompt: next(typed))
    assert command(["interactive", rig]) == 0
    shown = capsys.readouterr().out
    assert shown.count("experiment 1 of 5\n  kp  10 N/m\n  ki  1\n") == 2
    assert "baseline values:\n  kp  10 N/m\n  ki  1\n" in shown
    assert "'much' is no number" in shown
    assert "'12 5' is no number" in shown
    assert "the cost is nan, expected a finite number" in shown
    assert "best so far: experiment 1, cost 3.4\n  kp  10 N/m" in shown
    study = Study(folder=rig)
    assert [(t.state, t.cost, t.reason) for t in study.trials] == [
        ("told", 3.4, None), ("failed", None, "motor tripped"), ("pending", None, None)
    ]  # fmt: skip

    def leave(prompt):
        raise EOFError

    monkeypatch.setattr("builtins.input", leave)
    assert command(["interactive", rig]) == 0
    assert "experiment 3 of 5" in capsys.readouterr().out
    assert study.pending[0].number == 3


def test_the_module_is_a_command(tmp_path):
    done = commands.run("-m", "zoac.study", "status", tmp_path, cwd=ROOT)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("error: ")
    assert "Traceback" not in done.stderr
