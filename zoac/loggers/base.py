"""What takes a run's rows beside its folder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol


class Logger(Protocol):
    """Where rows go beside the run folder.

    A logger may also have `resume(rows)`, which takes the rows that a run has already when the run
    goes on after an interruption.
    """

    def start(self, run: Mapping[str, Any]) -> None:
        """Take the content of `run.json`."""
        ...

    def row(self, row: Mapping[str, Any]) -> None:
        """Take one row of `metrics.jsonl`."""
        ...

    def finish(self, result: Mapping[str, Any]) -> None:
        """Take the content of `result.json`."""
        ...
