"""The rollout engine: the only place where an environment is stepped."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.errors import ControllerError, EnvironmentFailure, UnsavableError, ZoacError, suggest
from zoac.live_controller import LiveController, state_of
from zoac.recording import Recording
from zoac.seeding import stream_seed
from zoac.segments import Proposal, Segment
from zoac.state import OwnObject

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
        self._task = task
        self._told = False  # that a lane could not be copied
        self._action_shape = tuple(self._env.single_action_space.shape or ())
        self._observations = np.zeros((self.n, *(self._env.single_observation_space.shape or ())))
        self._initial_memory = _copied(self._controller.init(self.n))
        self._memory = _copied(self._initial_memory)
        self._needs_reset = np.ones(self.n, dtype=bool)
        self._steps = np.zeros(self.n, dtype=np.int64)  # since the start of the episode
        self._everyone = np.arange(self.n)
        self._penalty = task.failure_penalty
        self._parameter_names = (*self._space.names, *task.fixed)
        self._failures: dict[int, str] = {}  # why lanes fail at this step
        self._not_begun: dict[int, str] = {}  # why lanes could not begin their episode
        # One contiguous row of n values per parameter.
        self._values = np.zeros((len(self._space.names), self.n))
        self._parameters = dict(zip(self._space.names, self._values, strict=True))

    def rollout(self, proposals: Sequence[Proposal]) -> list[Segment]:
        """Run all proposals; return their segments in the same order.

        Raises:
            ControllerError: If the controller raises or returns unusable actions.
            EnvironmentFailure: If the environment raises or returns what is not finite. Where the
                task has a `failure_penalty`, either ends the episode instead, and that step costs
                so much.
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
            before = self._observations
            actions, commands, costs, terminated, truncated, diagnostics = self._advance(active)
            record.append(before, actions, commands, costs, diagnostics)
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
                    failure=self._failures.get(lane),
                    **record.cut(run.first_row, lane, self._observations[lane]),
                )
                self._needs_reset[lane] = ended or cut
                if ended or cut:
                    self._begin_controller(lane)
                if run.resume is not None:
                    self._put_back(lane, run.resume)
                elif proposals[run.index].seed is not None:
                    self._needs_reset[lane] = True
                begin(lane)
        return [segment for segment in segments if segment is not None]

    def _advance(self, active: np.ndarray) -> tuple[Any, ...]:
        """Let controllers act and environments step where `active` (n,) holds; price failures.

        Returns:
            Actions and commands (n, m), costs, terminated and truncated (n,), and the controllers'
            diagnostics.
        """
        self._failures, self._not_begun = self._not_begun, {}
        moves = active.copy()
        moves[list(self._failures)] = False
        everyone = bool(moves.all())
        commands, diagnostics = self._act(None if everyone else np.flatnonzero(moves))
        before = self._observations
        self._observations, _, terminated, truncated, infos = self._env.step(
            commands, None if everyone else moves
        )
        costs, failures = infos["cost"], dict(infos.get("failures", {}))
        if self._penalty is not None:
            finite = np.isfinite(costs) & np.isfinite(self._observations.reshape(self.n, -1)).all(1)
            for lane in np.flatnonzero(moves & ~finite).tolist():
                self._observations[lane] = before[lane]
                failures[lane] = EnvironmentFailure(
                    "the environment returned an observation or a cost that is not finite"
                )
        for lane, failure in failures.items():
            self._begin_anew(lane)
            if lane not in self._failures:
                self._failures[lane] = self._priced(failure, f"{failure}. {self._place(lane)}")
        if self._failures:
            failed = np.zeros(self.n, dtype=bool)
            failed[list(self._failures)] = True
            terminated, truncated = terminated | failed, truncated & ~failed
            costs = np.where(failed, self._penalty, costs)
        actions = infos.get("actions", commands)
        return actions, commands, costs, terminated, truncated, diagnostics

    def _priced(self, failure: ZoacError, told: str) -> str:
        """Return what is told of a failure, if the task prices failures; else raise it.

        Raises:
            ControllerError: If the controller failed and there is no penalty.
            EnvironmentFailure: If the environment did.
        """
        if self._penalty is not None:
            return told
        raise type(failure)(f"{told}. {REMEDY}") from failure.__cause__

    def _stand(self, lane: int, index: int, proposal: Proposal, row: int) -> _Running:
        """Bring `lane` to where `proposal` starts."""
        resume = None
        if proposal.seed is not None:
            resume = self._copied_lane(lane)
            if resume is None:
                self._begin_anew(lane)
            self._reset(lane, proposal.seed)
        else:
            whole_episode = proposal.horizon is None and self._steps[lane] > 0
            if self._needs_reset[lane] or whole_episode:
                seed, self._first_seeds[lane] = self._first_seeds[lane], None
                self._reset(lane, seed)
            if proposal.branch:
                resume = self._copied_lane(lane)
        return _Running(index, row, proposal.horizon, bool(self._steps[lane] == 0), resume)

    def _begin_anew(self, lane: int) -> None:
        """Have `lane`, which failed or cannot be put back, start an episode of its own next."""
        self._restarts[lane] += 1
        seed = stream_seed(self._seeds[lane], "restart", int(self._restarts[lane]))
        self._first_seeds[lane] = seed

    def _reset(self, lane: int, seed: int | None) -> None:
        mask = np.zeros(self.n, dtype=bool)
        mask[lane] = True
        seeds: list[int | None] = [None] * self.n
        seeds[lane] = seed
        self._steps[lane] = 0
        observations, infos = self._env.reset(seed=seeds, options={"reset_mask": mask})
        if (failure := infos.get("failures", {}).get(lane)) is not None:
            self._not_begun[lane] = self._priced(failure, f"{failure}. {self._place(lane)}")
            self._begin_anew(lane)
        self._observations = self._observations.copy()
        self._observations[lane] = observations[lane]
        self._set_memory(lane, {k: v[lane] for k, v in self._initial_memory.items()})
        self._begin_controller(lane)
        self._needs_reset[lane] = lane in self._not_begun

    def _live(self, lane: int) -> dict[str, LiveController]:
        """Return the controller objects of a lane that change in place, by the memory's name."""
        rows = {name: value[lane] for name, value in self._initial_memory.items()}
        return {name: row for name, row in rows.items() if isinstance(row, LiveController)}

    def _begin_controller(self, lane: int) -> None:
        """Have a controller object that changes in place begin an episode; see `LiveController`."""
        for live in self._live(lane).values():
            live.begin()

    def _set_memory(self, lane: int, row: Mapping[str, np.ndarray]) -> None:
        self._memory = _copied(self._memory)
        for name, value in row.items():
            self._memory[name][lane] = value

    def _act(self, lanes: np.ndarray | None) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        """Return actions (n, m) and diagnostics; only `lanes` act, if given."""
        if lanes is not None and not len(lanes):
            return np.zeros((self.n, *self._action_shape)), {}
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
        # Which lane fails is seen by asking one at a time; twice only what cannot remember.
        if len(lanes) == 1 or not self._live(0):
            try:
                return self._checked_call(parameters, observations, memory, lanes)
            except ControllerError as error:
                raised = error.__cause__ is not None
                told = str(error) if raised and len(lanes) > 1 else self._priced(error, str(error))
                if len(lanes) == 1:
                    self._failures[int(lanes[0])] = told
                    return np.zeros((1, *self._action_shape)), memory, {}
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
                f"the controller raised {type(error).__name__}: {error}{self._nearest(error)}. "
                f"{self._place(lanes[0])}"
            ) from error
        actions = np.asarray(actions, dtype=np.float64)
        expected = (len(lanes), *self._action_shape)
        if actions.shape != expected:
            raise ControllerError(
                f"the controller returned actions of shape {actions.shape}, expected {expected} "
                f"(lanes, action size). {self._place(lanes[0])}"
            )
        finite = np.isfinite(actions)
        if not finite.all():
            row = int(np.flatnonzero(~finite.reshape(len(lanes), -1).all(axis=1))[0])
            raise ControllerError(
                f"the controller returned the action {actions[row].tolist()}; every number must "
                f"be finite. {self._place(lanes[row])}"
            )
        return actions, memory, diagnostics

    def _nearest(self, error: Exception) -> str:
        """Return which parameters there are, if a controller asked for one that there is not."""
        name = error.args[0] if isinstance(error, KeyError) and error.args else None
        if not isinstance(name, str) or name in self._parameter_names:
            return ""
        return f" (no parameter has this name; {suggest(name, self._parameter_names)})"

    def _place(self, lane: int) -> str:
        """Say for an error message where a lane stands."""
        values = ", ".join(f"{name}={v[lane]:.6g}" for name, v in self._parameters.items())
        return (
            f"Lane {self._lane_ids[lane]}, step {self._steps[lane]} of its episode, "
            f"parameters: {values}"
        )

    def _copied_lane(self, lane: int) -> dict[str, Any] | None:
        """Return a copy of a lane to put back later; None if it cannot be copied."""
        if self._task.restore_fault is not None:
            return None
        try:
            return self._snapshot(lane)
        except Exception as error:  # whatever a user's environment or controller raises
            if not self._told:
                self._told = True
                print(
                    f"a lane cannot be copied any more ({type(error).__name__}: {error}): it goes "
                    "on from where it stands, and held-out episodes begin anew",
                    file=sys.stderr,
                )
            return None

    def _snapshot(self, lane: int) -> dict[str, Any]:
        return {
            "env": self._env.state([lane]),
            "observation": self._observations[lane].copy(),
            "memory": {name: state_of(rows[lane]) for name, rows in self._memory.items()},
            "steps": int(self._steps[lane]),
            "needs_reset": bool(self._needs_reset[lane]),
            "first_seed": self._first_seeds[lane],
            "restarts": int(self._restarts[lane]),
        }

    def _put_back(self, lane: int, snapshot: Mapping[str, Any]) -> None:
        self._env.restore([lane], snapshot["env"])
        self._observations = self._observations.copy()
        self._observations[lane] = snapshot["observation"]
        row = dict(snapshot["memory"])
        live = self._live(lane)
        for name, value in row.items():
            if name in live:
                live[name].restore(value)
                row[name] = live[name]
            elif isinstance(value, OwnObject):
                row[name] = value.value
        self._set_memory(lane, row)
        self._steps[lane] = snapshot["steps"]
        self._needs_reset[lane] = snapshot["needs_reset"]
        self._first_seeds[lane] = snapshot["first_seed"]
        self._restarts[lane] = snapshot["restarts"]

    def state(self) -> dict[int, Any]:
        """Return a copy of every lane's state, by lane id; see `zoac.state`.

        Raises:
            UnsavableError: If the environment cannot be put back to where it stood.
        """
        if self._task.save_fault is not None:
            raise UnsavableError(self._task.save_fault)
        return {lane_id: self._snapshot(row) for lane_id, row in self._row_of.items()}

    def restore(self, state: Mapping[int, Any]) -> None:
        """Put back the lanes of `state` that belong to this group; others are left out."""
        for lane_id, row in self._row_of.items():
            memory = deepcopy(state[lane_id]["memory"])
            self._put_back(row, {**state[lane_id], "memory": memory})

    def close(self) -> None:
        """Release the environment."""
        self._env.close()


REMEDY = "With failure_penalty=<cost>, such a step ends its episode at that cost instead of the run"


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
