"""Kill runs at random instants and compare their results, bit for bit: `python -m stress.kills`.

For every pair of tuner and task, and for each executor, one run is undisturbed and one is killed
(SIGKILL) and launched again many times. One kill in four comes while the run starts, the others
after at least one new checkpoint. The final result and all evaluation rows must be equal to the
last bit, clocks excepted. Runs are forked from this process, which has imported everything, and
worker processes from their run; otherwise imports would take nearly all the time (`--own-workers`
starts workers in the usual way). POSIX only. Experiments of an external program are a study, which
`stress.study_kills` kills.
"""

from __future__ import annotations

import argparse
import importlib
import json
import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from multiprocessing.context import ForkProcess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from zoac.config.compose import compose_config
from zoac.core.measures import CLOCKS
from zoac.rollout.executors import process, worker
from zoac.run import command
from zoac.runs import checkpoint
from zoac.runs.schema import is_done, read_metrics, read_result

CONF = Path(__file__).resolve().parents[1] / "conf"
EXECUTORS = {"serial": [], "process": ["executor.workers=2"]}
COMMON = [
    "budget=3000", "eval_every=600", "evaluation.episodes=2", "evaluation.final_episodes=2",
    "checkpoint_seconds=0", "num_envs=2", "task.max_episode_steps=40", "mpc_solver=riccati",
    "variant=kills",
]  # fmt: skip
LEFT_OUT = {"task": {"program"}, "tuner": {"nominal"}}
"""A study, and a tuner that asks for nothing."""

# Short iterations: a kill is worth more where there is a checkpoint between any two.
SHORT = {
    "zoac": ["tuner.exploration.segment_length=10", "tuner.exploration.segments=4"],
    "zoac_plus": ["tuner.exploration.segment_length=10", "tuner.halving_rounds=3"],
    "es": ["tuner.population=2"],
}


def choices(group: str) -> list[str]:
    """Return the tasks or tuners that are killed, by the names of their files."""
    return sorted({path.stem for path in (CONF / group).glob("*.yaml")} - LEFT_OUT[group])


def overrides(task: str, tuner: str) -> list[str]:
    """Return what makes a short run of a pair, whatever its executor."""
    return [f"task={task}", f"tuner={tuner}", *COMMON, *SHORT.get(tuner, [])]


def without_clocks(content: Any) -> str:
    """Return content as text, without what depends on the clock."""
    return json.dumps({k: v for k, v in content.items() if k not in CLOCKS}, sort_keys=True)


def outcome(folder: Path) -> list[str]:
    """Return everything that must be the same: the result and all evaluation rows."""
    rows = [row for row in read_metrics(folder) if row["kind"] == "eval"]
    return [without_clocks(read_result(folder)), *map(without_clocks, rows)]


class ForkedWorker:
    """What `zoac.rollout.executors.process` needs of a worker: here forked from this process."""

    def __init__(self, *_arguments: Any, **_options: Any) -> None:
        requests, to_worker = os.pipe()
        from_worker, replies = os.pipe()
        self._pid = os.fork()
        if self._pid == 0:
            # As after an exec: else workers would keep each other's pipes, and the run's lock.
            first, second = sorted((requests, replies))
            os.closerange(3, first)
            os.closerange(first + 1, second)
            os.closerange(second + 1, 1024)
            sys.stdin, sys.stdout = os.fdopen(requests), os.fdopen(replies, "w")
            worker.main()
            os._exit(0)
        os.close(requests)
        os.close(replies)
        self.stdin, self.stdout = os.fdopen(to_worker, "wb"), os.fdopen(from_worker, "rb")
        self._status: int | None = None

    def kill(self) -> None:
        """End it."""
        os.kill(self._pid, signal.SIGKILL)

    def wait(self) -> int:
        """Return its exit status."""
        if self._status is None:
            self._status = os.waitstatus_to_exitcode(os.waitpid(self._pid, 0)[1])
        return self._status


def launch(arguments: list[str], folder: Path) -> ForkProcess:
    """Start one run in `folder`, its output in a file there."""
    folder.mkdir(exist_ok=True)
    forked = multiprocessing.get_context("fork").Process(target=_run, args=(arguments, folder))
    forked.start()
    return forked


def _run(arguments: list[str], folder: Path) -> None:
    output = os.open(folder / "output", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    sys.argv = ["zoac.run", *arguments, f"runs_dir={folder}"]
    try:
        command.main()
    except BaseException as error:
        if isinstance(error, SystemExit) and not error.code:
            return
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)


def finish(launched: ForkProcess, folder: Path, what: str) -> None:
    """Wait for a run; exit with its output if it failed."""
    launched.join()
    if launched.exitcode != 0:
        sys.exit(f"{what}: exit status {launched.exitcode}\n{(folder / 'output').read_text()}")


def stamp(folder: Path) -> int:
    """Return when the newest checkpoint was written; 0 if there is none."""
    try:
        return (folder / "checkpoint" / checkpoint.CURRENT).stat().st_mtime_ns
    except FileNotFoundError:
        return 0


@dataclass
class Tally:
    """How often a run was killed, and how often after it had continued from a checkpoint."""

    kills: int = 0
    under_way: int = 0


def harass(arguments: list[str], runs: Path, inside: Path, tally: Tally, kills: int,
           rng: random.Random, spans: tuple[float, float]) -> None:  # fmt: skip
    """Run to the end through kills, until the tally holds `kills`.

    Args:
        arguments: Of the run.
        runs: Its runs_dir.
        inside: Its folder in there.
        tally: Counted on.
        kills: At most.
        rng: Draws the instants.
        spans: Seconds within which a starting run is killed, and one that has gone on.
    """
    while not is_done(runs / inside):
        before = stamp(runs / inside)
        launched = launch(arguments, runs)
        if tally.kills == kills:
            finish(launched, runs, f"{inside} after {kills} kills")
            break
        if rng.random() < 0.25:
            launched.join(rng.uniform(0.0, spans[0]))
        else:
            while stamp(runs / inside) == before and launched.is_alive():
                time.sleep(0.001)
            launched.join(rng.uniform(0.0, spans[1]))
        if not launched.is_alive():
            finish(launched, runs, f"{inside} after {tally.kills} kills")
            break
        launched.kill()
        launched.join()
        tally.kills += 1
        tally.under_way += stamp(runs / inside) != before


def one_pair(
    task: str, tuner: str, executor: str, kills: int, rng: random.Random, keep: Path | None
) -> Tally:
    """Return how often the run of this pair was killed; exits if the outcome differs."""
    arguments = [*overrides(task, tuner), f"executor={executor}", *EXECUTORS[executor]]
    inside = Path(task, tuner, "seed=0", "variant=kills")
    with tempfile.TemporaryDirectory() as temporary:
        whole, parts = Path(temporary, "whole"), Path(temporary, "parts")
        begun = time.monotonic()
        finish(launch(arguments, whole), whole, f"{task} {tuner}")
        running = read_result(whole / inside)["wall_seconds"]
        startup = time.monotonic() - begun - running
        tally = Tally()
        while tally.kills < kills:  # a run that was done sooner is harassed once more
            harass(arguments, parts, inside, tally, kills, rng, (startup, running / kills))
            if outcome(parts / inside) != outcome(whole / inside):
                if keep is not None:
                    shutil.copytree(temporary, keep, dirs_exist_ok=True)
                sys.exit(f"{task} {tuner} {executor}: other bits after {tally.kills} kills")
            shutil.rmtree(parts)
    return tally


def main() -> None:
    """Run all pairs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=30, help="kills of each pair")
    parser.add_argument("--tasks", nargs="*", default=choices("task"))
    parser.add_argument("--tuners", nargs="*", default=choices("tuner"))
    parser.add_argument("--executors", nargs="*", default=list(EXECUTORS))
    parser.add_argument("--own-workers", action="store_true", help="start workers as ever")
    parser.add_argument("--keep", type=Path, help="where the folders of a difference go")
    options = parser.parse_args()
    if not options.own_workers:
        vars(process)["guard"] = SimpleNamespace(started=ForkedWorker, kill=ForkedWorker.kill)
    importlib.import_module("zoac.runs.training.lifecycle")
    for group, names in (("task", options.tasks), ("tuner", options.tuners)):
        for name in names:
            target = compose_config([f"{group}={name}"])[group]["_target_"]
            importlib.import_module(target.rpartition(".")[0])
    rng = random.Random(0)
    for executor in options.executors:
        for task in options.tasks:
            for tuner in options.tuners:
                tally = one_pair(task, tuner, executor, options.kills, rng, options.keep)
                print(f"{task:17} {tuner:10} {executor:8} {tally.kills} kills, "
                      f"{tally.under_way} of them under way: same bits", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
