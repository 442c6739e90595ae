"""CVXPY's own `problem.solve()`: the plain reference that faster paths are tested against."""

from __future__ import annotations

import warnings
from typing import Any

import cvxpy as cp
import numpy as np

from zoac.mpc.solvers.base import LinearisedProblem, Solution, Status
from zoac.mpc.solvers.certificate import certified
from zoac.mpc.solvers.scaling import units
from zoac.mpc.solvers.statement import Layout, Statement, state_problem, write_parameters
from zoac.numbers import Count, Share

_STATUS = {
    cp.OPTIMAL: Status.SOLVED,
    cp.OPTIMAL_INACCURATE: Status.INACCURATE,
    cp.USER_LIMIT: Status.ITERATION_LIMIT,
}


class CvxpySolver:
    """The stated problem, solved by CVXPY with Clarabel, built once and given new numbers.

    Args:
        tolerance: On the duality gap and the residuals.
        max_iterations: Limit on interior-point iterations.
    """

    screens = False

    def __init__(
        self,
        tolerance: Share = 1e-10,
        max_iterations: Count = 200,
    ) -> None:
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self._statements: dict[Layout, Statement] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        # A compiled CVXPY problem is large; the copy compiles its own.
        return type(self), (self.tolerance, self.max_iterations)

    def solve(self, problem: LinearisedProblem, careful: bool = False) -> Solution:
        """Solve the n problems; see `Solver`. A careful solve allows ten times the iterations."""
        layout = Layout.of(problem)
        if layout not in self._statements:
            self._statements[layout] = state_problem(layout)
        statement = self._statements[layout]
        inputs = np.zeros_like(problem.inputs)
        status = np.empty(len(inputs), dtype=np.int8)
        iterations = np.zeros(len(inputs), dtype=np.int64)
        dynamics = np.empty((len(inputs), layout.dynamics_size))
        weights = np.empty((len(inputs), layout.weights_size))
        scale = units(problem, always=careful)
        write_parameters(problem, layout, scale, dynamics, weights)
        for lane in range(len(inputs)):
            statement.dynamics.value = dynamics[lane]
            statement.weights.value = weights[lane]
            status[lane] = self._solve_one(statement.problem, careful)
            if status[lane] != Status.NUMERICAL_FAILURE:
                inputs[lane] = statement.inputs.value
                iterations[lane] = statement.problem.solver_stats.num_iters
        inputs *= scale.inputs[:, None]
        np.clip(inputs, problem.input_low, problem.input_high, out=inputs)
        return certified(problem, Solution(inputs, status, iterations))

    def _solve_one(self, problem: cp.Problem, careful: bool) -> Status:
        tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), self.tolerance)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the status says it
            try:
                problem.solve(
                    solver=cp.CLARABEL,
                    # A warm start would keep the solver, and with it the last problem's scaling.
                    warm_start=False,
                    max_iter=self.max_iterations * (10 if careful else 1),
                    **tolerances,
                )
            except cp.SolverError:
                return Status.NUMERICAL_FAILURE
        return _STATUS.get(problem.status, Status.NUMERICAL_FAILURE)
