"""What a run has spent and met so far."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from zoac.core.segments import Segment


@dataclass
class Progress:
    """Counters of a run; they survive a resume."""

    iteration: int = 0
    env_steps: int = 0
    next_eval: int = 0
    wall_seconds: float = 0.0
    compute_seconds: float = 0.0
    solver_seconds: float = 0.0
    tuner_seconds: float = 0.0
    evaluation_seconds: float = 0.0
    checkpoint_seconds: float = 0.0
    solver_failures: int = 0
    env_restarts: int = 0
    terminations: int = 0
    segments: int = 0
    failed_segments: int = 0
    failures: int = 0
    first_failure: str | None = None
    log_bytes: int = 0

    def __post_init__(self) -> None:
        self._clocks = time.perf_counter(), time.process_time()

    def advance(self, worker_seconds: float) -> None:
        """Bring `wall_seconds` and `compute_seconds` to this moment.

        Args:
            worker_seconds: Processor time of all workers since the run's process began.
        """
        clocks = time.perf_counter(), time.process_time() + worker_seconds
        self.wall_seconds += clocks[0] - self._clocks[0]
        self.compute_seconds += clocks[1] - self._clocks[1]
        self._clocks = clocks

    def account(self, segments: Sequence[Segment]) -> dict[str, Any]:
        """Add up failures and what controllers report of solvers, tuning and evaluation alike.

        Returns:
            For the row, if a segment failed: `failures`, their number so far, and `first_failure`
            if the run's first is among them.
        """
        failures = [s.failure for s in segments if s.failure is not None]
        self.failures += len(failures)
        told: dict[str, Any] = {"failures": self.failures} if failures else {}
        if failures and self.first_failure is None:
            self.first_failure = told["first_failure"] = failures[0]
        for segment in segments:
            self.solver_seconds += float(np.sum(segment.diagnostics.get("solver_seconds", 0.0)))
            self.solver_failures += int(np.sum(segment.diagnostics.get("solver_failed", 0)))
        return told

    @contextmanager
    def timed(self, counter: str) -> Iterator[None]:
        """Add the wall seconds of what is done inside to a counter."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - begun
            setattr(self, counter, getattr(self, counter) + spent)

    def state(self) -> dict[str, Any]:
        """Return the counters by name."""
        return asdict(self)

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore what `state` returned; the clocks go on from now."""
        for name, value in state.items():
            setattr(self, name, value)
        self._clocks = time.perf_counter(), time.process_time()
