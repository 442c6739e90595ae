"""What a run says: on a terminal one line that moves, elsewhere a short line per evaluation."""

from __future__ import annotations

import io
import shlex
import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from tqdm import tqdm

from zoac.runs.loggers import summary
from zoac.specs.verdict import lines, restored

WIDTH = 80
"""Columns that sentences keep to."""

BAR = "{desc}{percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} steps, {remaining} left{postfix}"
"""The line that moves, for tqdm."""

MAX_SHORT = 24
"""Columns of a tuner's choice that shares a line with others."""

KEPT = "\xa0"
"""A space at which no line is broken."""

MIN_BAR = 4
"""Columns that the bar keeps; figures that do not fit beside it are left out."""


class Console:
    """Standard output, or another stream."""

    def __init__(
        self,
        budget: int,
        folder: Path | None = None,
        stream: TextIO | None = None,
        brief: bool = False,
        live: bool = True,
    ) -> None:
        """
        Args:
            folder: To be named at the end.
            stream: None: standard output, if there is one.
            brief: Print nothing but the line that moves: a sweep prints one line about each run.
            live: Whether a line may move; False if other processes write to the same stream.
        """
        self._budget, self._folder, self._brief = budget, folder, brief
        # There is no standard output in a program without a console.
        self._stream = stream or sys.stdout or io.StringIO()
        self._live = live and (self._stream.isatty() or _is_notebook())
        self._bar: tqdm[Any] | None = None
        self._name = ""
        self._run: Mapping[str, Any] = {}
        self._first: tuple[float, int] | None = None
        self._best = np.inf
        self._baseline: float | None = None
        self._failures = 0
        self._last: Mapping[str, Any] = {"cost_mean": np.nan, "terminations": 0}

    def start(self, run: Mapping[str, Any]) -> None:
        """Print what runs, and the tuner's choices that a comparison must show."""
        variant = f" {run['variant']}" if run["variant"] else ""
        self._run = run
        told = f", minimising {run['objective']}" if run.get("objective") else ""
        self._name = f"{run['task']} {run['tuner']} seed={run['seed']}"
        self._say(f"{self._name}{variant}: {self._budget:,} steps{told}")
        if run.get("episodes"):
            self._say(f"  episodes: {run['episodes']}")
        short = []
        for choice, value in run["tuner_choices"].items():
            told = f"{choice}: {format(value, '.6g') if isinstance(value, float) else value}"
            if len(told) <= MAX_SHORT:
                short.append(told.replace(" ", KEPT))
            else:
                self._say(f"  {told}")
        if short:
            self._say(f"  {', '.join(short)}")

    def resume(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Take what the rows say that the run has already."""
        for row in rows:
            self._learn(row)

    def row(self, row: Mapping[str, Any]) -> None:
        """Show progress."""
        self._learn(row)
        if self._first is None:
            self._first = (row["wall_seconds"], row["env_steps"])
            if self._live:
                self._bar = tqdm(
                    total=self._budget, initial=row["env_steps"], file=self._stream, leave=False,
                    unit_scale=True, dynamic_ncols=True, mininterval=0.5, bar_format=BAR,
                    desc=f"{self._name} " if self._brief else None,
                )  # fmt: skip
        if "first_failure" in row:
            self._say(f"  the first step that failed, priced: {row['first_failure']}")
        if self._bar is not None:
            self._bar.update(max(0, min(row["env_steps"], self._budget) - self._bar.n))
            self._bar.set_postfix_str(self._figures(self._bar), refresh=row["kind"] == "eval")
        elif row["kind"] == "eval":
            ended = f", {row['terminations']} terminated" if row["terminations"] else ""
            final = "final " if row["final"] else ""
            self._print(f"{self._progress(row)} | {final}cost {row['cost_mean']:.4g}{ended}")

    def finish(self, result: Mapping[str, Any]) -> None:
        """Print cost before and after, parameters, specs, warnings, and where the run lies."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None
        for name, before, value, unit in summary.parameter_rows(result, self._run):
            told = f"  {name} = {value} {unit}" if value else f"  {name}"
            self._print(told.rstrip() + (f", baseline {before}" if before else ""))
        for line in summary.cost_lines(result):
            self._say(f"  {line}")
        if (test := result.get("acceptance_test")) is not None:
            self._say(f"  {summary.acceptance_line(test)}")
        for line in lines([restored(row) for row in result.get("specs", [])]):
            self._print(f"  {line}")
        if result.get("failures"):
            self._say(f"  failures: {result['failures']}, the first: {result['first_failure']}")
        for sentence in result["warnings"]:
            self._say(f"  WARNING: {sentence}")
        if result.get("stopped_by"):
            steps = f"{result['env_steps']:,} of {self._budget:,} steps"
            self._say(f"  stopped by the callback {result['stopped_by']} after {steps}")
        if self._folder is not None:
            folder = shlex.quote(str(self._folder))
            self._print(f"  run folder: {folder}")
            self._print(f"  report: python -m zoac.analysis.report {folder}")

    def _learn(self, row: Mapping[str, Any]) -> None:
        """Keep the figures of the line that moves."""
        self._failures = row.get("failures", self._failures)
        if row["kind"] == "eval":
            if np.isfinite(row["cost_mean"]):
                self._best = min(self._best, row["cost_mean"])
            self._last = row
            self._baseline = row.get("baseline_cost_mean", self._baseline)

    def _figures(self, bar: tqdm[Any]) -> str:
        """Return the figures that fit beside the bar, the most important ones first."""
        figures = {
            "best": f"{self._best:.4g}",
            "baseline": "" if self._baseline is None else f"{self._baseline:.4g}",
            "failed": str(self._failures or ""),
            "terminated": str(self._last["terminations"] or ""),
            "cost": f"{self._last['cost_mean']:.4g}",
        }
        meter = {**bar.format_dict, "bar_format": BAR.replace("{bar}", ""), "postfix": ""}
        columns = np.inf if meter["ncols"] is None else meter["ncols"]
        room = columns - len(bar.format_meter(**meter)) - MIN_BAR
        told = ""
        for name, number in figures.items():
            figure = f", {name}={number}"
            if number and len(told + figure) <= room:
                told += figure
        return told.removeprefix(", ")

    def _progress(self, row: Mapping[str, Any]) -> str:
        """Return steps, time so far and time left, from the rate since this process began."""
        assert self._first is not None
        wall, steps = row["wall_seconds"], row["env_steps"]
        done = steps - self._first[1]
        told = f"{steps:>9,} steps | {_clock(wall)}"
        if done > 0 and steps < self._budget:
            told += f", {_clock((wall - self._first[0]) / done * (self._budget - steps))} left"
        return told

    def _say(self, text: str) -> None:
        for line in textwrap.wrap(
            text, WIDTH, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
        ):
            self._print(line.replace(KEPT, " "))

    def _print(self, text: str) -> None:
        if self._brief:
            return
        if self._bar is not None:
            self._bar.clear()
        encoding = getattr(self._stream, "encoding", None) or "utf-8"
        known = text.encode(encoding, errors="backslashreplace").decode(encoding)
        print(known, file=self._stream, flush=True)
        if self._bar is not None:
            self._bar.refresh()


def say(text: str) -> None:
    """Print on standard output, above the line that moves if there is one."""
    if sys.stdout is not None:
        tqdm.write(text)


def _clock(seconds: float) -> str:
    # Whole seconds, without a fraction that nobody can use.
    return tqdm.format_interval(round(seconds))


def _is_notebook() -> bool:
    """Tell whether this is a Jupyter notebook, whose output can be overwritten too."""
    shell = sys.modules.get("IPython")
    return shell is not None and type(shell.get_ipython()).__name__ == "ZMQInteractiveShell"
