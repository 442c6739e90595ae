"""CVXPY's own `problem.solve()`: the plain reference that faster paths are tested against."""

from __future__ import annotations

import warnings
from typing import Any

import cvxpy as cp
import numpy as np

from zoac.core.types import Count, Fraction
from zoac.mpc.formulation import Formulation, Layout, build_problem, write_parameters
from zoac.mpc.problem import LinearisedProblem, Solution, Status
from zoac.mpc.solvers.certificate import certified
from zoac.mpc.solvers.scaling import units

_STATUS = {
    cp.OPTIMAL: Status.SOLVED,
    cp.OPTIMAL_INACCURATE: Status.INACCURATE,
    cp.USER_LIMIT: Status.ITERATION_LIMIT,
}


class CvxpySolver:
    """Solve `zoac.mpc.formulation` by CVXPY with Clarabel; a layout is compiled once.

    Args:
        tolerance: On the duality gap and the residuals.
        max_iterations: Limit on interior-point iterations.
    """

    screens = False

    def __init__(
        self,
        tolerance: Fraction = 1e-10,
        max_iterations: Count = 200,
    ) -> None:
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self._formulations: dict[Layout, Formulation] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        # A compiled CVXPY problem is large; the copy compiles its own.
        return type(self), (self.tolerance, self.max_iterations)

    def solve(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        """Solve the n problems; see `Solver`. A robust solve allows ten times the iterations."""
        layout = Layout.of(problem)
        if layout not in self._formulations:
            self._formulations[layout] = build_problem(layout)
        formulation = self._formulations[layout]
        inputs = np.zeros_like(problem.inputs)
        status = np.empty(len(inputs), dtype=np.int8)
        iterations = np.zeros(len(inputs), dtype=np.int64)
        dynamics = np.empty((len(inputs), layout.dynamics_size))
        weights = np.empty((len(inputs), layout.weights_size))
        scale = units(problem, always=robust)
        write_parameters(problem, layout, scale, dynamics, weights)
        for env_index in range(len(inputs)):
            formulation.dynamics.value = dynamics[env_index]
            formulation.weights.value = weights[env_index]
            status[env_index] = self._solve_one(formulation.problem, robust)
            if status[env_index] != Status.NUMERICAL_FAILURE:
                inputs[env_index] = formulation.inputs.value
                iterations[env_index] = formulation.problem.solver_stats.num_iters
        inputs *= scale.inputs[:, None]
        np.clip(inputs, problem.input_low, problem.input_high, out=inputs)
        return certified(problem, Solution(inputs, status, iterations))

    def _solve_one(self, problem: cp.Problem, robust: bool) -> Status:
        tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), self.tolerance)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the status says it
            try:
                problem.solve(
                    solver=cp.CLARABEL,
                    # A warm start would keep the solver, and with it the last problem's scaling.
                    warm_start=False,
                    max_iter=self.max_iterations * (10 if robust else 1),
                    **tolerances,
                )
            except cp.SolverError:
                return Status.NUMERICAL_FAILURE
        return _STATUS.get(problem.status, Status.NUMERICAL_FAILURE)
