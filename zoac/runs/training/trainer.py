"""The loop: ask, roll out, tell, evaluate, log, checkpoint.

It does not know who is tuning, what is tuned, or where environments run.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from zoac.config.settings import Settings
from zoac.core.errors import CallbackError, Interrupted, NothingWorksError
from zoac.core.measures import CLOCKS
from zoac.core.segments import Segment
from zoac.core.tuner import Tuner
from zoac.rollout.constraints import FeasibilityFirst
from zoac.rollout.executors.base import Executor
from zoac.rollout.task import Task
from zoac.runs.log import RunLog
from zoac.runs.loggers.callback import Callbacks
from zoac.runs.training.answer_checks import warnings
from zoac.runs.training.evaluator import Evaluator
from zoac.runs.training.progress import Progress
from zoac.runs.training.run_state import Checkpoints, Environments, Part
from zoac.specs import verdict


class Trainer:
    """One run: a task, a tuner, an executor and a budget."""

    def __init__(
        self,
        task: Task,
        tuner: Tuner,
        executor: Executor,
        settings: Settings,
        log: RunLog,
        stop_requested: Callable[[], bool] = lambda: False,
        callbacks: Callbacks | None = None,
    ) -> None:
        """
        Args:
            executor: Started, and closed by the caller.
            stop_requested: Asked between iterations; True ends the run with a checkpoint.
        """
        self._task, self._tuner, self._executor = task, tuner, executor
        self._settings, self._log = settings, log
        self._stop_requested, self._callbacks = stop_requested, callbacks or Callbacks()
        self.progress = Progress()
        self._constraints = FeasibilityFirst(task.constraints, task.specs)
        self._evaluator = Evaluator(
            task, tuner, executor, settings.evaluation, self.progress, self._background_update
        )
        self._environments = Environments(task, executor, settings, self.progress)
        parts: dict[str, Part] = {
            "tuner": tuner,
            "num_envs": self._environments,
            "constraints": self._constraints,
            "last_finite": self._evaluator,
        }
        self._checkpoints = Checkpoints(log, self.progress, parts, settings.checkpoint_seconds)

    def run(self) -> dict[str, Any]:
        """Tune until the budget is spent or the tuner has nothing more to ask; return the result.

        Raises:
            Interrupted: If asked to stop; the run can be resumed.
            CallbackError: If a callback raises; likewise.
        """
        # As in worker processes: the number of threads changes the order of sums and so the bits.
        with threadpool_limits(1):
            self._checkpoints.restore()
            self._environments.state()  # warns at the start if they cannot be saved
            self._callbacks.start(self._log.run, self._log.rows())
            try:
                self._tune()
            except CallbackError:
                self._checkpoints.save_if_due(now=True)
                raise
            return self._finish()

    def _tune(self) -> None:
        """Iterate until the budget is spent, the tuner is done or a callback stops the search."""
        while self.progress.env_steps < self._settings.budget:
            self._evaluate_if_due()
            if self._callbacks.stopped_by and not self._tuner.end_search():
                break
            with self.progress.timed("tuner_seconds"):
                proposals = self._tuner.ask()
            if not proposals:
                break
            segments = self._executor.rollout(proposals, self._background_update)
            self._learn(segments)
            self._checkpoint_if_due()

    def _background_update(self) -> None:
        with self.progress.timed("tuner_seconds"):
            self._tuner.background_update()

    def _learn(self, segments: list[Segment]) -> None:
        """Count what was spent and tell the tuner."""
        progress = self.progress
        progress.iteration += 1
        progress.env_steps += sum(s.length for s in segments)
        failure = progress.account(segments)
        strict = self._task.strict
        seen = [
            replace(
                s,
                costs=self._task.tuning_costs(s),
                reported_costs=s.costs,
                violation=(strict.judged(s) if strict else s).violation,
            )
            for s in segments
        ]
        seen = self._constraints.told(segments, seen)
        with progress.timed("tuner_seconds"):
            metrics = self._tuner.tell(seen)
        costs = np.concatenate([s.costs for s in seen])
        terminations = sum(s.terminated for s in segments)
        progress.terminations += terminations
        progress.segments += len(segments)
        progress.failed_segments += sum(s.failure is not None for s in segments)
        stamp = self._stamp(iteration=progress.iteration)
        row = {"step_cost_mean": float(costs.mean()), "terminations": terminations}
        self._callbacks.row(self._log.row("train", stamp, {**row, **failure, **metrics}))
        # Segments have one step or more, so that many failures are as many first steps.
        if progress.failed_segments == progress.env_steps >= HOPELESS:
            self._refuse("at its first step")

    def _evaluate_if_due(self) -> None:
        progress, every = self.progress, self._settings.eval_every
        if progress.env_steps >= progress.next_eval:
            progress.next_eval = (progress.env_steps // every + 1) * every
            self._evaluate(final=False)

    def _evaluate(self, *, final: bool) -> dict[str, Any]:
        row = self._evaluator.evaluate(final=final)
        stamp = {**self._stamp(), "compute_seconds": self.progress.compute_seconds}
        self._callbacks.row(self._log.row("eval", stamp, row))
        return row

    def _stamp(self, **more: Any) -> dict[str, Any]:
        """Return what every row begins with."""
        progress = self.progress
        progress.advance(self._executor.worker_seconds)
        wall_seconds = round(progress.wall_seconds, 3)
        return {"env_steps": progress.env_steps, "wall_seconds": wall_seconds, **more}

    def _refuse(self, when: str) -> None:
        progress = self.progress
        raise NothingWorksError(
            f"each of the {progress.segments} episodes so far failed {when}, so there is nothing "
            f"to tune on. The first: {progress.first_failure}"
        )

    def _finish(self) -> dict[str, Any]:
        """Evaluate the answer and the baseline on the final episodes; write the result."""
        progress = self.progress
        if 0 < progress.segments == progress.failed_segments:
            self._refuse("before it ended")
        earlier = [row for row in self._log.rows() if row["kind"] == "eval"]
        final = self._evaluate(final=True)
        for key in ("final", "failures", "first_failure"):
            final.pop(key, None)
        start = self._evaluator.evaluate_baseline()
        shown: dict[str, Any] = {}
        if self._task.signals:
            episodes, shown = self._evaluator.responses()
            self._log.responses(episodes)
        progress.advance(self._executor.worker_seconds)
        result = {
            "env_steps": progress.env_steps,
            **final,
            **{name: getattr(progress, name) for name in CLOCKS},
            "solver_failures": progress.solver_failures,
            "env_restarts": progress.env_restarts,
            "tuning_terminations": progress.terminations,
            "failures": progress.failures,
            "first_failure": progress.first_failure,
            **start,
            **shown,
            **self._verdict(final, start.get("baseline", {})),
            **self._tuner.outcome(),
        }
        if self._callbacks.stopped_by:
            result["stopped_by"] = self._callbacks.stopped_by
        told = warnings(result, earlier, self._task.space.parameters)
        written = self._log.finish({**result, "warnings": told})
        self._callbacks.end(written)
        return written

    def _verdict(self, after: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
        """Return `specs` of a result, from the rows of the answer and the baseline values."""
        specs = self._task.specs
        if not specs:
            return {}
        return {"specs": verdict.rows(specs, after["by_spec"], before.get("by_spec", {}))}

    def _checkpoint_if_due(self) -> None:
        stop = self._stop_requested()
        self.progress.advance(self._executor.worker_seconds)
        self._checkpoints.save_if_due(now=stop)
        if stop:
            steps = self.progress.env_steps
            raise Interrupted(f"stopped after {steps:,} steps", self._record_so_far())

    def _record_so_far(self) -> dict[str, Any]:
        """Return the present recommendation, and what was measured of the last evaluated one."""
        x = self._evaluator.recommendation()
        (*_, last) = (row for row in self._log.rows() if row["kind"] == "eval")
        return {
            **last,
            **self._verdict(last, {}),
            "evaluated_after_steps": last["env_steps"],
            "env_steps": self.progress.env_steps,
            "parameters": self._task.space.named(x),
            "x": x.tolist(),
            "warnings": ["the run was stopped early: these parameters met no final episodes"],
            "finished": False,
        }


HOPELESS = 10
"""Episodes after which a run whose every episode failed at its first step ends: no parameters
would help, or something is misspelt."""
