"""Runs as pandas frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

from zoac.analysis.data.runs import Run
from zoac.core.types import is_number


def results_frame(runs: Iterable[Run]) -> pd.DataFrame:
    """Return one row per finished run: its identity and every number of its result."""
    rows = [{**_identity(run), **_numbers(run.outcome)} for run in runs if run.result is not None]
    return pd.DataFrame(rows)


def evaluations_frame(runs: Iterable[Run]) -> pd.DataFrame:
    """Return one row per evaluation while tuning, with `parameters.NAME` columns."""
    rows = [{**_identity(run), **_numbers(row)} for run in runs for row in run.evaluations]
    return pd.DataFrame(rows)


def numbers(record: Mapping[str, Any]) -> dict[str, float]:
    """Return the entries of `record` that are numbers; True and False are none."""
    return {key: value for key, value in record.items() if is_number(value)}


def _identity(run: Run) -> dict[str, Any]:
    return {**run.method._asdict(), "seed": run.seed}


def _numbers(record: Mapping[str, Any]) -> dict[str, Any]:
    parameters = record.get("parameters") or {}
    named = {f"parameters.{name}": value for name, value in parameters.items()}
    return {**numbers(record), **named}
