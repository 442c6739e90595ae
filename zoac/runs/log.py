"""Where a run's rows go: files always, the console, and loggers such as wandb.

The run folder is the truth. A logger that fails is dropped with one warning; the run goes on.
"""

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from zoac.core.errors import RunFolderError
from zoac.runs import checkpoint, responses, schema
from zoac.runs.loggers.base import Logger
from zoac.specs.signals import Episode


class RunLog:
    """Writer of one run folder, which also passes every row on to the loggers.

    Where the system refuses to write, each method raises `RunFolderError`; what was written before
    is then untouched.
    """

    def __init__(
        self, folder: Path, run: Mapping[str, Any], loggers: Sequence[Logger] = ()
    ) -> None:
        """
        Args:
            folder: The run folder; exists and is locked by the caller.
            run: Content of `run.json`; written if the folder has none.
        """
        self.folder = folder
        self.run = run
        self._loggers = list(loggers)
        with _writing(folder / schema.RUN):
            if not (folder / schema.RUN).exists():
                schema.write_json(folder / schema.RUN, run)
        with _writing(folder / schema.METRICS):
            # Unbuffered: after a write that failed nothing is left to be written at the close.
            self._file = open(folder / schema.METRICS, "ab", buffering=0)  # noqa: SIM115
        self._forward("start", run)

    def row(
        self, kind: str, stamp: Mapping[str, Any], numbers: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Append one row and pass it on; return it as it will be read."""
        row = {"kind": kind, **stamp, **numbers}
        line = schema.json_line(row)
        left = memoryview(line.encode())
        with _writing(self.folder / schema.METRICS):
            while left:
                left = left[self._file.write(left) :]
        self._forward("row", row)
        return schema.read_row(line)

    def responses(self, episodes: Mapping[str, Episode]) -> None:
        """Write `responses.csv`; see `zoac.runs.responses.content`."""
        with _writing(self.folder / schema.RESPONSES):
            schema.write_atomically(self.folder / schema.RESPONSES, responses.content(episodes))

    def finish(self, numbers: Mapping[str, Any]) -> dict[str, Any]:
        """Write `result.json`, which marks the run as done; return its content."""
        identity = {k: self.run[k] for k in ("format", "task", "tuner", "seed", "variant")}
        result = {**identity, **numbers, "config_hash": self.run["config_hash"]}
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
        if size:
            self._forward("resume", self.rows(), optional=True)

    def save_checkpoint(self, state: Any) -> None:
        """Write a checkpoint of this run; rows so far are on the disk before it is."""
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

    def _forward(self, verb: str, content: Any, optional: bool = False) -> None:
        """Call a method of every logger, or of those that have it."""
        for logger in [x for x in self._loggers if hasattr(x, verb) or not optional]:
            try:
                getattr(logger, verb)(content)
            except Exception as error:  # a logger must not end a run, whatever it raises
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
            "is mended, the run goes on from its last checkpoint when it is started again there"
        ) from error
