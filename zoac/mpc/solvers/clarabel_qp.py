"""Clarabel, fed with numbers only: CVXPY canonicalises the problem once, not at every solve.

CVXPY's canonical form of a parameterised problem is linear in the parameters:
Clarabel's data (P, A, b) = map @ (parameters, 1), with a constant sparse `map`. A solve is that
product, an update of Clarabel's data in place, and Clarabel's own solve.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from typing import Any, ClassVar

import clarabel
import cvxpy as cp
import numpy as np
import scipy.sparse as sparse

from zoac.core.types import Count, Fraction
from zoac.mpc.formulation import CANON_BACKEND, Layout, build_problem
from zoac.mpc.problem import LinearisedProblem, Solution, Status
from zoac.mpc.solvers.certificate import certified
from zoac.mpc.solvers.parameters import write_parameters
from zoac.mpc.solvers.scaling import Units, units

_STATUS = {
    "Solved": Status.SOLVED,
    "AlmostSolved": Status.INACCURATE,
    "InsufficientProgress": Status.INACCURATE,
    "MaxIterations": Status.ITERATION_LIMIT,
    "PrimalInfeasible": Status.INFEASIBLE,
    "AlmostPrimalInfeasible": Status.INFEASIBLE,
}

_STEP_FRACTIONS = 0.99999, 0.99
"""How far towards the boundary a step may go: first a quick way, which takes about a third fewer
iterations in closed loop and is as accurate where it ends; where it sticks, Clarabel's own."""


class ClarabelSolver:
    """The default solver: an interior-point method, one environment after the other.

    Clarabel scales a problem when its solver object is made, and an update keeps that scaling.
    So the object is made from numbers that depend on the layout alone: what it returns does not
    depend on what it solved before. A robust solve makes an object for each problem, scaled
    by that problem's own numbers, and refines its linear solves.

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
        self._prepared: dict[Layout, tuple[_CanonicalForm, list[Any]]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        # Clarabel's objects cannot be pickled; the copy makes its own.
        return type(self), (self.tolerance, self.max_iterations)

    def solve(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        """Solve the n problems; see `Solver`."""
        layout = Layout.of(problem)
        if layout not in self._prepared:
            form = _CanonicalForm(layout)
            neutral, settings = form.neutral(), map(self._settings, _STEP_FRACTIONS)
            self._prepared[layout] = form, [form.make_solver(neutral, given) for given in settings]
        form, prepared = self._prepared[layout]
        n, horizon, nu = problem.inputs.shape
        plans = np.empty((n, nu, horizon))
        status = np.empty(n, dtype=np.int8)
        iterations = np.zeros(n, dtype=np.int64)
        scale = units(problem, always=robust)
        data, scales = form.data(problem, scale, robust)
        multipliers = np.zeros((n, horizon, problem.a.shape[-1])) if layout.bounds_size else None
        for env_index, numbers in enumerate(data):
            for solver in self._attempts(form, numbers, prepared, robust):
                answer = solver.solve()
                iterations[env_index] += answer.iterations
                status[env_index] = _STATUS.get(str(answer.status), Status.NUMERICAL_FAILURE)
                if status[env_index] == Status.SOLVED:
                    break
            plans[env_index].flat = answer.x[form.inputs]
            if multipliers is not None:
                duals = np.array(answer.z) / scales[env_index]
                form.write_multipliers(duals, multipliers[env_index])
        inputs = np.ascontiguousarray(plans.transpose(0, 2, 1)) * scale.inputs[:, None]
        np.clip(inputs, problem.input_low, problem.input_high, out=inputs)
        if multipliers is not None:
            multipliers /= scale.states[:, None]
        return certified(problem, Solution(inputs, status, iterations), multipliers)

    def _attempts(
        self, form: _CanonicalForm, numbers: np.ndarray, prepared: list[Any], robust: bool
    ) -> Iterator[Any]:
        """Yield solver objects that hold `numbers`, each to be tried if the last did not do."""
        if robust:
            yield form.make_solver(numbers, self._settings(_STEP_FRACTIONS[-1], refine=True))
            return
        # As Clarabel reads them fastest: one number after the other.
        parts = {name: array("d", part.tobytes()) for name, part in form.split(numbers).items()}
        for solver in prepared:
            solver.update(**parts)
            yield solver

    def _settings(self, step_fraction: float, refine: bool = False) -> Any:
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        settings.presolve_enable = False  # would refuse updates after removing a row
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = self.tolerance
        settings.max_iter = self.max_iterations
        settings.max_step_fraction = step_fraction
        # Refinement costs a third of the time and gains next to nothing on this sparse form.
        settings.iterative_refinement_enable = refine
        return settings


class _CanonicalForm:
    """CVXPY's canonical form of the problem for one layout, read once.

    Clarabel's form is: minimise x'Px/2 + q'x subject to Ax + s = b, s in a product of cones.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        formulation = build_problem(layout)
        parameters = formulation.parameters
        for parameter in parameters.values():
            parameter.value = np.ones(parameter.size)
        data, _, _ = formulation.problem.get_problem_data(
            cp.CLARABEL, canon_backend=CANON_BACKEND, solver_opts={}
        )
        program = data["param_prob"]
        column = program.param_id_to_col
        self._starts = {name: column[parameter.id] for name, parameter in parameters.items()}
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
        maps = {"P": map_p, "A": -map_ab[:entries], "b": place @ map_ab[entries:]}
        if layout.bounds_size:  # penalties are linear in the slacks
            maps["q"] = sparse.csr_array(program.q[:variables])
            self._rows_of_bounds = _rows(program.constraints, formulation.of_bounds)
        self._map = sparse.vstack(list(maps.values()), "csr")
        ends = np.cumsum([part.shape[0] for part in maps.values()]).tolist()
        self._parts = dict(zip(maps, map(slice, [0, *ends], ends), strict=False))
        self._variables = variables
        self._cones = [
            clarabel.ZeroConeT(data["dims"].zero),
            clarabel.NonnegativeConeT(data["dims"].nonneg),
        ]
        first = program.var_id_to_col[formulation.inputs.id]
        self.inputs = slice(first, first + layout.horizon * layout.nu)
        """Where the inputs stand in x: component by component, each over the horizon."""

    def data(
        self, problem: LinearisedProblem, scale: Units, robust: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return Clarabel's numbers, a row for each of the n problems, and its objectives' scales.

        A row holds the nonzeros of P, those of A, b, and q where states are bounded.
        """
        parameters = np.ones((len(problem.a), self._map.shape[1]))
        limit = {"largest_penalty": np.inf} if robust else {}
        scales = write_parameters(problem, self._layout, scale, parameters, self._starts, **limit)
        return np.ascontiguousarray((self._map @ parameters.T).T), scales

    def split(self, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """Cut a row of `data` into the nonzeros of P, those of A, b and q, by name."""
        return {name: numbers[part] for name, part in self._parts.items()}

    def write_multipliers(self, duals: np.ndarray, multipliers: np.ndarray) -> None:
        """Write Clarabel's dual variables of the states' bounds into `multipliers` (N, nx)."""
        layout, sides = self._layout, self._rows_of_bounds
        for sign, states, rows in zip(
            (-1.0, 1.0), (layout.state_low, layout.state_high), sides, strict=True
        ):
            for i, row in zip(states, rows, strict=True):
                multipliers[:, i] += sign * duals[row : row + layout.horizon]

    def neutral(self) -> np.ndarray:
        """Return a row of `data` that stands for every problem of this layout."""
        parameters = np.ones(self._map.shape[1])
        first = self._starts["weights"]
        parameters[first : first + self._layout.weights_size] = 0.1
        return self._map @ parameters

    def make_solver(self, numbers: np.ndarray, settings: Any) -> Any:
        """Return a Clarabel solver that holds a row of `data` and is scaled by it."""
        parts = self.split(numbers)
        square = (self._variables, self._variables)
        tall = (self._rows, self._variables)
        return clarabel.DefaultSolver(
            sparse.csc_matrix((parts["P"], *self._p_pattern), shape=square),
            parts.get("q", np.zeros(self._variables)),
            sparse.csc_matrix((parts["A"], *self._a_pattern), shape=tall),
            parts["b"],
            self._cones,
            settings,
        )


def _rows(
    constraints: list[cp.Constraint], sides: tuple[list[cp.Constraint], ...]
) -> list[list[int]]:
    """Return where the rows of some constraints begin, given all in the order of their rows."""
    begins = np.cumsum([0, *(constraint.size for constraint in constraints)]).tolist()
    first = {constraint.id: row for constraint, row in zip(constraints, begins, strict=False)}
    return [[first[constraint.id] for constraint in side] for side in sides]
