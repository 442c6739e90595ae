"""Evaluation of what a tuner recommends, on episodes that are the same for every tuner."""

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from zoac.config.settings import Evaluation
from zoac.core.measures import Metric
from zoac.core.segments import Segment
from zoac.core.tuner import Tuner
from zoac.rollout.evaluation import evaluation_proposals, evaluation_row
from zoac.rollout.executors.base import Executor
from zoac.rollout.task import Task
from zoac.runs.training.progress import Progress
from zoac.specs.signals import Episode
from zoac.specs.verdict import deciding


class Evaluator:
    """Runs the fixed evaluation episodes, which cost no budget."""

    def __init__(
        self,
        task: Task,
        tuner: Tuner,
        executor: Executor,
        settings: Evaluation,
        progress: Progress,
        background_update: Callable[[], None],
    ) -> None:
        """
        Args:
            task: What is tuned.
            tuner: By whom.
            executor: Started.
            settings: How many episodes, and which.
            progress: Gets the seconds.
            background_update: The tuner's, timed.
        """
        self._background_update = background_update
        self._task, self._tuner, self._executor = task, tuner, executor
        self._settings, self._progress = settings, progress
        self._baseline = None if task.baseline is None else task.space.normalise(task.baseline)
        self._last_finite = np.zeros(task.space.dimension)  # recommendation
        self._responses: dict[str, list[Segment]] = {}  # final episodes

    def recommendation(self) -> np.ndarray:
        """Return the tuner's recommendation (d,), or its last one whose every number was finite."""
        x = self._tuner.recommend()
        if np.isfinite(x).all():
            self._last_finite = x.copy()
        else:
            print(
                f"after {self._progress.env_steps:,} steps the tuner recommends {x.tolist()}, "
                "which is not finite; its last finite recommendation is kept",
                file=sys.stderr,
            )
        return self._last_finite.copy()

    def evaluate(self, *, final: bool) -> dict[str, Any]:
        """Return the row of an evaluation of the recommendation.

        The first of a run also has `baseline_cost_mean`, on the same episodes, if the task has
        baseline values.
        """
        settings, x = self._settings, self.recommendation()
        segments = self._rollout(x, settings.final_episodes if final else settings.episodes)
        row = self._row(segments, self._task.metrics)
        if final:
            self._responses["tuned"] = segments
        elif self._progress.env_steps == 0 and self._baseline is not None:
            same = np.array_equal(x, self._baseline)
            told = row if same else self._row(self._rollout(self._baseline, settings.episodes))
            row["baseline_cost_mean"] = told["cost_mean"]
        row |= self._progress.account(segments)
        return {**row, "parameters": self._task.space.named(x), "x": x.tolist(), "final": final}

    def evaluate_baseline(self) -> dict[str, Any]:
        """Return `baseline` and its mean cost for a result; {} if the task has no baseline."""
        if self._baseline is None:
            return {}
        segments = self._rollout(self._baseline, self._settings.final_episodes)
        row = self._row(segments)
        self._responses["baseline"] = segments
        return {"baseline_cost_mean": row["cost_mean"], "baseline": row}

    def responses(self) -> tuple[dict[str, Episode], dict[str, Any]]:
        """Return the final episode that decides, with the baseline and the answer; and which it is.

        Only for tasks with named signals.
        """
        task, sample_time = self._task, self._task.sample_time or 1.0
        segments = self._responses["tuned"]
        which, spec, loop = deciding(segments, task.specs, task.signals, sample_time)
        episodes: dict[str, Episode] = {
            name: Episode.of(self._responses[name][which], task.signals, sample_time)
            for name in ("baseline", "tuned")
            if name in self._responses
        }
        told = {"episode": which, "of": len(segments), "loop": loop}
        return episodes, {"shown": {**told, "spec": None if spec is None else str(spec)}}

    def state(self) -> np.ndarray:
        """Return the last finite recommendation (d,)."""
        return self._last_finite.copy()

    def restore(self, state: np.ndarray) -> None:
        """Restore what `state` returned."""
        self._last_finite = state

    def _row(self, segments: list[Segment], metrics: Sequence[Metric] = ()) -> dict[str, Any]:
        return evaluation_row(segments, metrics, self._task.constraints, self._task.specs)

    def _rollout(self, x: np.ndarray, episodes: int) -> list[Segment]:
        """Return the fixed evaluation episodes with the parameters x (d,)."""
        progress = self._progress
        proposals = evaluation_proposals(x, episodes, self._settings.seed)
        before = progress.tuner_seconds
        with progress.timed("evaluation_seconds"):
            segments = self._executor.evaluate(proposals, self._background_update)
        # The tuner's work in the background counts as the tuner's time.
        progress.evaluation_seconds -= progress.tuner_seconds - before
        return segments
