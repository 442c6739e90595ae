"""Clarabel, fed with numbers only: CVXPY canonicalises the problem once, not at every solve.

CVXPY's canonical form of a parameterised problem is linear in the parameters:
Clarabel's data (P, A, b) = map @ (parameters, 1), with a constant sparse `map`. A solve is that
product, an update of Clarabel's data in place, and Clarabel's own solve.
"""

from __future__ import annotations

from typing import Annotated, Any

import clarabel
import cvxpy as cp
import numpy as np
import scipy.sparse as sparse
from pydantic import Field

from zoac.mpc.solvers.base import LinearisedProblem, Solution, Status
from zoac.mpc.solvers.statement import Layout, parameter_values, state_problem

_STATUS = {
    "Solved": Status.SOLVED,
    "AlmostSolved": Status.INACCURATE,
    "InsufficientProgress": Status.INACCURATE,
    "MaxIterations": Status.ITERATION_LIMIT,
}


class ClarabelSolver:
    """The default solver: an interior-point method, one lane after the other.

    The numbers that Clarabel scales the problem by are computed when its solver object is made,
    and an update keeps them. So the object is made from data that depend on the layout alone:
    what it returns does not depend on what it solved before.

    Args:
        tolerance: On the duality gap and the residuals.
        max_iterations: Limit on interior-point iterations.
        step_fraction: How far towards the boundary of the cone a step may go. A careful solve
            takes Clarabel's default, 0.99, and refines its linear solves.
    """

    def __init__(
        self,
        tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-10,
        max_iterations: Annotated[int, Field(ge=1)] = 200,
        step_fraction: Annotated[float, Field(gt=0, lt=1)] = 0.999,
    ) -> None:
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self.step_fraction = step_fraction
        self._forms: dict[Layout, _CanonicalForm] = {}
        self._solvers: dict[tuple[Layout, bool], Any] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        # Clarabel's objects cannot be pickled; the copy makes its own.
        return type(self), (self.tolerance, self.max_iterations, self.step_fraction)

    def solve(self, problem: LinearisedProblem, careful: bool = False) -> Solution:
        """Solve the n problems; see `Solver`."""
        layout = Layout.of(problem)
        form, solver = self._prepared(layout, careful)
        n, horizon, nu = problem.inputs.shape
        plans = np.empty((n, nu, horizon))
        status = np.empty(n, dtype=np.int8)
        iterations = np.empty(n, dtype=np.int64)
        # Lists: Clarabel reads its data number by number, from arrays at twice the cost.
        data = [piece.tolist() for piece in form.data(problem)]
        for lane, (p, a, b) in enumerate(zip(*data, strict=True)):
            solver.update(P=p, A=a, b=b)
            answer = solver.solve()
            plans[lane].flat = answer.x[form.inputs]
            status[lane] = _STATUS.get(str(answer.status), Status.NUMERICAL_FAILURE)
            iterations[lane] = answer.iterations
        inputs = np.clip(plans.transpose(0, 2, 1), problem.input_low, problem.input_high)
        return Solution(np.ascontiguousarray(inputs), status, iterations)

    def _prepared(self, layout: Layout, careful: bool) -> tuple[_CanonicalForm, Any]:
        if layout not in self._forms:
            self._forms[layout] = _CanonicalForm(layout)
        form = self._forms[layout]
        key = (layout, careful)
        if key not in self._solvers:
            self._solvers[key] = form.make_solver(self._settings(careful))
        return form, self._solvers[key]

    def _settings(self, careful: bool) -> Any:
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        settings.presolve_enable = False  # would refuse updates after removing a row
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self.tolerance
        settings.max_iter = self.max_iterations
        # Refinement costs a third of the time and gains nothing on this sparse form.
        settings.iterative_refinement_enable = careful
        if not careful:
            settings.max_step_fraction = self.step_fraction
        return settings


class _CanonicalForm:
    """CVXPY's canonical form of the problem for one layout, read once.

    Clarabel's form is: minimise x'Px/2 + q'x subject to Ax + s = b, s in a product of cones.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        statement = state_problem(layout)
        statement.dynamics.value = np.ones(layout.dynamics_size)
        statement.weights.value = np.ones(layout.weights_size)
        data, _, _ = statement.problem.get_problem_data(cp.CLARABEL, solver_opts={})
        program = data["param_prob"]
        column = program.param_id_to_col
        self._dynamics = slice(column[statement.dynamics.id], None)
        self._weights = slice(column[statement.weights.id], None)
        # The columns of [A | b], b last, share one sparse pattern; CVXPY's A is minus Clarabel's.
        rows, starts, (self._rows, columns) = program.reduced_A.problem_data_index
        variables = columns - 1
        entries = starts[variables]
        self._a_pattern = (rows[:entries], starts[:columns])
        self._p_pattern = program.reduced_P.problem_data_index[:2]
        map_ab = sparse.csr_array(program.reduced_A.reduced_mat)
        map_p = sparse.csr_array(program.reduced_P.reduced_mat)
        place = sparse.csr_array(
            (np.ones(len(rows) - entries), (rows[entries:], np.arange(len(rows) - entries))),
            shape=(self._rows, len(rows) - entries),
        )
        self._map = sparse.vstack([map_p, -map_ab[:entries], place @ map_ab[entries:]], "csr")
        self._cuts = np.cumsum([map_p.shape[0], entries])
        self._variables = variables
        self._cones = [
            clarabel.ZeroConeT(data["dims"].zero),
            clarabel.NonnegativeConeT(data["dims"].nonneg),
        ]
        first = program.var_id_to_col[statement.inputs.id]
        self.inputs = slice(first, first + layout.horizon * layout.nu)
        """Where the inputs stand in x: component by component, each over the horizon."""

    def data(self, problem: LinearisedProblem) -> list[np.ndarray]:
        """Return the nonzeros of P and of A, and b, each with n rows."""
        return self._data(*parameter_values(problem, self._layout))

    def _data(self, dynamics: np.ndarray, weights: np.ndarray) -> list[np.ndarray]:
        parameters = np.ones((self._map.shape[1], len(dynamics)))
        parameters[self._dynamics][: dynamics.shape[1]] = dynamics.T
        parameters[self._weights][: weights.shape[1]] = weights.T
        return np.split((self._map @ parameters).T, self._cuts, axis=1)

    def make_solver(self, settings: Any) -> Any:
        """Return a Clarabel solver whose scaling depends on the layout alone."""
        dynamics = np.ones((1, self._layout.dynamics_size))
        weights = np.full((1, self._layout.weights_size), 0.1)
        p, a, b = (piece[0] for piece in self._data(dynamics, weights))
        square = (self._variables, self._variables)
        tall = (self._rows, self._variables)
        return clarabel.DefaultSolver(
            sparse.csc_matrix((p, *self._p_pattern[:2]), shape=square),
            np.zeros(self._variables),
            sparse.csc_matrix((a, *self._a_pattern), shape=tall),
            b,
            self._cones,
            settings,
        )
