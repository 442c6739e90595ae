"""Where environments run: a map over groups of environments, nothing more."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from zoac.core.seeding import stream_seed
from zoac.core.segments import Proposal, Segment
from zoac.envs.base import Watch
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.task import Task


def nothing() -> None:
    """The default background update: none."""


class Executor(ABC):
    """Runs proposals in environments. The numbers do not depend on which executor, or how many
    workers.

    An executor that waits for other processes calls `background_update` once in that time.
    """

    tell: Callable[[str], None] = staticmethod(print)
    """Takes what a user should know, such as a choice that was made."""
    ends_steps = False
    """Whether it keeps the task's `step_timeout`."""

    @abstractmethod
    def start(self, task: Task, num_envs: int, seed: int) -> None:
        """Make `num_envs` environments of `task`, with random streams from the run's `seed`."""

    @abstractmethod
    def rollout(
        self, proposals: Sequence[Proposal], background_update: Callable[[], None] = nothing
    ) -> list[Segment]:
        """Run proposals in the tuning environments; return segments in the order of proposals."""

    @abstractmethod
    def evaluate(
        self, proposals: Sequence[Proposal], background_update: Callable[[], None] = nothing
    ) -> list[Segment]:
        """Run seeded proposals in evaluation environments, apart from those of tuning."""

    @abstractmethod
    def state(self) -> dict[int, Any]:
        """Return the state of every tuning environment, by its index."""

    @abstractmethod
    def restore(self, state: Mapping[int, Any]) -> None:
        """Restore what `state` returned, whichever executor it came from."""

    @property
    def worker_seconds(self) -> float:
        """Processor seconds used so far in other processes than this one."""
        return 0.0

    def close(self) -> None:  # noqa: B027 (most executors hold nothing)
        """Release environments and workers."""


class RolloutHost:
    """The tuning environments of one process, and those of evaluation once needed."""

    def __init__(
        self, task: Task, env_indices: Sequence[int], seed: int, watch: Watch | None = None
    ) -> None:
        """
        Args:
            task: Gives environment and controller.
            env_indices: Of the tuning environments.
            seed: Of the run.
            watch: See `VecEnv.watch`.
        """
        self._task, self._watch = task, watch
        self.engine = RolloutEngine(
            task,
            env_indices,
            [stream_seed(seed, "lane", env_index) for env_index in env_indices],
            watch,
        )
        self._evaluation: dict[int, RolloutEngine] = {}

    def evaluate(self, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run proposals that name environments 0 .. width - 1 in evaluation environments."""
        width = max(p.env_index for p in proposals) + 1
        if width not in self._evaluation:
            # Every evaluation episode brings its seed: the environments' own streams are never
            # drawn from.
            self._evaluation[width] = RolloutEngine(
                self._task, range(width), [0] * width, self._watch
            )
        return self._evaluation[width].rollout(proposals)

    def close(self) -> None:
        """Release all environments."""
        for group in (self.engine, *self._evaluation.values()):
            group.close()


class Serial(Executor):
    """All environments in this process, stepped side by side."""

    def start(self, task: Task, num_envs: int, seed: int) -> None:
        """See `Executor.start`."""
        self._host = RolloutHost(task, range(num_envs), seed)

    def rollout(
        self, proposals: Sequence[Proposal], background_update: Callable[[], None] = nothing
    ) -> list[Segment]:
        """See `Executor.rollout`."""
        return self._host.engine.rollout(proposals)

    def evaluate(
        self, proposals: Sequence[Proposal], background_update: Callable[[], None] = nothing
    ) -> list[Segment]:
        """See `Executor.evaluate`."""
        return self._host.evaluate(proposals)

    def state(self) -> dict[int, Any]:
        """See `Executor.state`."""
        return self._host.engine.state()

    def restore(self, state: Mapping[int, Any]) -> None:
        """See `Executor.restore`."""
        self._host.engine.restore(state)

    def close(self) -> None:
        """See `Executor.close`."""
        if hasattr(self, "_host"):  # `start` may have failed
            self._host.close()
