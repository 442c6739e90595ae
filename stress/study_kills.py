"""Kill the processes of a study at random instants: `python -m stress.study_kills --kills 1000`.

Four processes carry out one study. Its experiments are an external program, which hangs for 5% of
the parameters and crashes for 10%. Processes are killed (SIGKILL) and started again. A process that
comes back goes on with the experiment it had; in every second study it abandons some of them.

At the end of each study
- every experiment has one result, and the result that its parameters give, or was abandoned;
- every result that a process was told is recorded has been kept;
- a study that nobody disturbs and that is told the same results, in the order of the journal, asks
  for the same parameters, bit for bit, and has the same history and answer;
- without abandoned experiments, so has one whose experiments a single process makes in turn.
POSIX only.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import random
import sys
import tempfile
import time
import zlib
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any

from zoac.core.errors import StudyFinished, TrialsPending
from zoac.study.program import Program, ProgramError, program
from zoac.study.proposals import Proposals
from zoac.study.state.journal import Journal
from zoac.study.state.trial import Trial
from zoac.study.study import Study

SPACE = {"kp": (0.0, 20.0), "ki": (1e-3, 10.0, "log"), "mode": {"choices": ["fast", "slow"]}}
BASELINE = {"kp": 10.0, "ki": 0.1, "mode": "slow"}
PROCESSES = 4
HANGS, CRASHES = 5, 10
"""Percent of the experiments."""

OF_ONE = 125
"""Kills of one study at most: then it comes to its end."""

TIMEOUT = 1.0
"""Seconds after which the program counts as hanging."""

SIMULATOR = """
import json, math, sys, time, zlib
p = json.load(sys.stdin)
fate = zlib.crc32(repr(sorted(p.items())).encode()) % 100
if fate < HANGS:
    time.sleep(20)
if fate < HANGS + CRASHES:
    sys.exit("motor tripped")
slow = p["mode"] == "slow"
print(json.dumps({"cost": (p["kp"] - 3) ** 2 + math.log10(p["ki"]) ** 2 + slow}))
""".replace("HANGS", str(HANGS)).replace("CRASHES", str(CRASHES))


def simulator() -> Program:
    """Return the program that makes the experiments."""
    return program([sys.executable, "-S", "-E", "-c", SIMULATOR], timeout=TIMEOUT)


def expected(parameters: dict[str, Any]) -> float | str:
    """Return the cost of parameters, or a word of the failure's reason."""
    fate = zlib.crc32(repr(sorted(parameters.items())).encode()) % 100
    if fate < HANGS:
        return "did not end"
    if fate < HANGS + CRASHES:
        return "motor tripped"
    slow = parameters["mode"] == "slow"
    return (parameters["kp"] - 3) ** 2 + math.log10(parameters["ki"]) ** 2 + slow


def begin(folder: Path, experiments: int, seed: int) -> Study:
    """Return the study in a folder, begun if there is none."""
    return Study(SPACE, folder, tuner="cmaes", experiments=experiments, seed=seed,
                 baseline=BASELINE, workers=2 * PROCESSES)  # fmt: skip


def result(trial: Trial) -> dict[str, Any]:
    """Make the experiment; return what to tell."""
    try:
        return {"cost": simulator()(trial.parameters)}
    except ProgramError as error:
        return {"failed": str(error)}


def work(folder: Path, name: str, abandons: float, draw: float) -> None:
    """Be one of the processes, until the study is finished."""
    study = Study(folder=folder)
    mine = [trial for trial in study.pending if trial.by == name]
    if mine and draw < abandons:
        note(folder, name, study.abandon(mine.pop(), "its process was killed"))
    while True:
        try:
            trial = mine.pop() if mine else study.ask(by=name, wait=0.5)
        except TrialsPending:
            continue
        except StudyFinished:
            return
        note(folder, name, study.tell(trial, **result(trial)))


def note(folder: Path, name: str, trial: Trial) -> None:
    """Write down a result that the study says it has."""
    told = [trial.number, trial.state, trial.cost, trial.reason]
    with open(folder / f"{name}.notes", "a", encoding="utf-8") as file:
        file.write(json.dumps(told) + "\n")


def launch(folder: Path, index: int, abandons: float, rng: random.Random) -> ForkProcess:
    """Start a process of the study."""
    arguments = (folder, f"process-{index}", abandons, rng.random())
    forked = multiprocessing.get_context("fork").Process(target=work, args=arguments)
    forked.start()
    return forked


def harass(folder: Path, abandons: float, kills: int, rng: random.Random, span: float) -> int:
    """Carry the study out through at most so many kills; return how many there were."""
    running = [launch(folder, i, abandons, rng) for i in range(PROCESSES)]
    done = 0
    while any(process.is_alive() for process in running):
        time.sleep(rng.uniform(0.0, span))
        index = rng.randrange(PROCESSES)
        if done < kills and running[index].is_alive():
            running[index].kill()
            running[index].join()
            done += 1
            running[index] = launch(folder, index, abandons, rng)
        for i, process in enumerate(running):
            if not process.is_alive() and process.exitcode:
                sys.exit(f"{folder}: process {i} ended with {process.exitcode}")
    # Whoever was killed last may have had an experiment that nobody waited for.
    for index in range(PROCESSES):
        launch(folder, index, 0.0, rng).join()
    return done


def check(folder: Path, alone: Path, seed: int) -> None:
    """Exit with a message unless everything that the module's text promises holds.

    Args:
        folder: Of the study that was disturbed.
        alone: Where others may be made.
        seed: Of the study.
    """
    study = Study(folder=folder)
    rows = Journal(folder).news()
    count = study.settings.experiments
    for kinds in (("asked",), ("told", "failed", "abandoned")):
        numbers = [row["number"] for row in rows if row["kind"] in kinds]
        demand(sorted(numbers) == list(range(1, count + 1)), f"{kinds}: {numbers}")
    kept = {t.number: [t.number, t.state, t.cost, t.reason] for t in study.trials}
    for notes in folder.glob("*.notes"):
        for line in notes.read_text(encoding="utf-8").splitlines():
            told = json.loads(line)
            demand(told == kept[told[0]], f"told {told}, kept {kept[told[0]]}")
    for trial in study.trials:
        right = expected(trial.parameters)
        if trial.state != "abandoned":
            fits = right in (trial.reason or "") if isinstance(right, str) else right == trial.cost
            demand(fits, f"{trial}: expected {right}")
    same(study, replayed(begin(alone / "replayed", count, seed), study, rows))
    if not any(trial.state == "abandoned" for trial in study.trials):
        single = begin(alone / "single", count, seed)
        for trial in single:
            right = expected(trial.parameters)
            failed = isinstance(right, str)
            single.tell(trial, **({"failed": study.trial(trial.number).reason} if failed
                                  else {"cost": right}))  # fmt: skip
        same(study, single)


def replayed(quiet: Study, study: Study, rows: list[dict[str, Any]]) -> Study:
    """Tell a study the results of another, in the order in which they came."""
    for row in rows:
        trial = study.trial(row["number"])
        if row["kind"] == "asked":
            quiet.ask(by=trial.by)
        elif row["kind"] == "told":
            quiet.tell(trial.number, trial.cost)
        elif row["kind"] == "failed":
            quiet.tell(trial.number, failed=trial.reason)
        else:
            quiet.abandon(trial.number, trial.reason or "")
    return quiet


def same(study: Study, other: Study) -> None:
    """Exit unless two studies have the same history and the same answer."""
    clocks = ["asked", "ended", "by"]
    demand(study.history.drop(columns=clocks).equals(other.history.drop(columns=clocks)),
           f"{study.folder} and {other.folder} have another history")  # fmt: skip
    demand([t.x for t in study.trials] == [t.x for t in other.trials], "other parameters")
    demand(study.best.number == other.best.number, "another answer")


def demand(holds: bool, what: str) -> None:
    """Exit with a message if something does not hold."""
    if not holds:
        sys.exit(f"FAILED: {what}")


def main() -> None:
    """Harass studies until there were enough kills."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--experiments", type=int, default=150, help="of each study")
    parser.add_argument("--span", type=float, default=0.2, help="seconds between kills, at most")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"
    rng = random.Random(options.seed)
    left, seed = options.kills, options.seed
    with tempfile.TemporaryDirectory() as temporary:
        Proposals(begin(Path(temporary, "imported"), options.experiments, 0).settings)
        while left:
            folder, alone = Path(temporary, f"study-{seed}"), Path(temporary, f"alone-{seed}")
            begin(folder, options.experiments, seed)
            abandons = 0.5 * (seed % 2)
            kills = harass(folder, abandons, min(left, OF_ONE), rng, options.span)
            check(folder, alone, seed)
            states = [trial.state for trial in Study(folder=folder).trials]
            print(f"study {seed}: {kills} kills; {states.count('told')} told, "
                  f"{states.count('failed')} failed, {states.count('abandoned')} abandoned: "
                  "nothing lost, nothing counted twice, same history and answer",
                  flush=True)  # fmt: skip
            left, seed = left - kills, seed + 1


if __name__ == "__main__":
    main()
