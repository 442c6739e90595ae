"""What takes a run's rows beside its folder, and its numbers by flat names."""

from collections.abc import Mapping
from typing import Any, Protocol

from zoac.core.types import is_number


class Logger(Protocol):
    """Where rows go beside the run folder.

    A logger may also have `resume(rows)`, which takes the rows that a run has already when the run
    goes on after an interruption.
    """

    def start(self, run: Mapping[str, Any]) -> None:
        """Take the content of `run.json`."""

    def row(self, row: Mapping[str, Any]) -> None:
        """Take one row of `metrics.jsonl`."""

    def finish(self, result: Mapping[str, Any]) -> None:
        """Take the content of `result.json`."""


def numbers(row: Mapping[str, Any]) -> dict[str, float]:
    """Return what is a number in `row`; of a mapping inside, `name/key`; lists are left out."""
    flat: dict[str, float] = {}
    for name, value in row.items():
        if isinstance(value, Mapping):
            flat.update({f"{name}/{k}": v for k, v in numbers(value).items()})
        elif is_number(value):
            flat[name] = value
    return flat
