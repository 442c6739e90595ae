"""Where a run's rows go: files always, the console, and mirrors such as wandb.

The run folder is the truth. A mirror that fails is dropped with one warning; the run goes on.
"""

from __future__ import annotations

import io
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, TextIO

from zoac.core.errors import RunFolderError
from zoac.runs import checkpoint, schema


class Logger(Protocol):
    """A mirror of the run folder."""

    def start(self, run: Mapping[str, Any]) -> None:
        """Take the content of `run.json`."""
        ...

    def row(self, row: Mapping[str, Any]) -> None:
        """Take one row of `metrics.jsonl`."""
        ...

    def finish(self, result: Mapping[str, Any]) -> None:
        """Take the content of `result.json`."""
        ...


class RunLog:
    """Writer of one run folder, which also passes every row on to the mirrors."""

    def __init__(
        self, folder: Path, run: Mapping[str, Any], loggers: Sequence[Logger] = ()
    ) -> None:
        """
        Args:
            folder: The run folder; exists and is locked by the caller.
            run: Content of `run.json`; written if the folder has none.
            sinks: Mirrors.
        """
        self.folder = folder
        self._run = run
        self._loggers = list(loggers)
        with _writing(folder / schema.RUN):
            if not (folder / schema.RUN).exists():
                schema.write_json(folder / schema.RUN, run)
        with _writing(folder / schema.METRICS):
            # Unbuffered: after a write that failed nothing is left to be written at the close.
            self._file = open(folder / schema.METRICS, "ab", buffering=0)  # noqa: SIM115
        self._forward("start", run)

    def row(self, kind: str, stamp: Mapping[str, Any], numbers: Mapping[str, Any]) -> None:
        """Append one row and pass it on.

        Raises:
            RunFolderError: If it cannot be written.
        """
        row = {"kind": kind, **stamp, **numbers}
        line = memoryview(schema.json_line(row).encode())
        with _writing(self.folder / schema.METRICS):
            while line:
                line = line[self._file.write(line) :]
        self._forward("row", row)

    def finish(self, numbers: Mapping[str, Any]) -> dict[str, Any]:
        """Write `result.json`, which marks the run as done; return its content."""
        identity = {k: self._run[k] for k in ("format", "task", "tuner", "seed", "variant")}
        result = {**identity, **numbers, "config_hash": self._run["config_hash"]}
        with _writing(self.folder / schema.RESULT):
            schema.write_json(self.folder / schema.RESULT, result)
        self._forward("finish", result)
        return result

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows so far."""
        return schema.read_metrics(self.folder)

    def size(self) -> int:
        """Return the length of `metrics.jsonl` in bytes."""
        return self._file.tell()

    def rewind(self, size: int) -> None:
        """Cut `metrics.jsonl` back to where a checkpoint saw it: later rows will come again.

        Raises:
            RunFolderError: If it is shorter than that: rows are lost.
        """
        if (found := self.size()) < size:
            raise RunFolderError(
                f"{self.folder / schema.METRICS} holds {found} bytes, its checkpoint was taken at "
                f"{size}: rows are lost. Put the file back, or start anew with resume=overwrite"
            )
        with _writing(self.folder / schema.METRICS):
            self._file.truncate(size)
            self._file.seek(size)

    def save_checkpoint(self, state: Any) -> None:
        """Write a checkpoint of this run; rows so far are on the disk before it is.

        Raises:
            RunFolderError: If it cannot be written; the earlier ones are then untouched.
        """
        with _writing(self.folder / schema.CHECKPOINTS):
            os.fsync(self._file.fileno())
            checkpoint.save(self.folder / schema.CHECKPOINTS, state)

    def load_checkpoint(self) -> Any | None:
        """Return the newest whole checkpoint, or None; complain about damaged ones on stderr."""
        found = checkpoint.load(self.folder / schema.CHECKPOINTS)
        if found is None:
            return None
        state, complaints = found
        for complaint in complaints:
            print(f"{complaint}; going on from the previous checkpoint", file=sys.stderr)
        return state

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _forward(self, verb: str, content: Mapping[str, Any]) -> None:
        for logger in list(self._loggers):
            try:
                getattr(logger, verb)(content)
            except Exception as error:  # a mirror must not end a run, whatever it raises
                self._loggers.remove(logger)
                name = type(logger).__name__
                print(f"{name} failed and is switched off: {error}", file=sys.stderr)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn what the system says against writing `path` into a message for the user."""
    try:
        yield
    except OSError as error:
        raise RunFolderError(
            f"cannot write {path}: {error.strerror}. What was written before is whole; once that "
            "is mended, the same command goes on from the last checkpoint"
        ) from error


class Console:
    """One line per evaluation, and on a terminal a line that moves in between."""

    def __init__(self, budget: int, stream: TextIO | None = None) -> None:
        self._budget = budget
        # There is no standard output in a program without a console.
        self._stream = stream or sys.stdout or io.StringIO()
        self._live = self._stream.isatty()
        self._name = ""
        self._first: tuple[float, int] | None = None
        self._shown = 0.0

    def start(self, run: Mapping[str, Any]) -> None:
        """Print what runs, and the tuner's choices that a comparison must show."""
        variant = f" {run['variant']}" if run["variant"] else ""
        self._name = f"{run['task']} {run['tuner']} seed={run['seed']}{variant}"
        told = f", minimising {run['objective']}" if run.get("objective") else ""
        self._print(f"{self._name}: {self._budget:,} steps{told}")
        if run.get("episodes"):
            self._print(f"  episodes: {run['episodes']}")
        for choice, value in run["tuner_choices"].items():
            self._print(f"  {choice}: {value}")

    def row(self, row: Mapping[str, Any]) -> None:
        """Show progress."""
        if self._first is None:
            self._first = (row["wall_seconds"], row["env_steps"])
        if "first_failure" in row:
            self._print(f"  the first step that failed, priced: {row['first_failure']}")
        if row["kind"] == "eval":
            what = "final" if row["final"] else "evaluation"
            ended = f", {row['terminations']} terminated" if row["terminations"] else ""
            cost = f"{what} cost {row['cost_mean']:.4g}"
            episodes = f"over {len(row['cost_per_episode'])} episodes"
            self._print(f"{self._progress(row)} | {cost} {episodes}{ended}")
        elif self._live and time.monotonic() - self._shown > 0.5:
            self._shown = time.monotonic()
            self._stream.write(f"\r\033[K{self._progress(row)}")
            self._stream.flush()

    def finish(self, result: Mapping[str, Any]) -> None:
        """Print the tuned parameters, how they compare to the baseline values, and warnings."""
        for name, value in result["parameters"].items():
            self._print(f"  {name} = {format(value, '.6g') if isinstance(value, float) else value}")
        if (acceptance_test := result.get("acceptance_test")) is not None:
            verdict = (
                "the answer beats" if acceptance_test["accepted"] else "no better was found, it is"
            )
            pairs = f"{acceptance_test['pairs']} pairs of episodes"
            self._print(
                f"  gate: {verdict} the baseline values, {pairs}: {acceptance_test['text']}"
            )
        if (start := result.get("baseline_cost_mean")) is not None:
            episodes = f"the same {len(result['cost_per_episode'])} episodes"
            self._print(
                f"  cost {result['cost_mean']:.4g}, baseline values {start:.4g} on {episodes}"
            )
        if result.get("failures"):
            self._print(f"  failures: {result['failures']}, the first: {result['first_failure']}")
        for sentence in result["warnings"]:
            self._print(f"  WARNING: {sentence}")

    def _progress(self, row: Mapping[str, Any]) -> str:
        """Return steps, time so far and time left, from the rate since this process began."""
        assert self._first is not None
        wall, steps = row["wall_seconds"], row["env_steps"]
        done = steps - self._first[1]
        text = f"{self._name} | {steps:,}/{self._budget:,} steps | {_clock(wall)}"
        if done > 0 and steps < self._budget:
            left = (wall - self._first[0]) / done * (self._budget - steps)
            text += f", about {_clock(left)} left"
        return text

    def _print(self, text: str) -> None:
        clear = "\r\033[K" if self._live else ""
        encoding = getattr(self._stream, "encoding", None) or "utf-8"
        known = text.encode(encoding, errors="backslashreplace").decode(encoding)
        print(f"{clear}{known}", file=self._stream, flush=True)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
