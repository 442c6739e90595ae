"""Sweeps as a user types them."""

import json
import subprocess
import sys
import time
from pathlib import Path

from tests import commands
from zoac.core.measures import CLOCKS

ROOT = Path(__file__).parents[2]
SMALL = [
    "task=lqr", "tuner=random", "budget=400", "eval_every=400", "evaluation.episodes=2",
    "evaluation.final_episodes=3", "task.max_episode_steps=50", "variant=small",
]  # fmt: skip


def environment(home):
    return {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(home)}


def alone(*arguments, cwd):
    """Run a command line in one process to its end; return what `finish` does."""
    done = commands.run("-m", "zoac.run", *arguments, cwd=cwd, env=environment(cwd))
    return done.returncode, done.stdout, done.stderr


def start(*arguments, cwd):
    """Start a command line without waiting, in a session of its own, as a terminal does."""
    return subprocess.Popen(
        [sys.executable, "-m", "zoac.run", *arguments], cwd=cwd, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env=environment(cwd), start_new_session=True,
    )  # fmt: skip


def finish(process):
    """Return exit code, standard output and standard error."""
    out, err = process.communicate(timeout=300)
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


def running_note(process, runs, seed):
    """Wait until the job of a seed says that it runs and there is a checkpoint; return its note."""
    while process.poll() is None:
        for path in Path(runs).glob(".sweeps/*/[0-9]*.json"):
            note = json.loads(path.read_text())
            begun = list(Path(runs).rglob("current.ckpt"))
            if note["seed"] == seed and note["state"] == "running" and begun:
                return note
        time.sleep(0.01)
    raise AssertionError(f"no job of seed {seed} has begun")
