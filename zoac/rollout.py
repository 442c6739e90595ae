"""The rollout engine: the only place where an environment is stepped."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.environment import can_be_put_back
from zoac.errors import ControllerError, ZoacError
from zoac.recording import Recording
from zoac.seeding import stream_seed
from zoac.segments import Proposal, Segment

if TYPE_CHECKING:
    from zoac.task import Task


@dataclass(slots=True)
class _Running:
    """A lane's current proposal."""

    index: int
    first_row: int
    horizon: int | None
    starts_episode: bool
    resume: dict[str, Any] | None


class LaneGroup:
    """Lanes stepped side by side, each with its own episode, random stream and memory.

    What a lane does depends on nothing but its own seed and proposals, so results are the same
    bits however lanes are spread over groups and processes.
    """

    def __init__(self, task: Task, lane_ids: Sequence[int], seeds: Sequence[int]) -> None:
        """
        Args:
            task: Gives environment, controller and parameter space.
            lane_ids: The ids of this group's lanes, as proposals name them.
            seeds: One seed a lane, for its random stream.
        """
        self.n = len(lane_ids)
        self._space = task.space
        self._env = task.make_env(self.n)
        self._controller = task.make_controller()
        self._row_of = {lane_id: row for row, lane_id in enumerate(lane_ids)}
        self._lane_ids = tuple(lane_ids)
        self._seeds = tuple(seeds)
        self._first_seeds: list[int | None] = list(seeds)
        self._restarts = np.zeros(self.n, dtype=np.int64)
        self._saves = can_be_put_back(self._env)
        self._action_shape = tuple(self._env.single_action_space.shape or ())
        self._observations = np.zeros((self.n, *(self._env.single_observation_space.shape or ())))
        self._initial_memory = _copied(self._controller.init(self.n))
        self._memory = _copied(self._initial_memory)
        self._needs_reset = np.ones(self.n, dtype=bool)
        self._steps = np.zeros(self.n, dtype=np.int64)  # since the start of the episode
        self._everyone = np.arange(self.n)
        self._penalty = task.failure_penalty
        self._failed = np.zeros(self.n, dtype=bool)  # lanes whose controller failed at this step
        # One contiguous row of n values per parameter.
        self._values = np.zeros((len(self._space.names), self.n))
        self._parameters = dict(zip(self._space.names, self._values, strict=True))

    def rollout(self, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run all proposals; return their segments in the same order.

        Raises:
            ControllerError: If the controller raises or returns unusable actions, unless the task
                has a `failure_penalty`: then that step ends the episode and costs so much.
        """
        values = self._space.values(np.stack([p.z for p in proposals])) if proposals else None
        queues: list[deque[int]] = [deque() for _ in range(self.n)]
        for index, proposal in enumerate(proposals):
            queues[self._row_of[proposal.lane]].append(index)
        running: list[_Running | None] = [None] * self.n
        remaining = np.full(self.n, -1, dtype=np.int64)
        active = np.zeros(self.n, dtype=bool)
        record = Recording(self.n, self._observations.shape[1:], self._action_shape)
        segments: list[Segment | None] = [None] * len(proposals)

        def begin(lane: int) -> None:
            active[lane] = bool(queues[lane])
            running[lane] = None
            if not active[lane]:
                return
            index = queues[lane].popleft()
            assert values is not None
            self._values[:, lane] = values[index]
            running[lane] = self._stand(lane, index, proposals[index], record.rows)
            horizon = proposals[index].horizon
            remaining[lane] = -1 if horizon is None else horizon

        for lane in range(self.n):
            begin(lane)
        while active.any():
            everyone = bool(active.all())
            self._failed[:] = False
            actions, diagnostics = self._act(None if everyone else np.flatnonzero(active))
            before = self._observations
            self._observations, _, terminated, truncated, infos = self._env.step(
                actions, None if everyone else active
            )
            costs = infos["cost"]
            if self._failed.any():
                terminated, truncated = terminated | self._failed, truncated & ~self._failed
                costs = np.where(self._failed, self._penalty, costs)
            record.append(before, actions, costs, diagnostics)
            self._steps += active
            remaining -= 1
            over = (terminated | truncated | (remaining == 0)) & active
            if not over.any():
                continue
            for lane in np.flatnonzero(over).tolist():
                run = running[lane]
                assert run is not None
                ended, cut = bool(terminated[lane]), bool(truncated[lane])
                segments[run.index] = Segment(
                    proposal=proposals[run.index],
                    terminated=ended,
                    truncated=cut,
                    starts_episode=run.starts_episode,
                    **record.cut(run.first_row, lane, self._observations[lane]),
                )
                self._needs_reset[lane] = ended or cut
                if run.resume is not None:
                    self._put_back(lane, run.resume)
                elif proposals[run.index].seed is not None:
                    self._needs_reset[lane] = True
                begin(lane)
        return [segment for segment in segments if segment is not None]

    def _stand(self, lane: int, index: int, proposal: Proposal, row: int) -> _Running:
        """Bring `lane` to where `proposal` starts."""
        resume = None
        if proposal.seed is not None:
            if self._saves:
                resume = self._snapshot(lane)
            else:
                self._begin_anew(lane)
            self._reset(lane, proposal.seed)
        else:
            whole_episode = proposal.horizon is None and self._steps[lane] > 0
            if self._needs_reset[lane] or whole_episode:
                self._reset(lane, self._first_seeds[lane])
                self._first_seeds[lane] = None
            if proposal.branch:
                resume = self._snapshot(lane)
        return _Running(index, row, proposal.horizon, bool(self._steps[lane] == 0), resume)

    def _begin_anew(self, lane: int) -> None:
        """Have `lane`, which cannot be put back, start an episode of its own the next time."""
        self._restarts[lane] += 1
        seed = stream_seed(self._seeds[lane], "restart", int(self._restarts[lane]))
        self._first_seeds[lane] = seed

    def _reset(self, lane: int, seed: int | None) -> None:
        mask = np.zeros(self.n, dtype=bool)
        mask[lane] = True
        seeds: list[int | None] = [None] * self.n
        seeds[lane] = seed
        observations, _ = self._env.reset(seed=seeds, options={"reset_mask": mask})
        self._observations = self._observations.copy()
        self._observations[lane] = observations[lane]
        self._set_memory(lane, {k: v[lane] for k, v in self._initial_memory.items()})
        self._needs_reset[lane] = False
        self._steps[lane] = 0

    def _set_memory(self, lane: int, row: Mapping[str, np.ndarray]) -> None:
        self._memory = _copied(self._memory)
        for name, value in row.items():
            self._memory[name][lane] = value

    def _act(self, lanes: np.ndarray | None) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        """Return actions (n, m) and diagnostics; only `lanes` act, if given."""
        if lanes is None:
            actions, memory, diagnostics = self._call(
                self._parameters, self._observations, self._memory, self._everyone
            )
            self._memory = dict(memory)
            return actions, diagnostics
        some, memory, some_diagnostics = self._call(
            {name: value[lanes] for name, value in self._parameters.items()},
            self._observations[lanes],
            {name: value[lanes] for name, value in self._memory.items()},
            lanes,
        )
        self._memory = _copied(self._memory)
        for name, rows in memory.items():
            self._memory[name][lanes] = rows
        actions = np.zeros((self.n, *self._action_shape))
        actions[lanes] = some
        return actions, {name: _scatter(v, lanes, self.n) for name, v in some_diagnostics.items()}

    def _call(
        self,
        parameters: Mapping[str, np.ndarray],
        observations: np.ndarray,
        memory: Mapping[str, np.ndarray],
        lanes: np.ndarray,
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray], Mapping[str, np.ndarray]]:
        """Ask the controller; with a penalty, a lane whose controller fails acts with zero."""
        try:
            return self._checked_call(parameters, observations, memory, lanes)
        except ControllerError:
            if self._penalty is None:
                raise
            if len(lanes) == 1:
                self._failed[lanes] = True
                return np.zeros((1, *self._action_shape)), memory, {}
        # Which lane it was is seen by asking one at a time.
        parts = []
        for row in range(len(lanes)):
            one = slice(row, row + 1)
            parts.append(
                self._call(
                    {name: value[one] for name, value in parameters.items()},
                    observations[one],
                    {name: value[one] for name, value in memory.items()},
                    lanes[one],
                )
            )
        return _joined(parts)

    def _checked_call(
        self,
        parameters: Mapping[str, np.ndarray],
        observations: np.ndarray,
        memory: Mapping[str, np.ndarray],
        lanes: np.ndarray,
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray], Mapping[str, np.ndarray]]:
        """Ask the controller, and see that its actions can be used."""
        try:
            actions, memory, diagnostics = self._controller.act(parameters, observations, memory)
        except ZoacError:
            raise
        except Exception as error:
            raise ControllerError(
                f"the controller raised {type(error).__name__}: {error}. {self._place(lanes[0])}"
            ) from error
        actions = np.asarray(actions, dtype=np.float64)
        expected = (len(lanes), *self._action_shape)
        if actions.shape != expected:
            raise ControllerError(
                f"the controller returned actions of shape {actions.shape}, expected {expected} "
                "(lanes, action size)"
            )
        finite = np.isfinite(actions)
        if not finite.all():
            row = int(np.flatnonzero(~finite.reshape(len(lanes), -1).all(axis=1))[0])
            raise ControllerError(
                f"the controller returned the action {actions[row].tolist()}; every number must "
                f"be finite. {self._place(lanes[row])}"
            )
        return actions, memory, diagnostics

    def _place(self, lane: int) -> str:
        """Say for an error message where a lane stands."""
        values = ", ".join(f"{name}={v[lane]:.6g}" for name, v in self._parameters.items())
        return (
            f"Lane {self._lane_ids[lane]}, step {self._steps[lane]} of its episode, "
            f"parameters: {values}"
        )

    def _snapshot(self, lane: int) -> dict[str, Any]:
        return {
            "env": self._env.state([lane]),
            "observation": self._observations[lane].copy(),
            "memory": {name: deepcopy(value[lane]) for name, value in self._memory.items()},
            "steps": int(self._steps[lane]),
            "needs_reset": bool(self._needs_reset[lane]),
        }

    def _put_back(self, lane: int, snapshot: Mapping[str, Any]) -> None:
        self._env.restore([lane], snapshot["env"])
        self._observations = self._observations.copy()
        self._observations[lane] = snapshot["observation"]
        self._set_memory(lane, snapshot["memory"])
        self._steps[lane] = snapshot["steps"]
        self._needs_reset[lane] = snapshot["needs_reset"]

    def state(self) -> dict[int, Any]:
        """Return a picklable copy of every lane's state, by lane id."""
        return {
            lane_id: {**self._snapshot(row), "first_seed": self._first_seeds[row]}
            for lane_id, row in self._row_of.items()
        }

    def restore(self, state: Mapping[int, Any]) -> None:
        """Put back the lanes of `state` that belong to this group; others are left out."""
        for lane_id, row in self._row_of.items():
            self._put_back(row, state[lane_id])
            self._first_seeds[row] = state[lane_id]["first_seed"]

    def close(self) -> None:
        """Release the environment."""
        self._env.close()


def _joined(
    parts: Sequence[tuple[np.ndarray, Mapping[str, np.ndarray], Mapping[str, np.ndarray]]],
) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return what lanes answered one by one; diagnostics are zero where one failed."""
    actions = np.concatenate([a for a, _, _ in parts])
    memory = {name: np.concatenate([m[name] for _, m, _ in parts]) for name in parts[0][1]}
    examples = {name: np.asarray(value) for _, _, d in parts for name, value in d.items()}
    diagnostics = {
        name: np.concatenate([np.asarray(d.get(name, np.zeros_like(v))) for _, _, d in parts])
        for name, v in examples.items()
    }
    return actions, memory, diagnostics


def _copied(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.array(value) for name, value in arrays.items()}


def _scatter(rows: np.ndarray, lanes: np.ndarray, n: int) -> np.ndarray:
    rows = np.asarray(rows)
    full = np.zeros((n, *rows.shape[1:]), rows.dtype)
    full[lanes] = rows
    return full
