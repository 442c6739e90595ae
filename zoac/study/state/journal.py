"""The journal of a study: one JSON object a line, written under a lock and never changed.

The rows, in the order in which they happened:
    asked       number, time, by, parameters, x
    told        number, time, cost, metrics, constraints
    failed      number, time, reason
    abandoned   number, time, reason
A row counts once its line is complete. A process that is killed while it writes leaves at most a
part of a line, which the next writer removes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from zoac.core.errors import RunFolderError
from zoac.core.types import is_number
from zoac.runs.lock import locked
from zoac.runs.schema import JOURNAL, json_line, sync_folder


class Journal:
    """The journal in a folder, read from where the last reading ended."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / JOURNAL
        self._lock = folder / ".lock"
        self._read = 0  # bytes
        self._lines = 0

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Hold the journal's lock, which one process and thread has at a time."""
        try:
            with locked(self._lock, wait=True, poll=0.005):
                yield
        except OSError as error:
            raise RunFolderError(f"cannot write {self.path}: {error.strerror}") from error

    def news(self) -> list[dict[str, Any]]:
        """Return the complete rows that were written since the last call.

        Raises:
            RunFolderError: If a line is damaged or the file is shorter than before.
        """
        if not self.path.exists():
            return []
        with open(self.path, "rb") as file:
            if file.seek(0, os.SEEK_END) < self._read:
                raise RunFolderError(f"{self.path} has become shorter: rows are lost; put it back")
            file.seek(self._read)
            whole, newline, _ = file.read().rpartition(b"\n")
        rows = []
        for line in whole.split(b"\n") if newline else []:
            self._lines += 1
            try:
                row = json.loads(line)
                _check(row)
            except (ValueError, KeyError, TypeError, AttributeError):
                raise RunFolderError(f"{self.path}: line {self._lines} is damaged") from None
            rows.append(row)
        self._read += len(whole) + len(newline)
        return rows

    def append(self, row: dict[str, Any]) -> None:
        """Write a row at the end, and return once it is on the disk; the lock must be held.

        All earlier rows must have been read: what follows them is part of a line.
        """
        is_new = not self.path.exists()
        with open(self.path, "a+b") as file:
            file.seek(self._read)
            if b"\n" in file.read():
                raise RunFolderError(f"{self.path}: another process wrote without the lock")
            file.truncate(self._read)
            file.write(json_line(row).encode())
            file.flush()
            os.fsync(file.fileno())
        if is_new:
            sync_folder(self.path.parent)


def _check(row: dict[str, Any]) -> None:
    """Raise ValueError, KeyError or TypeError if a row has not what its kind has."""
    numbers = [row["number"], row["time"]]
    if row["kind"] == "asked":
        {**row["parameters"]}, row["by"]
        numbers += row["x"]
    elif row["kind"] == "told":
        numbers += [row["cost"], row.get("excess", 0.0)]
        for kind in ("metrics", "constraints", "specs"):
            # Text such as "-inf" stands for what JSON has no number for.
            numbers += [float(v) for v in row.get(kind, {}).values() if v is not None]
    elif row["kind"] not in ("failed", "abandoned"):
        raise ValueError(row["kind"])
    if not all(map(is_number, numbers)):
        raise TypeError(numbers)
