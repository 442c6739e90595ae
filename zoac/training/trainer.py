"""The loop: ask, roll out, tell, evaluate, log, checkpoint.

It does not know who is tuning, what is tuned, or where environments run.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from zoac.config.settings import Settings
from zoac.core.errors import Interrupted, NothingWorksError, ZoacError
from zoac.core.measures import Metric
from zoac.core.seeding import stream_seed
from zoac.core.segments import Segment
from zoac.core.state import encode
from zoac.core.tuner import Tuner
from zoac.executors.base import Executor
from zoac.rollout.constraints import FeasibilityFirst
from zoac.rollout.evaluation import evaluation_proposals, evaluation_row
from zoac.rollout.task import Task
from zoac.runs.checkpoint import check_keys, fitting
from zoac.runs.log import RunLog
from zoac.specs import verdict
from zoac.specs.signals import Episode
from zoac.training.answer_checks import warnings
from zoac.training.progress import Progress


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
    ) -> None:
        """
        Args:
            task: What is tuned.
            tuner: Who tunes.
            executor: Where environments run; started, and closed by the caller.
            settings: Seed, budget and evaluation.
            log: Where rows, checkpoints and the result go.
            stop_requested: Asked between iterations; True ends the run with a checkpoint.
        """
        self._task, self._tuner, self._executor = task, tuner, executor
        self._settings, self._log = settings, log
        self._stop_requested = stop_requested
        self._envs_unsaved = False  # environments cannot be saved, which was printed
        self._constraints = FeasibilityFirst(task.constraints, task.specs)
        self._responses: dict[str, Segment] = {}  # first final episodes
        self._last_finite = np.zeros(task.space.dimension)  # recommendation
        self.progress = Progress()
        self._wall_start = self._last_checkpoint = time.perf_counter()
        self._compute_start = time.process_time()

    def run(self) -> dict[str, Any]:
        """Tune until the budget is spent or the tuner has nothing more to ask; return the result.

        Raises:
            Interrupted: If asked to stop; the run can be resumed.
        """
        self._restore(self._log.load_checkpoint())
        self._saved_envs()  # warns at the start if they cannot be saved
        while self.progress.env_steps < self._settings.budget:
            self._evaluate_if_due()
            with self.progress.timed("tuner_seconds"):
                proposals = self._tuner.ask()
            if not proposals:
                break
            segments = self._executor.rollout(proposals, self._background_update)
            self._learn(segments)
            self._checkpoint_if_due()
        return self._finish()

    def _learn(self, segments: list[Segment]) -> None:
        """Count what was spent and tell the tuner."""
        progress = self.progress
        progress.iteration += 1
        progress.env_steps += sum(s.length for s in segments)
        failure = self.progress.account(segments)
        seen = [
            replace(
                s,
                costs=self._task.tuning_costs(s),
                reported_costs=s.costs,
                violation=self._task.tuning_violation(s),
            )
            for s in segments
        ]
        seen = self._constraints.told(segments, seen)
        with self.progress.timed("tuner_seconds"):
            metrics = self._tuner.tell(seen)
        costs = np.concatenate([s.costs for s in seen])
        terminations = sum(s.terminated for s in segments)
        progress.terminations += terminations
        self._log.row(
            "train",
            self._stamp(iteration=progress.iteration),
            {
                "step_cost_mean": float(costs.mean()),
                "terminations": terminations,
                **failure,
                **metrics,
            },
        )
        progress.segments += len(segments)
        progress.failed_segments += sum(s.failure is not None for s in segments)
        # Segments have one step or more, so that many failures are as many first steps.
        if progress.failed_segments == progress.env_steps >= HOPELESS:
            self._refuse("at its first step")

    def _background_update(self) -> None:
        with self.progress.timed("tuner_seconds"):
            self._tuner.background_update()

    def _evaluate_if_due(self) -> None:
        progress = self.progress
        if progress.env_steps < progress.next_eval:
            return
        every = self._settings.eval_every
        progress.next_eval = (progress.env_steps // every + 1) * every
        self._evaluate(self._settings.evaluation.episodes, final=False)

    def _evaluate(self, episodes: int, final: bool) -> dict[str, Any]:
        """Run the fixed episodes with the recommended parameters and log a row."""
        x = self._recommended()
        segments = self._rolled_out(x, episodes)
        row = self._row(segments, self._task.metrics)
        if final:
            self._responses["tuned"] = segments[0]
        row |= self.progress.account(segments)
        row = {**row, "parameters": self._task.space.named(x), "x": x.tolist(), "final": final}
        self._log.row("eval", self._stamp(compute_seconds=self._compute_seconds()), row)
        return row

    def _row(self, segments: list[Segment], metrics: Sequence[Metric] = ()) -> dict[str, Any]:
        return evaluation_row(segments, metrics, self._task.constraints, self._task.specs)

    def _rolled_out(self, x: np.ndarray, episodes: int) -> list[Segment]:
        """Return the fixed evaluation episodes with the parameters x (d,)."""
        proposals = evaluation_proposals(x, episodes, self._settings.evaluation.seed)
        tuner_seconds = self.progress.tuner_seconds
        with self.progress.timed("evaluation_seconds"):
            segments = self._executor.evaluate(proposals, self._background_update)
        # What the tuner did beside it is the tuner's.
        self.progress.evaluation_seconds -= self.progress.tuner_seconds - tuner_seconds
        return segments

    def _recommended(self) -> np.ndarray:
        """Return the tuner's recommendation, or its last one whose every number was finite."""
        x = self._tuner.recommend()
        if np.isfinite(x).all():
            self._last_finite = x.copy()
        else:
            print(
                f"after {self.progress.env_steps:,} steps the tuner recommends {x.tolist()}, which "
                "is not finite; its last finite recommendation is kept",
                file=sys.stderr,
            )
        return self._last_finite.copy()

    def _refuse(self, when: str) -> None:
        """End a run in which every segment failed.

        Raises:
            NothingWorksError: Always.
        """
        progress = self.progress
        raise NothingWorksError(
            f"each of the {progress.segments} episodes so far failed {when}, so there is nothing "
            f"to tune on. The first: {progress.first_failure}"
        )

    def _finish(self) -> dict[str, Any]:
        if 0 < self.progress.segments == self.progress.failed_segments:
            self._refuse("before it ended")
        earlier = [row for row in self._log.rows() if row["kind"] == "eval"]
        final = self._evaluate(self._settings.evaluation.final_episodes, final=True)
        del final["final"]
        final.pop("first_failure", None)
        start = self._start()
        if self._task.signals:
            sample_time = self._task.sample_time or 1.0
            self._log.responses({
                which: Episode.of(self._responses[which], self._task.signals, sample_time)
                for which in ("baseline", "tuned")
                if which in self._responses
            })  # fmt: skip
        progress = asdict(self.progress)
        result = {
            "env_steps": progress["env_steps"],
            **final,
            "wall_seconds": self._wall_seconds(),
            "compute_seconds": self._compute_seconds(),
            **{f"{part}_seconds": progress[f"{part}_seconds"] for part in _PARTS},
            "solver_failures": progress["solver_failures"],
            "env_restarts": progress["env_restarts"],
            "tuning_terminations": progress["terminations"],
            "failures": progress["failures"],
            "first_failure": progress["first_failure"],
            **start,
            **self._verdict(final, start.get("baseline", {})),
            **self._tuner.outcome(),
        }
        return self._log.finish({**result, "warnings": warnings(result, earlier)})

    def _start(self) -> dict[str, Any]:
        """Return what the baseline costs on the final evaluation episodes, if there is one."""
        if self._task.baseline is None:
            return {}
        x = self._task.space.normalise(self._task.baseline)
        segments = self._rolled_out(x, self._settings.evaluation.final_episodes)
        row = self._row(segments)
        self._responses["baseline"] = segments[0]
        return {"baseline_cost_mean": row["cost_mean"], "baseline": row}

    def _verdict(self, after: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
        """Return `specs` of a result, from the rows of the answer and the baseline values."""
        specs = self._task.specs
        if not specs:
            return {}
        return {"specs": verdict.rows(specs, after["by_spec"], before.get("by_spec", {}))}

    def _stamp(self, **more: Any) -> dict[str, Any]:
        return {
            "env_steps": self.progress.env_steps,
            "wall_seconds": round(self._wall_seconds(), 3),
            **more,
        }

    def _wall_seconds(self) -> float:
        return self.progress.wall_seconds + time.perf_counter() - self._wall_start

    def _compute_seconds(self) -> float:
        here = time.process_time() - self._compute_start
        return self.progress.compute_seconds + here + self._executor.worker_seconds

    def _checkpoint_if_due(self) -> None:
        stop = self._stop_requested()
        waited = time.perf_counter() - self._last_checkpoint
        if stop or waited >= self._settings.checkpoint_seconds:
            begun = time.perf_counter()
            self._log.save_checkpoint(self._state())
            self._last_checkpoint = time.perf_counter()
            self.progress.checkpoint_seconds += self._last_checkpoint - begun
        if stop:
            steps = self.progress.env_steps
            raise Interrupted(f"stopped after {steps:,} steps", self._record_so_far())

    def _record_so_far(self) -> dict[str, Any]:
        """Return the present recommendation, and what was measured of the last evaluated one."""
        x = self._recommended()
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

    def _state(self) -> dict[str, Any]:
        progress = asdict(self.progress)
        progress["wall_seconds"] = self._wall_seconds()
        progress["compute_seconds"] = self._compute_seconds()
        progress["log_bytes"] = self._log.size()
        return {
            "progress": progress,
            "tuner": self._tuner.state(),
            "num_envs": self._saved_envs(),
            "constraints": self._constraints.state(),
            "last_finite": self._last_finite.copy(),
        }

    def _saved_envs(self) -> Any:
        """Return the environments' state; None, and say so once, if it cannot be saved."""
        if self._envs_unsaved:
            return None
        try:
            state = self._executor.state()
            encode(state)
        except Exception as error:  # whatever a user's environment or controller raises
            self._envs_unsaved = True
            reason = error if isinstance(error, ZoacError) else f"{type(error).__name__}: {error}"
            more = ""
            if self._task.restore_fault is not None:
                more = (
                    "no two segments begin in one state, held-out episodes end an environment's "
                    "own, "
                )
            print(
                f"the environment or controller cannot be saved ({reason}): {more}"
                "if this run is stopped, it goes on with new episodes, and so not to the same "
                "bits; env_restarts in result.json counts that",
                file=sys.stderr,
            )
            return None
        return state

    def _restore(self, state: dict[str, Any] | None) -> None:
        if state is None:
            self._log.rewind(0)
            return
        check_keys("the checkpoint", state, dict.fromkeys(_STATE))
        check_keys("the progress in the checkpoint", state["progress"], asdict(Progress()))
        self.progress = Progress(**state["progress"])
        with fitting(of_tuner := "the tuner's state in the checkpoint"):
            check_keys(of_tuner, state["tuner"], self._tuner.state())
            self._tuner.restore(state["tuner"])
        with fitting(of_constraints := "the constraints' state in the checkpoint"):
            check_keys(of_constraints, state["constraints"], self._constraints.state())
            self._constraints.restore(state["constraints"])
        self._last_finite = state["last_finite"]
        if state["num_envs"] is None:
            self._begin_new_episodes()
        else:
            with fitting("the environments' state in the checkpoint"):
                self._executor.restore(state["num_envs"])
        self._log.rewind(self.progress.log_bytes)

    def _begin_new_episodes(self) -> None:
        """Start environments anew, from seeds that no earlier start of this run had."""
        self.progress.env_restarts += 1
        settings = self._settings
        seed = stream_seed(settings.seed, "restart", self.progress.env_restarts)
        self._executor.close()
        self._executor.start(self._task, settings.num_envs, seed)


HOPELESS = 10
"""Episodes after which a run whose every episode failed at its first step ends: no parameters
would help, or something is misspelt."""

_STATE = ("progress", "tuner", "num_envs", "constraints", "last_finite")
"""Keys of a checkpoint."""


_PARTS = ("solver", "tuner", "evaluation", "checkpoint")
