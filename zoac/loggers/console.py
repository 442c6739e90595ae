"""One line per evaluation, and on a terminal a line that moves in between."""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Mapping
from typing import Any, TextIO

from zoac.specs.verdict import lines, restored


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
                f"  acceptance test: {verdict} the baseline values, {pairs}: "
                f"{acceptance_test['text']}"
            )
        if (start := result.get("baseline_cost_mean")) is not None:
            episodes = f"the same {len(result['cost_per_episode'])} episodes"
            self._print(
                f"  cost {result['cost_mean']:.4g}, baseline values {start:.4g} on {episodes}"
            )
        for line in lines([restored(row) for row in result.get("specs", [])]):
            self._print(f"  {line}")
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
