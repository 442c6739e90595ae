"""Runs as pandas frames."""

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

from zoac.analysis.data.runs import Run
from zoac.core.types import is_number


def results_frame(runs: Iterable[Run]) -> pd.DataFrame:
    """Return one row per finished run: its identity and every number of its result."""
    return pd.DataFrame([_row(run, run.outcome) for run in runs if run.result is not None])


def evaluations_frame(runs: Iterable[Run]) -> pd.DataFrame:
    """Return one row per evaluation while tuning, with `parameters.NAME` columns."""
    return pd.DataFrame([_row(run, record) for run in runs for record in run.evaluations])


def numbers(record: Mapping[str, Any]) -> dict[str, float]:
    """Return the entries of `record` that are numbers; True and False are none."""
    return {key: value for key, value in record.items() if is_number(value)}


def _row(run: Run, record: Mapping[str, Any]) -> dict[str, Any]:
    parameters = record.get("parameters") or {}
    named = {f"parameters.{name}": value for name, value in parameters.items()}
    return {**run.method._asdict(), "seed": run.seed, **numbers(record), **named}
