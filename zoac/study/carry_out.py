"""Carry out a study with a function: `zoac.tune(cost=...)`."""

from __future__ import annotations

import inspect
import math
import shlex
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from pathlib import Path
from typing import Any

from zoac.core import errors
from zoac.core.errors import ConfigError, Interrupted, as_text, suggest
from zoac.runs.lock import locked
from zoac.runs.loggers.summary import acceptance_line, shown
from zoac.runs.result import Result, result_of
from zoac.runs.schema import read_result
from zoac.study.loop import CARRIED_OUT
from zoac.study.program import Program, ProgramError
from zoac.study.state import folder as files
from zoac.study.state.ledger import told
from zoac.study.state.trial import Trial, measured
from zoac.study.study import Study

Cost = Callable[[dict[str, Any]], Any]

OPTIONS = (
    "space", "experiments", "tuner", "seed", "workers", "baseline", "constraints",
    "acceptance_test", "initial_sigma", "initial_samples", "tuner_options", "folder", "quiet",
)  # fmt: skip
"""Options of `zoac.tune` beside `cost`."""


def tune_cost(
    cost: Cost, *, folder: str | Path | None = None, quiet: bool = False, **options: Any
) -> Result:
    """Tune by experiments that a function makes; see `zoac.tune`.

    Args:
        cost: Returns the cost of parameters, or a mapping; see `Study.tell`.
        folder: Of the study; the same call goes on with it. None: a temporary one.
        quiet: Print nothing.
        options: Of `Study`.

    Raises:
        Interrupted: If Ctrl-C stopped it. What was measured is kept.
        StudyError: If each of fewer than ten experiments failed.
        RunFolderError: If another process carries out the study of that folder.
    """
    if not callable(cost):
        raise ConfigError(f"cost={cost!r}: expected a function of the parameters, or zoac.program")
    study = Study(folder=folder, **options)
    where = study.folder
    again = "the same call" if folder else f"the same call with folder={str(where)!r}"
    try:
        carry_out(study, cost, quiet=quiet)
    except KeyboardInterrupt:
        raise _interrupted(study, again) from None
    best = study.best  # says that none has succeeded
    if not quiet:
        print("\n".join(_told(study, best)), flush=True)
    return result_of(read_result(where), study.settings.fixed, where, None)


def _told(study: Study, best: Trial) -> Iterator[str]:
    """Yield the last lines of a study for the console."""
    units = {p.name: p.unit for p in study.settings.space.parameters}
    for name, value in best.parameters.items():
        yield f"  {name} = {shown(value)} {units.get(name, '')}".rstrip()
    result = read_result(study.folder)
    compared = ""
    if study.settings.baseline_first:
        cost = result["baseline_cost_mean"]
        known = f"cost {cost:.6g}" if math.isfinite(cost) else told(study.trial(1))
        compared = f"; baseline values: {known}"
    yield f"  {told(best)}, experiment {best.number} of {study.settings.experiments}{compared}"
    if (test := result.get("acceptance_test")) is not None:
        yield f"  {acceptance_line(test)}"
    if result["failures"]:
        yield f"  failures: {result['failures']}, the first: {_line(result['first_failure'])}"
    yield from (f"  WARNING: {sentence}" for sentence in result["warnings"])
    folder = shlex.quote(str(study.folder))
    yield f"  study folder: {folder}"
    yield f"  report: python -m zoac.analysis.report {folder}"


def _line(text: str) -> str:
    """Return the first and the last line of a text as one: a program's last words tell most."""
    first, *others = text.splitlines() or ["no reason given"]
    return f"{first.removesuffix(': its last lines')}: {others[-1].strip()}" if others else first


def carry_out(study: Study, cost: Cost, *, quiet: bool = True) -> None:
    """Run all experiments that are left, those of a process that was killed first.

    Args:
        study: What is carried out; each of its workers is a thread.
        cost: As for `tune_cost`.
        quiet: Print nothing.

    Raises:
        NothingWorksError: If each of the first ten experiments failed.
        RunFolderError: If another process carries out the study.
    """
    workers, total = study.settings.workers, study.settings.experiments
    stopped = threading.Event()

    def work() -> None:
        while not stopped.is_set():
            try:
                trial = next(left, None) or study.ask(wait=0.2)
            except errors.TrialsPending:
                continue
            except errors.StudyFinished:
                return
            result = _result(study, cost, trial)
            if stopped.is_set():
                return
            ended = study.tell(trial, **result)
            if not quiet:
                print(f"experiment {ended.number} of {total}: {_line(told(ended))}", flush=True)

    with locked(study.folder / CARRIED_OUT, held="another process carries out this study"):
        left = iter(study.pending)
        if workers == 1:
            work()
            return
        with ThreadPoolExecutor(workers) as pool:
            try:
                for future in as_completed([pool.submit(work) for _ in range(workers)]):
                    future.result()
            finally:
                stopped.set()
                if isinstance(cost, Program):
                    cost.stop()


def _result(study: Study, cost: Cost, trial: Trial) -> dict[str, Any]:
    """Return what to tell of a trial, as arguments of `Study.tell`."""
    try:
        answer = cost(dict(trial.parameters))
        measured(answer, study.settings.limits)
    except (ProgramError, ConfigError) as error:
        return {"failed": str(error)}
    except Exception as error:  # whatever a user's function raises
        return {"failed": as_text(error)}
    return {"cost": answer}


def _interrupted(study: Study, again: str) -> Interrupted:
    """Return the error that holds what is known so far."""
    trials, total = study.trials, study.settings.experiments
    ended = sum(not trial.pending for trial in trials)
    stopped = Interrupted(f"stopped after {ended} of {total} experiments; {again} goes on")
    with suppress(errors.StudyError):
        record = files.result(study.settings, trials, study.best)
        record |= {"finished": False, "warnings": [*record["warnings"], "stopped early"]}
        stopped.record = record
        stopped.result = result_of(record, study.settings.fixed, study.folder, None)
    print(stopped, file=sys.stderr)
    return stopped


def from_tune(given: Mapping[str, Any], defaults: Mapping[str, inspect.Parameter]) -> Result:
    """Return `tune_cost` with the arguments of `zoac.tune`; refuse those that it has no use for.

    Args:
        given: All arguments by name.
        defaults: The parameters of `zoac.tune`.
    """
    settings = given["settings"]
    given = {**given, **settings}
    for name, value in given.items():
        if name in (*OPTIONS, "cost", "settings"):
            continue
        if name in settings or value is not defaults[name].default:
            raise ConfigError(
                f"zoac.tune(cost=...) has no option {name!r}: an experiment is one call of the "
                f"function; {suggest(name, OPTIONS)}"
            )
    if given["space"] is None:
        raise ConfigError("zoac.tune(cost=...) needs a space, such as {'kp': (0, 5)}")
    chosen = {name: given[name] for name in OPTIONS if given.get(name) is not None}
    chosen["constraints"] = given["constraints"] or None
    return tune_cost(given["cost"], **chosen)
