"""The state of a run: what a checkpoint holds, and how a run goes on from one."""

import sys
import textwrap
import time
from collections.abc import Mapping
from typing import Any, Protocol

from zoac.config.settings import Settings
from zoac.core.errors import ZoacError, as_text
from zoac.core.seeding import stream_seed
from zoac.core.state import encode
from zoac.rollout.executors.base import Executor
from zoac.rollout.task import Task
from zoac.runs.checkpoint import check_keys, fitting
from zoac.runs.log import RunLog
from zoac.runs.training.progress import Progress


class Part(Protocol):
    """A part of a run whose state a checkpoint holds."""

    def state(self) -> Any:
        """Return a copy of everything that the part's next steps depend on."""

    def restore(self, state: Any) -> None:
        """Restore what `state` returned."""


class Checkpoints:
    """Writes checkpoints of a run from time to time, and restores the newest."""

    def __init__(
        self, log: RunLog, progress: Progress, parts: Mapping[str, Part], seconds: float
    ) -> None:
        """
        Args:
            parts: By their key in the checkpoint, in the order of restoring, after `progress`.
            seconds: Wall seconds between checkpoints.
        """
        self._log, self._progress, self._seconds = log, progress, seconds
        self._parts: dict[str, Part] = {"progress": progress, **parts}
        self._last = time.perf_counter()

    def save_if_due(self, now: bool = False) -> None:
        """Write a checkpoint if the last one is old enough, or `now`."""
        if now or time.perf_counter() - self._last >= self._seconds:
            with self._progress.timed("checkpoint_seconds"):
                self._progress.log_bytes = self._log.size()
                self._log.save_checkpoint({key: p.state() for key, p in self._parts.items()})
            self._last = time.perf_counter()

    def restore(self) -> None:
        """Go on from the newest checkpoint, if there is one; rows written after it are dropped.

        Raises:
            RunFolderError: If it was written by other versions, or rows are missing.
        """
        state = self._log.load_checkpoint()
        if state is not None:
            check_keys("the checkpoint", state, self._parts)
            for key, part in self._parts.items():
                with fitting(told := f"{NAMES[key]} in the checkpoint"):
                    if key != "num_envs":  # None if the environments could not be saved
                        check_keys(told, state[key], part.state())
                    part.restore(state[key])
        self._log.rewind(self._progress.log_bytes)


NAMES = {
    "progress": "the progress",
    "tuner": "the tuner's state",
    "num_envs": "the environments' state",
    "constraints": "the constraints' state",
    "last_finite": "the last recommendation",
}
"""Keys of a checkpoint -> their names in messages."""


class Environments:
    """The running environments, which begin new episodes where they cannot be saved."""

    def __init__(
        self, task: Task, executor: Executor, settings: Settings, progress: Progress
    ) -> None:
        self._task, self._executor = task, executor
        self._settings, self._progress = settings, progress
        self._unsaved = False  # which was printed

    def state(self) -> Any:
        """Return the environments' state; None, and say so once, if it cannot be saved."""
        if self._unsaved:
            return None
        try:
            state = self._executor.state()
            encode(state)
        except Exception as error:  # whatever a user's environment or controller raises
            self._unsaved = True
            reason = error if isinstance(error, ZoacError) else as_text(error)
            more = ""
            if self._task.restore_fault is not None:
                more = (
                    "Tuners cannot try two parameter vectors from one state. A held-out episode "
                    "ends the episode that the environment was in. "
                )
            told = (
                f"note: the environment or controller cannot be saved ({reason}). {more}"
                "If this run is stopped, it goes on with new episodes, and its numbers are not "
                "those of an unbroken run. env_restarts in result.json counts that."
            )
            print(textwrap.fill(told, 80, break_long_words=False), file=sys.stderr)
            return None
        return state

    def restore(self, state: Any) -> None:
        """Restore what `state` returned; after None, start anew from seeds not used before."""
        if state is not None:
            self._executor.restore(state)
            return
        self._progress.env_restarts += 1
        seed = stream_seed(self._settings.seed, "restart", self._progress.env_restarts)
        self._executor.close()
        self._executor.start(self._task, self._settings.num_envs, seed)
