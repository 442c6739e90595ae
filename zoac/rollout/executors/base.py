"""Where environments run: a map over groups of environments, nothing more."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from zoac.core.segments import Proposal, Segment
from zoac.rollout.executors.host import Method, RolloutHost
from zoac.rollout.task import Task


def nothing() -> None:
    """The default background update: none."""


class Executor(ABC):
    """Runs proposals in environments. The numbers do not depend on which executor, or how many
    workers.

    An executor that waits for other processes may call `background_update` once in that time.
    """

    tell: Callable[[str], None] = staticmethod(print)
    """Takes what a user should know, such as a choice that was made."""

    @abstractmethod
    def start(self, task: Task, num_envs: int, seed: int) -> None:
        """Make `num_envs` environments of `task`, with random streams from the run's `seed`."""

    def rollout(
        self, proposals: Sequence[Proposal], background_update: Callable[[], None] = nothing
    ) -> list[Segment]:
        """Run proposals in the tuning environments; return segments in the order of proposals."""
        return self.run("rollout", proposals, background_update)

    def evaluate(
        self, proposals: Sequence[Proposal], background_update: Callable[[], None] = nothing
    ) -> list[Segment]:
        """Run seeded proposals in evaluation environments, apart from those of tuning."""
        return self.run("evaluate", proposals, background_update)

    @abstractmethod
    def run(
        self, method: Method, proposals: Sequence[Proposal], background_update: Callable[[], None]
    ) -> list[Segment]:
        """Carry out one of these two methods."""

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


class Serial(Executor):
    """All environments in this process, stepped side by side."""

    def start(self, task: Task, num_envs: int, seed: int) -> None:
        self._host = RolloutHost(task, range(num_envs), seed)

    def run(
        self, method: Method, proposals: Sequence[Proposal], background_update: Callable[[], None]
    ) -> list[Segment]:
        return self._host.run(method, proposals)

    def state(self) -> dict[int, Any]:
        return self._host.engine.state()

    def restore(self, state: Mapping[int, Any]) -> None:
        self._host.engine.restore(state)

    def close(self) -> None:
        if hasattr(self, "_host"):  # `start` may have failed
            self._host.close()
