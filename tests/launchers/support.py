"""Sweeps as a user types them."""

import json
import time
from pathlib import Path

from tests import commands
from zoac.core.measures import CLOCKS
from zoac.runs.training import lifeline
from zoac.tasks.lqr.task import Lqr, StateFeedback

ROOT = Path(__file__).parents[2]
SMALL = [
    "task=lqr", "tuner=random", "budget=400", "eval_every=400", "evaluation.episodes=2",
    "evaluation.final_episodes=3", "task.max_episode_steps=50", "variant=small",
]  # fmt: skip
WAITING = ["task._target_=tests.launchers.support.WaitingLqr", "checkpoint_seconds=0"]


class Waiting(StateFeedback):
    """Stops in an early iteration until there is the file `go`, or its sweep has ended."""

    calls = 0

    def act(self, params, obs, memory):
        self.calls += 1
        while self.calls > 200 and not (Path.home() / "go").exists() and not lifeline.is_cut():
            time.sleep(0.01)
        return super().act(params, obs, memory)


class WaitingLqr(Lqr):
    """A job of it is still at work when it is told to stop, however few steps it has."""

    def make_controller(self):
        return Waiting()


def environment(home):
    return {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(home)}


def alone(*arguments, cwd):
    """Run a command line in one process to its end; return what `finish` does."""
    done = commands.run("-m", "zoac.run", *arguments, cwd=cwd, env=environment(cwd))
    return done.returncode, done.stdout, done.stderr


def start(*arguments, cwd):
    """Start a command line without waiting, in a session of its own, as a terminal does."""
    words = ["-m", "zoac.run", *arguments]
    return commands.Started(*words, cwd=cwd, env=environment(cwd), session=True)


def finish(process):
    """Return exit code, standard output and standard error."""
    out, err = process.communicate()
    return process.returncode, out, err


def results(runs):
    """Return every `result.json` below a folder without its clocks, by place."""
    return {
        str(path.parent.relative_to(runs)): {
            key: value for key, value in json.loads(path.read_text()).items() if key not in CLOCKS
        }
        for path in sorted(Path(runs).rglob("result.json"))
    }


def all_running(process, runs, jobs):
    """Wait until so many jobs run and have written a checkpoint."""
    while process.poll() is None:
        if len(list(Path(runs).rglob("current.ckpt"))) == jobs:
            return
        time.sleep(0.01)
    raise AssertionError("the sweep has ended")


def running_note(process, runs, job):
    """Wait until a job says that it runs and there is a checkpoint; return its note."""
    while process.poll() is None:
        for path in Path(runs).glob(".sweeps/*/[0-9]*.json"):
            note = json.loads(path.read_text())
            begun = list(Path(runs).rglob("current.ckpt"))
            if job in note["job"] and note["state"] == "running" and begun:
                return note
        time.sleep(0.01)
    raise AssertionError(f"no job {job} has begun")
