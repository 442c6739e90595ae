"""Tasks `mpc_tracking` and `mpc_tracking_reg`: tune an MPC that tracks a path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zoac.core.measures import Metric, Trace
from zoac.core.segments import Segment
from zoac.core.types import Count, NonNegative
from zoac.mpc.problem import Solver
from zoac.mpc.sqp import MpcOptions
from zoac.rollout.task import Task
from zoac.tasks.mpc_tracking.controller import NOMINAL, SPACE, TrackingMpc, WeightLayout
from zoac.tasks.mpc_tracking.plant import MpcTrackingVecEnv

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def prediction_error(segment: Segment) -> np.ndarray:
    """Return 0.5 |F_theta(X_t, U_t) - X_{t+1}|^2 for each step (T,)."""
    error = segment.diagnostics["prediction"] - segment.observations[1:, :6]
    return 0.5 * np.square(error).sum(axis=1)


class MpcTracking(Task):
    """19 parameters: six of the predictive model, thirteen weights."""

    space = SPACE
    baseline = NOMINAL
    metrics = (
        Metric("prediction_error", prediction_error),
        Metric("solver_failures", lambda s: s.diagnostics["solver_failed"], "sum"),
        Metric("solver_retries", lambda s: s.diagnostics["solver_retried"], "sum"),
    )

    def __init__(
        self,
        *,
        solver: Solver,
        mpc: MpcOptions | None = None,
        weights: WeightLayout = "separate",
        regularisation: NonNegative = 0.0,
        max_episode_steps: Count = 200,
    ) -> None:
        """
        Args:
            solver: Of the MPC's quadratic programmes.
            mpc: How the MPC plans.
            weights: Each of the 13 weights its own ("separate", the paper's text), or the input
                weights also the terminal x and y weights ("aliased", the authors' code).
            regularisation: zeta: the tuner sees r + zeta/2 |F_theta(X_t, U_t) - X_{t+1}|^2.
            max_episode_steps: Time limit.
        """
        self._solver = solver
        self._mpc = mpc or MpcOptions()
        self._weights = weights
        self._regularisation = regularisation
        self._max_episode_steps = max_episode_steps
        self.make_controller()  # says what is wrong with the options

    def make_env(self, n: int) -> MpcTrackingVecEnv:
        """Return `n` vehicles; their observations show as far ahead as the MPC looks."""
        return MpcTrackingVecEnv(
            n, horizon=self._mpc.horizon, max_episode_steps=self._max_episode_steps
        )

    def make_controller(self) -> TrackingMpc:
        return TrackingMpc(self._solver, self._mpc, self._weights)

    def tuning_costs(self, segment: Segment) -> np.ndarray:
        """Return the costs (T,) with the regularisation added."""
        if self._regularisation == 0.0:
            return segment.costs
        return segment.costs + self._regularisation * prediction_error(segment)

    def traces(self, segment: Segment) -> list[Trace]:
        """Return what Fig. 6 shows."""
        from zoac.tasks.mpc_tracking.figures import traces

        return traces(segment)

    def draw(self, axes: Axes, segment: Segment, step: int) -> bool:
        """Draw the vehicle on its path."""
        from zoac.tasks.mpc_tracking.figures import draw

        steering = float(segment.actions[max(step - 1, 0), 0])
        draw(axes, segment.observations[: step + 1, :6], steering)
        return True
