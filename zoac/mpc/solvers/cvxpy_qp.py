"""CVXPY's own `problem.solve()`: the plain reference that faster paths are tested against."""

import warnings
from typing import Any, ClassVar

import cvxpy as cp
import numpy as np

from zoac.core.types import Count, Fraction
from zoac.mpc.formulation import CANON_BACKEND, Formulation, Layout, build_problem
from zoac.mpc.problem import LinearisedProblem, Solution, Status
from zoac.mpc.solvers.certificate import certified
from zoac.mpc.solvers.parameters import write_parameters
from zoac.mpc.solvers.scaling import units

_STATUS = {
    cp.OPTIMAL: Status.SOLVED,
    cp.OPTIMAL_INACCURATE: Status.INACCURATE,
    cp.USER_LIMIT: Status.ITERATION_LIMIT,
    cp.INFEASIBLE: Status.INFEASIBLE,
    cp.INFEASIBLE_INACCURATE: Status.INFEASIBLE,
}


class CvxpySolver:
    """Solve `zoac.mpc.formulation` by CVXPY with Clarabel; a layout is compiled once.

    Args:
        tolerance: On the duality gap and the residuals.
        max_iterations: Limit on interior-point iterations.
    """

    screens: ClassVar[bool] = False
    bounds_states: ClassVar[bool] = True

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
        parameters = formulation.parameters
        ends = np.cumsum([parameter.size for parameter in parameters.values()]).tolist()
        starts = dict(zip(parameters, [0, *ends], strict=False))
        values = np.empty((len(inputs), ends[-1]))
        scale = units(problem, always=robust)
        scales = write_parameters(problem, layout, scale, values, starts)
        bounded = layout.bounds_size > 0
        multipliers = np.zeros((*inputs.shape[:2], layout.nx)) if bounded else None
        for env_index in range(len(inputs)):
            for name, parameter in parameters.items():
                start = starts[name]
                parameter.value = values[env_index, start : start + parameter.size]
            status[env_index] = self._solve_one(formulation.problem, robust)
            if status[env_index] in (Status.NUMERICAL_FAILURE, Status.INFEASIBLE):
                continue
            inputs[env_index] = formulation.inputs.value
            iterations[env_index] = formulation.problem.solver_stats.num_iters
            if multipliers is not None:
                of_states = layout.state_low + layout.state_high
                low, high = formulation.of_bounds
                signed = [-c.dual_value for c in low] + [c.dual_value for c in high]
                for i, dual in zip(of_states, signed, strict=True):
                    unit = scale.states[env_index, i] * scales[env_index]
                    multipliers[env_index, :, i] += dual / unit
        inputs *= scale.inputs[:, None]
        np.clip(inputs, problem.input_low, problem.input_high, out=inputs)
        return certified(problem, Solution(inputs, status, iterations), multipliers)

    def _solve_one(self, problem: cp.Problem, robust: bool) -> Status:
        tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), self.tolerance)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the status says it
            try:
                problem.solve(
                    solver=cp.CLARABEL,
                    canon_backend=CANON_BACKEND,
                    # A warm start would keep the solver, and with it the last problem's scaling.
                    warm_start=False,
                    max_iter=self.max_iterations * (10 if robust else 1),
                    **tolerances,
                )
            except cp.SolverError:
                return Status.NUMERICAL_FAILURE
        return _STATUS.get(problem.status, Status.NUMERICAL_FAILURE)
