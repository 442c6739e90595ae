"""Roll out the controllers of logged runs again, for landscapes and closed-loop plots.

Only this module of the package steps environments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.analysis.data.runs import Run
from zoac.core.segments import Proposal, Segment
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.evaluation import evaluation_proposals
from zoac.rollout.task import Task

if TYPE_CHECKING:
    from zoac.envs.base import VecEnv

MAX_ENVS = 256
"""Largest number of environments side by side."""


def rebuild(run: Run) -> Task:
    """Return the task that `run` tuned.

    Raises:
        RunFolderError: If it cannot be built here, or needs code and the run is not `trusted`.
    """
    from zoac.runs.result import task_of_run

    return task_of_run(run.folder, run.config, trust_code=run.trusted)


def demonstrate(task: Task, controllers: Sequence[Mapping[str, float]]) -> list[Segment]:
    """Return the task's demonstration episode under each of the named parameter sets."""
    indices, shown = range(len(controllers)), copy(task)
    shown.make_env = lambda n: _demonstrating(task.make_env(n))  # type: ignore[method-assign]
    proposals = [Proposal(task.space.normalise(controllers[k]), env_index=k) for k in indices]
    with closing(RolloutEngine(shown, indices, [0] * len(controllers))) as group:
        return group.rollout(proposals)


def settled(task: Task, segments: Sequence[Segment]) -> int:
    """Return a step shortly after the last one at which a trace is 1% of its range off its end."""
    latest = 0
    for trace in (trace for segment in segments for trace in task.traces(segment)):
        moving = np.flatnonzero(np.abs(trace.y - trace.y[-1]) > 0.01 * np.ptp(trace.y))
        latest = max(latest, int(moving[-1]) if moving.size else 0)
    return min(round(1.1 * latest) + 10, max(segment.length for segment in segments))


def costs(task: Task, points: np.ndarray, episodes: int, seed: int) -> np.ndarray:
    """Return the cost of each normalised point (P, d) in each evaluation episode, (P, E)."""
    proposals = [p for x in points for p in evaluation_proposals(x, episodes, seed)]
    num_envs = min(MAX_ENVS, len(proposals))
    proposals = [replace(p, env_index=k % num_envs) for k, p in enumerate(proposals)]
    with closing(RolloutEngine(task, range(num_envs), [0] * num_envs)) as group:
        segments = group.rollout(proposals)
    return np.reshape([s.costs.sum() for s in segments], (len(points), episodes))


def _demonstrating(env: VecEnv) -> VecEnv:
    """Have every episode of an environment be its demonstration."""
    reset = env.reset

    def demonstration(*, options: dict[str, Any] | None = None, **rest: Any) -> Any:
        return reset(options={**(options or {}), "demonstration": True}, **rest)

    env.reset = demonstration  # type: ignore[method-assign]
    return env
