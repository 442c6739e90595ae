"""The structured solver: exact, batched over lanes, microseconds a problem (`docs/solver.md`)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from zoac.errors import ConfigError
from zoac.mpc.solvers._riccati_kernel import solve_lanes
from zoac.mpc.solvers.base import LinearisedProblem, Solution, Sparsity
from zoac.numbers import Count

_VECTOR = 4  # a row is a whole number of these


@lru_cache(maxsize=32)
def _pattern(sparsity: Sparsity | None, nx: int, nu: int) -> tuple[tuple[int | None, ...], ...]:
    """Return [A B]'s rows, None where an entry is always zero: compiled code knows it as a type."""
    if sparsity is None:
        return ((0,) * (nx + nu),) * nx
    rows = np.hstack([sparsity.a, sparsity.b]).tolist()
    return tuple(tuple(0 if entry else None for entry in row) for row in rows)


class Riccati:
    """Solve box-constrained linear-quadratic problems of any size by Riccati recursions.

    Cost grows linearly with the horizon and cubically with states and inputs. A lane's plan
    depends on that lane's data alone, to the bit. The first solve with new numbers of states
    and inputs, or a new pattern of zeros, compiles for up to half a minute; the result is kept
    on disk.
    """

    screens = True

    def __init__(
        self,
        sweeps: Count = 6,
        max_active_set_steps: Count = 1000,
    ) -> None:
        """
        Args:
            sweeps: Clipped sweeps tried before the interior-point method takes over.
            max_active_set_steps: Limit of the active-set method that ends the solve.
        """
        self.sweeps = sweeps
        self.max_active_set_steps = max_active_set_steps

    def solve(self, problem: LinearisedProblem, careful: bool = False) -> Solution:
        """Solve the n problems.

        Status SOLVED means that the plan was certified: with the objective's gradient g, computed
        anew by the adjoint equation, every |u - clip(u - g / d)| is below 1e-7 of that input's
        range, d being the curvature in that input when all later ones respond; or below 1e-9,
        d being the curvature when none does. A lane whose data are not finite, or that fails
        numerically, keeps the rollout's inputs.

        Args:
            problem: What to solve. Input bounds may be infinite, or equal to pin an input.
            careful: Leave out the sweeps: interior point and active set at once.

        Raises:
            ConfigError: If a bound is NaN or the lower bound of an input exceeds the upper.
        """
        lanes, horizon, nx, nu = problem.b.shape
        width = -(-(nx + nu) // _VECTOR) * _VECTOR
        plans = np.empty((lanes, horizon, nu))
        status = np.empty(lanes, np.int8)
        iterations = np.empty(lanes, np.int64)
        data = (
            problem.states,
            problem.inputs,
            problem.a,
            problem.b,
            problem.reference,
            problem.state_weights,
            problem.input_weights,
        )
        sizes = ((0,) * nx, (0,) * nu, (0,) * width, _pattern(problem.sparsity, nx, nu))
        ordered = solve_lanes(
            data, problem.input_low, problem.input_high, sizes, careful, self.sweeps,
            self.max_active_set_steps, plans, status, iterations,
        )  # fmt: skip
        if not ordered:
            raise ConfigError(
                "input bounds must be numbers in order, got "
                f"low {problem.input_low.tolist()}, high {problem.input_high.tolist()}"
            )
        return Solution(plans, status, iterations)
