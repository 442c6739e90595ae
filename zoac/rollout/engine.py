"""The rollout engine: the only place where an environment is stepped."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.core.errors import EnvironmentFailure, UnsavableError, ZoacError, as_text
from zoac.core.seeding import stream_seed
from zoac.core.segments import Proposal, Segment
from zoac.rollout.buffer import Recording
from zoac.rollout.controllers import Controllers
from zoac.specs.judge import Judge

if TYPE_CHECKING:
    from zoac.envs.base import Watch
    from zoac.rollout.task import Task


@dataclass(slots=True)
class _Running:
    """An environment's current proposal."""

    index: int
    first_row: int
    starts_episode: bool
    resume: dict[str, Any] | None


class RolloutEngine:
    """Environments stepped side by side, each with its own episode, random stream and memory.

    An environment depends on nothing but its own seed and proposals, so results are the same bits
    however environments are divided among engines and processes.
    """

    def __init__(
        self,
        task: Task,
        env_indices: Sequence[int],
        seeds: Sequence[int],
        watch: Watch | None = None,
        evaluates: bool = False,
    ) -> None:
        """
        Args:
            task: Gives environment, controller and parameter space.
            env_indices: The indices of this engine's environments, as proposals name them.
            seeds: One for each environment's random stream.
            watch: See `VecEnv.watch`.
            evaluates: Its environments run evaluations, for messages: which of them runs an
                episode depends on the executor.
        """
        self.n = len(env_indices)
        self._space = task.space
        self._env = task.make_env(self.n)
        if watch is not None:
            self._env.watch(watch)
        self._row_of = {env_index: row for row, env_index in enumerate(env_indices)}
        self._env_indices, self._seeds = tuple(env_indices), tuple(seeds)
        self._evaluates = evaluates
        self._first_seeds: list[int | None] = list(seeds)
        self._restarts = np.zeros(self.n, dtype=np.int64)
        self._task = task
        self._told = False  # that an environment could not be copied
        self._observations = np.zeros((self.n, *(self._env.single_observation_space.shape or ())))
        self._needs_reset = np.ones(self.n, dtype=bool)
        self._steps = np.zeros(self.n, dtype=np.int64)  # since the start of the episode
        self._penalty = task.failure_penalty
        limit = self._env.max_episode_steps
        self._judge = Judge(task.specs, task.signals, task.sample_time, limit, self._named)
        self._failures: dict[int, str] = {}  # why environments fail at this step
        self._not_begun: dict[int, str] = {}  # why environments could not begin their episode
        # One contiguous row of n values per parameter.
        self._values = np.zeros((len(self._space.names), self.n))
        self._parameters = dict(zip(self._space.names, self._values, strict=True))
        self._action_shape = tuple(self._env.single_action_space.shape or ())
        self._controllers = Controllers(
            task, self.n, self._action_shape, self._parameters, self._place, self._priced
        )

    def rollout(self, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run all proposals; return their segments in the same order.

        Raises:
            ControllerError: If the controller raises or returns unusable actions.
            EnvironmentFailure: If the environment raises or returns what is not finite. Where the
                task has a `failure_penalty`, either ends the episode instead, and that step costs
                so much.
        """
        x = np.array([p.x for p in proposals]).reshape(-1, self._space.dimension)
        values = self._space.values(x)
        queues: list[deque[int]] = [deque() for _ in range(self.n)]
        for index, proposal in enumerate(proposals):
            queues[self._row_of[proposal.env_index]].append(index)
        running: dict[int, _Running] = {}
        last_rows = np.full(self.n, -1, dtype=np.int64)  # of segments with a horizon
        active = np.zeros(self.n, dtype=bool)
        record, diagnosed = Recording(), Recording()
        segments: list[Segment | None] = [None] * len(proposals)

        def begin(env_index: int) -> None:
            active[env_index] = bool(queues[env_index])
            if not active[env_index]:
                return
            index = queues[env_index].popleft()
            self._values[:, env_index] = values[index]
            running[env_index] = self._stand(env_index, index, proposals[index], record.rows)
            horizon = proposals[index].horizon
            last_rows[env_index] = -1 if horizon is None else record.rows + horizon

        for env_index in range(self.n):
            begin(env_index)
        while running:
            row, diagnostics, terminated, truncated = self._advance(active)
            record.append(row)
            diagnosed.append(diagnostics)
            self._steps += active
            over = (terminated | truncated | (last_rows == record.rows)) & active
            for env_index in over.nonzero()[0].tolist():
                run = running.pop(env_index)
                ended, cut = bool(terminated[env_index]), bool(truncated[env_index])
                arrays: dict[str, Any] = record.cut(run.first_row, env_index)
                seen = (arrays.pop("observations"), self._observations[None, env_index])
                segment = Segment(
                    proposal=proposals[run.index],
                    terminated=ended,
                    truncated=cut,
                    starts_episode=run.starts_episode,
                    failure=self._failures.get(env_index),
                    diagnostics=diagnosed.cut(run.first_row, env_index),
                    observations=np.concatenate(seen, dtype=np.float64),
                    **{name: v.astype(np.float64, copy=False) for name, v in arrays.items()},
                )
                segments[run.index] = self._judge.judged(segment)
                if ended or cut:
                    self._controllers.begin(env_index)
                self._needs_reset[env_index] = ended or cut or segment.proposal.seed is not None
                if run.resume is not None:
                    self._restore_env(env_index, run.resume)
                begin(env_index)
        return [segment for segment in segments if segment is not None]

    def _advance(self, active: np.ndarray) -> tuple[Any, ...]:
        """Let controllers act and environments step where `active` (n,) holds; price failures.

        Returns:
            Observations (n, o) before, actions and commands (n, m) and costs (n,), by name; the
            controllers' diagnostics; terminated and truncated (n,).
        """
        self._failures, self._not_begun = self._not_begun, {}
        moves = active
        if self._failures:
            moves = active & ~np.isin(np.arange(self.n), list(self._failures))
        rows = moves.nonzero()[0]
        commands, diagnostics = self._controllers.act(rows, self._observations, self._failures)
        before = self._observations
        self._observations, _, terminated, truncated, infos = self._env.step(
            commands, None if len(rows) == self.n else moves
        )
        costs, failures = infos["cost"], dict(infos.get("failures", {}))
        if self._penalty is not None:
            finite = np.isfinite(costs) & np.isfinite(self._observations.reshape(self.n, -1)).all(1)
            for env_index in np.flatnonzero(moves & ~finite).tolist():
                self._observations[env_index] = before[env_index]
                failures[env_index] = EnvironmentFailure(
                    "the environment returned an observation or a cost that is not finite"
                )
        for env_index, failure in failures.items():
            self._begin_anew(env_index)
            if env_index not in self._failures:
                self._failures[env_index] = self._priced(failure, env_index)
        if self._failures:
            failed = np.isin(np.arange(self.n), list(self._failures))
            terminated, truncated = terminated | failed, truncated & ~failed
            costs = np.where(failed, self._penalty, costs)
        applied = infos.get("actions", commands)
        row = {"observations": before, "actions": applied, "commands": commands, "costs": costs}
        return row, {**diagnostics, **infos.get("measured", {})}, terminated, truncated

    def _priced(self, failure: ZoacError, env_index: int | None = None) -> str:
        """Return what is told of a failure, with a place if given; without a price raise it."""
        told = str(failure) if env_index is None else f"{failure}. {self._place(env_index)}"
        if self._penalty is not None:
            return told
        raise type(failure)(
            f"{told}. With failure_penalty=<cost>, such a step ends its episode at that cost "
            "instead of the run"
        ) from failure.__cause__

    def _stand(self, env_index: int, index: int, proposal: Proposal, row: int) -> _Running:
        """Bring an environment to where `proposal` starts."""
        if proposal.seed is not None:
            resume = self._saved_env(env_index)
            if resume is None:
                self._begin_anew(env_index)
            self._reset(env_index, proposal.seed)
        else:
            whole_episode = proposal.horizon is None and self._steps[env_index] > 0
            if self._needs_reset[env_index] or whole_episode:
                seed, self._first_seeds[env_index] = self._first_seeds[env_index], None
                self._reset(env_index, seed)
            resume = self._saved_env(env_index) if proposal.restore else None
        return _Running(index, row, bool(self._steps[env_index] == 0), resume)

    def _begin_anew(self, env_index: int) -> None:
        """Have an environment that failed or cannot be restored begin a new episode next."""
        self._restarts[env_index] += 1
        seed = stream_seed(self._seeds[env_index], "restart", int(self._restarts[env_index]))
        self._first_seeds[env_index] = seed

    def _reset(self, env_index: int, seed: int | None) -> None:
        mask = np.arange(self.n) == env_index
        seeds = [seed if row == env_index else None for row in range(self.n)]
        self._steps[env_index] = 0
        observations, infos = self._env.reset(seed=seeds, options={"reset_mask": mask})
        if (failure := infos.get("failures", {}).get(env_index)) is not None:
            self._not_begun[env_index] = self._priced(failure, env_index)
            self._begin_anew(env_index)
        self._observations = self._observations.copy()
        self._observations[env_index] = observations[env_index]
        self._controllers.reset(env_index)
        self._needs_reset[env_index] = env_index in self._not_begun

    def _named(self, x: np.ndarray) -> dict[str, Any]:
        """Return all parameters, by name, of mapped ones (d,)."""
        return {**self._space.named(x), **self._task.fixed}

    def _place(self, env_index: int) -> str:
        """Say for an error message where an environment stands."""
        values = ", ".join(f"{name}={v[env_index]:.6g}" for name, v in self._parameters.items())
        which = f"Environment {self._env_indices[env_index]}"
        if self._evaluates:
            which = "An environment of the evaluation"
        return f"{which}, step {self._steps[env_index]} of its episode, parameters: {values}"

    def _saved_env(self, env_index: int) -> dict[str, Any] | None:
        """Return an environment's state, to be restored later; None if it cannot be copied."""
        if self._task.restore_fault is not None:
            return None
        try:
            return self._snapshot(env_index)
        except Exception as error:  # whatever a user's environment or controller raises
            if not self._told:
                self._told = True
                print(
                    f"an environment cannot be copied any more ({as_text(error)}): "
                    "it goes on from where it stands, and a held-out episode ends its own",
                    file=sys.stderr,
                )
            return None

    def _snapshot(self, env_index: int) -> dict[str, Any]:
        return {
            "env": self._env.state([env_index]),
            "observation": self._observations[env_index].copy(),
            "memory": self._controllers.snapshot(env_index),
            "steps": int(self._steps[env_index]),
            "needs_reset": bool(self._needs_reset[env_index]),
            "first_seed": self._first_seeds[env_index],
            "restarts": int(self._restarts[env_index]),
        }

    def _restore_env(self, env_index: int, snapshot: Mapping[str, Any]) -> None:
        self._env.restore([env_index], snapshot["env"])
        self._observations = self._observations.copy()
        self._observations[env_index] = snapshot["observation"]
        self._controllers.restore(env_index, snapshot["memory"])
        self._steps[env_index] = snapshot["steps"]
        self._needs_reset[env_index] = snapshot["needs_reset"]
        self._first_seeds[env_index] = snapshot["first_seed"]
        self._restarts[env_index] = snapshot["restarts"]

    def state(self) -> dict[int, Any]:
        """Return a copy of every environment's state, by its index; see `zoac.core.state`.

        Raises:
            UnsavableError: If the environment cannot be restored.
        """
        if self._task.save_fault is not None:
            raise UnsavableError(self._task.save_fault)
        return {env_index: self._snapshot(row) for env_index, row in self._row_of.items()}

    def restore(self, state: Mapping[int, Any]) -> None:
        """Restore this engine's environments from `state`, which may hold others too."""
        for env_index, row in self._row_of.items():
            memory = deepcopy(state[env_index]["memory"])
            self._restore_env(row, {**state[env_index], "memory": memory})

    def close(self) -> None:
        """Release the environment."""
        self._env.close()
