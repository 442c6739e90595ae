"""What a tuner asks for and what it is told: proposals and segments.

A proposal carries its horizon, so that segments of N steps in mid-episode (ZOAC) and whole
episodes from reset (Bayesian optimisation, CMA-ES, evaluation) go through one engine and are
paid for in one coin, environment steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True, eq=False, slots=True)
class Proposal:
    """Parameters for an environment, and for how long.

    Args:
        x: Mapped parameters (d,); clipped to [-1, 1] where they are mapped.
        env_index: The environment that runs it. An environment runs its proposals in the order
            given.
        horizon: Steps to run from the environment's present state, fewer if the episode ends; None:
            one whole episode, from its start.
        restore: Run, then restore the environment to its state before.
        seed: Begin a new episode from this seed (evaluation, common random numbers). The
            environment is restored afterwards, so its own random stream is not touched.
    """

    x: np.ndarray
    env_index: int
    horizon: int | None = None
    restore: bool = False
    seed: int | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Segment:
    """What came back for one proposal: T steps of one episode.

    Args:
        proposal: The proposal that was run.
        observations: (T + 1, o); the last one is where the segment ended.
        actions: What the environment applied, (T, m): clipped, rounded and cast as it does.
        commands: What the controller returned, (T, m).
        costs: (T,).
        terminated: The episode ended by itself: what follows costs nothing more.
        truncated: The episode was cut at its time limit: what follows would have cost more.
        starts_episode: The first observation is the start of an episode.
        diagnostics: The controller's, by name, T rows each.
        failure: Why the last step failed, if controller or environment did: that step costs the
            task's `failure_penalty` and was not measured.
        reported_costs: (T,) plain costs, where `costs` are what a tuner is told; None: the same.
        violation: By how much constraints were exceeded, over all steps; 0 where all hold. See
            `zoac.rollout.constraints`.
        spec_values: The value of each of the task's specs, if this is a whole episode and the task
            has any.
    """

    proposal: Proposal
    observations: np.ndarray
    actions: np.ndarray
    commands: np.ndarray
    costs: np.ndarray
    terminated: bool
    truncated: bool
    starts_episode: bool
    diagnostics: Mapping[str, np.ndarray] = field(default_factory=dict)
    failure: str | None = None
    reported_costs: np.ndarray | None = None
    violation: float = 0.0
    spec_values: tuple[float, ...] | None = None

    @property
    def length(self) -> int:
        """Number of steps T."""
        return len(self.costs)

    @property
    def plain_costs(self) -> np.ndarray:
        """Costs (T,) without regularisation or penalties: what results report and compare."""
        return self.costs if self.reported_costs is None else self.reported_costs

    def measured(self) -> Segment:
        """Return the segment without the step that failed, if one did."""
        if self.failure is None:
            return self
        return replace(
            self,
            observations=self.observations[:-1],
            actions=self.actions[:-1],
            commands=self.commands[:-1],
            costs=self.costs[:-1],
            reported_costs=None if self.reported_costs is None else self.reported_costs[:-1],
            diagnostics={name: rows[:-1] for name, rows in self.diagnostics.items()},
            terminated=False,
            failure=None,
        )

    def with_costs(self, costs: np.ndarray) -> Segment:
        """Return the same segment with other costs (T,)."""
        return replace(self, costs=costs)
