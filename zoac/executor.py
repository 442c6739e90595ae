"""Where lanes run: a map over groups of lanes, nothing more."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from zoac.rollout import LaneGroup
from zoac.seeding import stream_seed
from zoac.segments import Proposal, Segment
from zoac.task import Task


def nothing() -> None:
    """What is done meanwhile unless told otherwise."""


class Executor(ABC):
    """Runs proposals in lanes. The numbers do not depend on which executor, or how many workers.

    An executor that waits for others calls `meanwhile` once in that time; it may leave it out.
    """

    @abstractmethod
    def start(self, task: Task, lanes: int, seed: int) -> None:
        """Make `lanes` lanes of `task`, with random streams from the run's `seed`."""

    @abstractmethod
    def rollout(
        self, proposals: Sequence[Proposal], meanwhile: Callable[[], None] = nothing
    ) -> list[Segment]:
        """Run proposals in the tuning lanes; return segments in the order of proposals."""

    @abstractmethod
    def evaluate(
        self, proposals: Sequence[Proposal], meanwhile: Callable[[], None] = nothing
    ) -> list[Segment]:
        """Run seeded proposals in lanes of their own, 0, 1, ...: the tuning lanes do not notice."""

    @abstractmethod
    def state(self) -> dict[int, Any]:
        """Return the state of every tuning lane, by lane id; see `zoac.state`."""

    @abstractmethod
    def restore(self, state: Mapping[int, Any]) -> None:
        """Put back what `state` returned, whichever executor it came from."""

    @property
    def worker_seconds(self) -> float:
        """Processor seconds used so far in other processes than this one."""
        return 0.0

    def close(self) -> None:  # noqa: B027 (most executors hold nothing)
        """Release lanes and workers."""


class LaneHost:
    """The tuning lanes of one process, and evaluation lanes made when first needed."""

    def __init__(self, task: Task, lane_ids: Sequence[int], seed: int) -> None:
        self._task = task
        self.lanes = LaneGroup(
            task, lane_ids, [stream_seed(seed, "lane", lane) for lane in lane_ids]
        )
        self._evaluation: dict[int, LaneGroup] = {}

    def evaluate(self, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run proposals that name lanes 0 .. width - 1 in evaluation lanes."""
        width = max(p.lane for p in proposals) + 1
        if width not in self._evaluation:
            # Every evaluation episode brings its seed: the lanes' own streams are never drawn from.
            self._evaluation[width] = LaneGroup(self._task, range(width), [0] * width)
        return self._evaluation[width].rollout(proposals)

    def close(self) -> None:
        """Release all environments."""
        for group in (self.lanes, *self._evaluation.values()):
            group.close()


class Serial(Executor):
    """All lanes in this process, stepped side by side."""

    def start(self, task: Task, lanes: int, seed: int) -> None:
        """See `Executor.start`."""
        self._host = LaneHost(task, range(lanes), seed)

    def rollout(
        self, proposals: Sequence[Proposal], meanwhile: Callable[[], None] = nothing
    ) -> list[Segment]:
        """See `Executor.rollout`."""
        return self._host.lanes.rollout(proposals)

    def evaluate(
        self, proposals: Sequence[Proposal], meanwhile: Callable[[], None] = nothing
    ) -> list[Segment]:
        """See `Executor.evaluate`."""
        return self._host.evaluate(proposals)

    def state(self) -> dict[int, Any]:
        """See `Executor.state`."""
        return self._host.lanes.state()

    def restore(self, state: Mapping[int, Any]) -> None:
        """See `Executor.restore`."""
        self._host.lanes.restore(state)

    def close(self) -> None:
        """See `Executor.close`."""
        if hasattr(self, "_host"):  # `start` may have failed
            self._host.close()
