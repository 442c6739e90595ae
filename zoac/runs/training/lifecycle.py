"""One run from its configuration to its result: folder, lock, signals, trainer."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import KW_ONLY, asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from zoac.config import factory
from zoac.config.auto_tuner import Choice, settled
from zoac.config.files import AUTO
from zoac.core.errors import CallbackError, Interrupted, RunFolderError
from zoac.core.tuner import Tuner
from zoac.rollout.horizon import horizon_of
from zoac.rollout.task import Task
from zoac.runs import provenance, schema
from zoac.runs.log import RunLog
from zoac.runs.loggers.base import Logger
from zoac.runs.loggers.callback import Callbacks
from zoac.runs.loggers.console import Console, say
from zoac.runs.training import lifeline, run_folder
from zoac.runs.training.identity import with_code
from zoac.runs.training.trainer import Trainer


@dataclass
class Run:
    """Everything that one run is made of.

    Args:
        config: Resolved configuration; its node `task` is already made into `task`.
        task: What is tuned.
        identity: `task`, `tuner` and `seed`, for run folder and tables.
        command: What was typed, for the record.
        loggers: Where rows go beside the run folder.
        chosen: What "auto" stands for, and why, if the tuner was left open.
        quiet: Do not say that the run is done already.
        callbacks: Those of the caller.

    Raises:
        ConfigError: If the configuration cannot be used.
    """

    config: Mapping[str, Any]
    task: Task
    _: KW_ONLY
    identity: Mapping[str, Any]
    command: Sequence[str]
    loggers: Sequence[Logger]
    chosen: Choice | None = None
    quiet: bool = False
    callbacks: Callbacks | None = None

    def __post_init__(self) -> None:
        self.settings = factory.build_settings(self.config)
        self.config, self.doubts = with_code(self.config, self.task)
        self.executor = factory.build_executor(self.config)

    @cached_property
    def tuner(self) -> Tuner:
        """Built when it is first used: a run that is done already does without it, and torch."""
        return factory.build_tuner(self.config["tuner"], self.task, self.settings)


def run_session(
    config: Mapping[str, Any],
    task: str,
    tuner: str,
    command: Sequence[str],
    fidelity: str = "paper",
) -> dict[str, Any]:
    """Tune as configured, or go on with or return what is there; return `result.json`'s content.

    Args:
        config: Resolved configuration.
        task: Name for the run's identity; likewise `tuner`.
        command: What was typed, for the record.
        fidelity: Name of that choice, for the options of a tuner that is yet to be chosen.

    Raises:
        ConfigError: If the configuration cannot be used.
        RunFolderError: If the folder holds another run, is damaged or in use.
    """
    the_task = factory.build_task(config)
    config, chosen = settled(config, the_task, {"task": task, "tuner": tuner, "fidelity": fidelity})
    folder = run_folder.of(config, task, tuner)
    brief = lifeline.shares_terminal()
    live = lifeline.is_sweep() or not brief
    run = Run(
        config,
        the_task,
        identity={"task": task, "tuner": tuner, "seed": config["seed"]},
        command=command,
        loggers=[
            *factory.build_loggers(config),
            Console(config["budget"], folder, brief=brief, live=live),
        ],
        chosen=chosen,
        quiet=brief,
    )
    return execute(run, folder)


def execute(run: Run, folder: Path, again: str = "the same command") -> dict[str, Any]:
    """Carry out `run` in `folder`, by the `resume` of its config; return `result.json`'s content.

    Args:
        run: What it is made of.
        folder: Its run folder.
        again: What goes on with the run after it was stopped, in words.

    Raises:
        RunFolderError: If the folder holds another run, is damaged or in use.
        ConfigError: If the tuner cannot be built.
        Interrupted: If a signal stopped the run; its checkpoint is written.
        CallbackError: If a callback raises; likewise.
    """
    if run.config["resume"] == "overwrite" or not schema.is_done(folder):
        _ = run.tuner  # whose errors come before any folder is made or emptied
    run_folder.make(folder)
    with run_folder.held(folder):
        if run_folder.prepare(folder, run.config):
            if run.doubts:
                raise RunFolderError(
                    f"{folder} holds a result, and whether it is of the same run cannot be told: "
                    f"{'; '.join(run.doubts)}. Load it with zoac.load_result, choose another "
                    "folder, or start anew with resume=overwrite"
                )
            if not run.quiet:
                print(f"{folder}: done already; resume=overwrite starts anew")
            return schema.read_result(folder)
        if run.doubts:
            print(
                f"{folder}: {'; '.join(run.doubts)}. So nobody can tell later whether another run "
                "is this one, and its result is not returned for a second call",
                file=sys.stderr,
            )
        record = _run_record(run)
        _tell_what_differs(folder, record)
        log = RunLog(folder, record, run.loggers)
        _tell_remarks(run.task)
        run.executor.tell = (lambda _: None) if run.quiet else say
        try:
            run.executor.start(run.task, run.settings.num_envs, run.settings.seed)
            # A caller's `np.seterr(all="raise")` is not for what zoac computes.
            with _stop_on_signal() as stop, np.errstate(all="warn", under="ignore"):
                return Trainer(
                    run.task, run.tuner, run.executor, run.settings, log, stop, run.callbacks
                ).run()
        except Interrupted as stopped:
            by = "" if run.config["resume"] == "auto" else ", with resume=auto,"
            message = f"{stopped}; {again}{by} goes on from {folder}"
            raise Interrupted(message, stopped.record) from None
        except CallbackError as error:
            more = f"once that is mended, {again} goes on from {folder}"
            if schema.is_done(folder):
                more = f"the result is written, in {folder}"
            raise CallbackError(f"{error}; {more}") from error.__cause__
        finally:
            run.executor.close()
            log.close()


def _tell_remarks(task: Task) -> None:
    env = task.make_env(1)
    env.close()
    for remark in env.remarks:
        print(remark, file=sys.stderr)


def _tell_what_differs(folder: Path, record: Mapping[str, Any]) -> None:
    """Say that a run goes on with other code or on another processor, which may round otherwise."""
    if not (folder / schema.CHECKPOINTS).exists():
        return
    changed = provenance.differences(schema.read_run(folder), record)
    if changed:
        print(
            "this run continues under other conditions than it began, so its numbers may differ: "
            + "; ".join(changed),
            file=sys.stderr,
        )


@contextmanager
def _stop_on_signal() -> Iterator[Any]:
    """Yield a function that tells whether to stop: the first signal asks, a second one insists.

    The end of the sweep that this run belongs to asks, too.
    """
    asked = False

    def ask(number: int, frame: Any) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        print("\nstopping after this iteration; once more stops at once", file=sys.stderr)

    try:
        earlier = {s: signal.signal(s, ask) for s in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:  # not the main thread: signals belong to somebody else
        earlier = {}
    try:
        yield lambda: asked or lifeline.is_cut()
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)


def _run_record(run: Run) -> dict[str, Any]:
    """Return the content of `run.json`."""
    task = run.task
    units = {name: signal.unit for name, signal in task.signals.items()}
    signals = {"signals": {"sample_time": task.sample_time, "units": units}} if units else {}
    return {
        "format": schema.FORMAT,
        **run.identity,
        "tuner_name": run.tuner.display_name or run.identity["tuner"],
        "variant": run.config["variant"],
        "config": dict(run.config),
        "config_hash": schema.config_hash(run.config),
        "command": list(run.command),
        "objective": task.objective,
        "episodes": horizon_of(task).remark,
        "tuner_choices": {
            **({AUTO: str(run.chosen)} if run.chosen else {}),
            **run.tuner.describe(),
            **factory.baseline_use(run.config["tuner"], task, run.settings),
        },
        "parameters": [asdict(p) for p in task.space.parameters],
        "fixed": dict(task.fixed),
        **signals,
        "nominal": None if task.baseline is None else dict(task.baseline),
        **provenance.here_and_now(),
    }
