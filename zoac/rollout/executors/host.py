"""The environments of one process: this one, or a worker."""

from collections.abc import Sequence
from typing import Literal

from zoac.core.seeding import stream_seed
from zoac.core.segments import Proposal, Segment
from zoac.envs.base import Watch
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.task import Task

Method = Literal["rollout", "evaluate"]


class RolloutHost:
    """The tuning environments of one process, and those of evaluation once needed."""

    def __init__(
        self, task: Task, env_indices: Sequence[int], seed: int, watch: Watch | None = None
    ) -> None:
        self._task, self._watch = task, watch
        seeds = [stream_seed(seed, "lane", env_index) for env_index in env_indices]
        self.engine = RolloutEngine(task, env_indices, seeds, watch)
        self._evaluation: dict[int, RolloutEngine] = {}

    def run(self, method: Method, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run proposals; those of an evaluation name environments 0 .. width - 1."""
        if method == "rollout":
            return self.engine.rollout(proposals)
        width = max(p.env_index for p in proposals) + 1
        if width not in self._evaluation:
            # Every episode brings its seed: the environments' own streams are never drawn from.
            engine = RolloutEngine(self._task, range(width), [0] * width, self._watch, True)
            self._evaluation[width] = engine
        return self._evaluation[width].rollout(proposals)

    def close(self) -> None:
        """Release all environments."""
        for group in (self.engine, *self._evaluation.values()):
            group.close()
