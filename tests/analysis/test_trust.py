"""A run folder of somebody else runs nothing here, whichever command reads it, unless asked for."""

import json
import pickle
import sys
from importlib import import_module
from pathlib import Path

import pytest

import zoac
from tests.analysis.folders import NOMINAL, PID, write_run
from tests.support import Traps
from zoac.config.compose import compose_config, resolved
from zoac.core.errors import RunFolderError
from zoac.runs.foreign_code import foreign_code
from zoac.runs.result import task_of_run

ROOT = Path(__file__).parents[2]
COMMANDS = sorted(p.stem for p in (ROOT / "analysis").glob("*.py") if "def main(" in p.read_text())
REPLAYING = {"landscape", "report", "robustness", "trajectories"}
MODULE = """
from pathlib import Path
from zoac.tasks.pid_acc import PidAcc

Path({trace!r}).touch()

class Task(PidAcc):
    pass
"""


@pytest.fixture
def trace(tmp_path, monkeypatch):
    """The file that a trap leaves behind; `trap` is a module that does so when it is imported."""
    found = tmp_path / "trace"
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "trap.py").write_text(MODULE.format(trace=str(found)))
    monkeypatch.syspath_prepend(str(tmp_path / "modules"))
    yield found
    sys.modules.pop("trap", None)


def kinds(trace):
    """Return configurations of a task that would leave the trace."""
    user = {
        "_target_": "zoac.tasks.user_task.user_task",
        "env": "CartPole-v1",
        "space": {"k": [0, 1]},
    }
    inner = {"_target_": "trap.Task"}
    return {
        "pickle": {"space": [], "fixed": {}},
        "module": inner,
        "callable": {"_target_": "os.system", "command": f"touch {trace}"},
        "callable seen from zoac": {
            "_target_": "zoac.runs.training.lifecycle.os.system",
            "command": "true",
        },
        "function of zoac": {"_target_": "zoac.runs.schema.write_atomically", "path": str(trace)},
        "maker of zoac": {"_target_": "zoac.run.api.make_task", "name": "trap"},
        "solver": {"_target_": "zoac.tasks.mpc_tracking.MpcTracking", "solver": inner},
        "in a list": {**PID, "more": [inner]},
        "env": {**user, "env": "trap.Env", "controller": "zoac.tasks.pid_acc.PidAcc"},
        "env's module": {**user, "env": "trap:CartPole-v1", "controller": "trap.act"},
        "controller": {**user, "controller": "trap.act"},
        "constraint": {**user, "controller": "trap.act", "constraints": {"x": "trap.x"}},
    }


@pytest.fixture(params=kinds(Path()))
def foreign(request, tmp_path, trace):
    """Runs that are traps: in the configuration, in the kept task, in the checkpoint."""
    root = tmp_path / "runs"
    task = kinds(trace)[request.param]
    for tuner, seed in (("zoac", 0), ("zoac", 1), ("random", 0), ("nominal", 0)):
        gains = NOMINAL if tuner == "nominal" else None
        costs = (7.0, 8.0) if tuner == "random" else (3.0, 4.0)
        config = {"task": task, "experiments": 10}
        folder = write_run(root, tuner, seed, gains=gains, costs=costs, config=config)
        (folder / "task.pkl").write_bytes(pickle.dumps(Traps(trace)))
        (folder / "checkpoint").mkdir()
        (folder / "checkpoint" / "current.ckpt").write_bytes(pickle.dumps(Traps(trace)))
        run = json.loads((folder / "run.json").read_text())
        (folder / "run.json").write_text(json.dumps({**run, "fixed": {}}))
    return root


@pytest.mark.usefixtures("undrawn")
# A command that replays, by each way to a task; the test of the film below goes through all kinds.
@pytest.mark.parametrize(
    ("command", "foreign"),
    [(name, "module") for name in COMMANDS]
    + [(name, kind) for name in sorted(REPLAYING) for kind in ("pickle", "env")],
    indirect=["foreign"],
)
def test_no_command_runs_what_a_folder_holds_or_names(command, foreign, trace, capsys):
    module = import_module(f"zoac.analysis.{command}")
    options = [] if command in {"compact", "suite"} else ["--task", "pid_acc"]
    options += ["--format", "svg"] if command in {"curves", "suite"} else []
    code = module.main([str(foreign), *options])
    assert not trace.exists()
    assert code == (1 if command in REPLAYING - {"report"} else 0)
    if code:
        assert "--trust-code" in capsys.readouterr().err


def test_the_film_and_load_result_run_nothing_either(foreign, trace):
    film = import_module("zoac.analysis.trajectories")
    assert film.main([str(foreign), "--animate", str(trace.parent / "film.gif")]) == 1
    result = zoac.load_result(foreign / "pid_acc" / "zoac" / "seed=0")
    with pytest.raises(RunFolderError, match="trust_code=True in load_result"):
        result.controller()
    assert result.history["env_steps"].max() == 1000
    assert not trace.exists()


def test_what_would_be_loaded_is_named(tmp_path):
    folder = write_run(tmp_path, config={"task": {**PID, "solver": {"_target_": "trap.Task"}}})
    with pytest.raises(RunFolderError, match=r"not zoac's own \(task.solver._target_: trap.Task\)"):
        task_of_run(folder)


@pytest.mark.parametrize("path", ["zoac.tasks.register", "zoac.tasks.lqr.task.Task", "zoac.tasks"])
def test_only_classes_of_zoacs_own_tasks_and_solvers_need_no_trust_code(path):
    assert foreign_code({"_target_": path}) == [f"task._target_: {path}"]


def test_what_is_trusted_is_loaded(tmp_path, trace):
    folder = write_run(tmp_path, config={"task": {"space": []}})
    (folder / "task.pkl").write_bytes(pickle.dumps(Traps(trace)))
    with pytest.raises(RunFolderError, match="the pickle task.pkl"):
        task_of_run(folder)
    task_of_run(folder, trust_code=True)
    assert trace.exists()


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("command", sorted(REPLAYING))
def test_each_command_that_replays_takes_trust_code(command, tmp_path, trace, monkeypatch):
    write_run(tmp_path / "runs", config={"task": {**PID, "_target_": "trap.Task"}})
    module = import_module(f"zoac.analysis.{command}")
    options = [] if command == "report" else ["--format", "svg"]
    assert module.main([str(tmp_path / "runs"), "--trust-code", *options]) == 0
    assert trace.exists()


def choices(group):
    return sorted(path.stem for path in (ROOT / "conf" / group).glob("*.yaml"))


@pytest.mark.parametrize(
    "override",
    [f"task={name}" for name in choices("task") if name != "program"]
    + [f"mpc_solver={name}" for name in choices("mpc_solver")],
)
def test_no_task_or_solver_of_zoac_needs_trust_code(override):
    config = resolved(compose_config(["task=mpc_tracking", override]))
    assert foreign_code(config["task"]) == []


def test_a_program_is_never_run_unasked():
    config = resolved(compose_config(["task=program", "+task.command=[true]"]))
    assert foreign_code(config["task"]) != []
