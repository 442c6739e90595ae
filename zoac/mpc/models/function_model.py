"""A model from a function of NumPy or numba, with Jacobians given or by small differences."""

from collections.abc import Callable
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError, as_text, suggest
from zoac.mpc.models.dynamics import Dynamics, Function
from zoac.mpc.problem import Sparsity

WAYS = ("complex", "finite")

COMPLEX_STEP = 1e-20
"""Times i: the imaginary part of F(x + i h) is h F'(x), without any difference of near numbers."""

FINITE_STEP = 6e-6
"""Cube root of the machine epsilon, for central differences; times |x| where that is above 1."""

STEPS = {"finite": FINITE_STEP, "coarse": 8.0 * FINITE_STEP}

AGREES = 1e-3
"""A Jacobian's entry is right if finite differences are within this part of it, and their error."""

ERROR_FACTOR = 10.0
"""Their error is at most this times what a coarser step changes: it shows curvature and noise."""

ROUNDING = 1e-14
"""And this part of the next state, over the step."""


class FunctionModel(Dynamics):
    """A model from a function of (x, u, p): plain NumPy, or compiled by `numba.njit`.

    A plain function is called with arrays as entries of x and u, several points at once: it uses
    NumPy's functions and no `if` on values. A compiled one is called with numbers and is far
    faster.
    """

    def __init__(
        self,
        states: Any,
        inputs: Any,
        parameters: Any = None,
        *,
        jacobians: str | Callable[[Any, Any, Any], Any] = "complex",
        sparsity: Sparsity | None = None,
        **options: Any,
    ) -> None:
        """
        Args:
            states: Names.
            inputs: Names.
            parameters: Values by name.
            jacobians: "complex": by a complex step, exact to rounding where the function takes
                complex numbers (no `abs`, no comparison); "finite": by central differences; or a
                function of (x, u, p), with numbers as entries, that returns dF/dx (nx, nx) and
                dF/du (nx, nu) of `step`. All are compared with finite differences once.
            sparsity: Which entries of the Jacobians can be other than zero, if known.
            options: `step` or `derivative`, `sample_time`, `substeps`: see
                `zoac.mpc.models.dynamics.Dynamics`.

        Raises:
            ConfigError: If a part of it cannot be used.
        """
        super().__init__(states, inputs, parameters, **options)
        self._given |= {"jacobians": jacobians, "sparsity": sparsity}
        self.sparsity, self._jacobians = sparsity, jacobians
        if isinstance(jacobians, str) and jacobians not in WAYS:
            raise ConfigError(f"jacobians={jacobians!r}: {suggest(jacobians, WAYS)}, or a function")
        if callable(jacobians) and self.continuous:
            raise ConfigError("jacobians=...: a function belongs to step=..., not to derivative")
        self.check()
        compiled = hasattr(self._function, "py_func")
        if not compiled:
            self._function = _reading(self._function)
        self._rollout = _compiled_rollout(self) if compiled else _plain_rollout(self)
        if not compiled:
            self._try()
        self._checked = False

    def linearise(
        self, theta: np.ndarray, start: np.ndarray, inputs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `zoac.mpc.sqp.PredictiveModel`; theta (n, np) in the order of `parameters`.

        Raises:
            ConfigError: In the first call, if the Jacobians are not those of the function.
        """
        way = self._jacobians if isinstance(self._jacobians, str) else "given"
        states, ab = self._along(way, theta, start, inputs)
        if way == "given":
            self._write_given(theta, states, inputs, ab)
        if not self._checked and len(start):
            first = theta[:1], start[:1], inputs[:1]
            expected, coarse = (self._along(step, *first)[1][0] for step in STEPS)
            self._check(ab[0], expected, coarse, states[0], inputs[0])
            self._checked = True
        nx = start.shape[1]
        return states, np.ascontiguousarray(ab[..., :nx]), np.ascontiguousarray(ab[..., nx:])

    def predict(self, theta: np.ndarray, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Return F_theta(states (n, nx), inputs (n, nu)) (n, nx)."""
        return self._along("given", theta, states, inputs[:, None])[0][:, 1]

    def _try(self) -> None:
        """See that a plain function takes arrays, as in a rollout, and complex numbers if it must.

        Raises:
            ConfigError: If it does not.
        """
        error = self._error("finite")
        if error is not None:
            raise ConfigError(
                f"model: with arrays as entries of x and u the function raised {error}; use "
                "NumPy's functions, no `if` on values and no change in place (r -= ...), or "
                "compile it by numba.njit"
            )
        error = self._error("complex") if self._jacobians == "complex" else None
        if error is not None:
            raise ConfigError(
                f"model: with complex numbers the function raised {error}; give jacobians='finite'"
            )

    def _error(self, way: str) -> str | None:
        """Return what the function raises in a rollout of one step from ones."""
        theta = np.array([[*self.parameters.values()]])
        try:
            self._along(
                way, theta, np.ones((1, len(self.states))), np.ones((1, 1, len(self.inputs)))
            )
        except ArithmeticError:
            return None  # a point that the model may refuse, since nobody asked for it
        except Exception as error:  # whatever a user's function raises
            return as_text(error)
        return None

    def _along(
        self, way: str, theta: np.ndarray, start: np.ndarray, inputs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return states and Jacobians (n, N, nx, nx + nu) of a rollout; "given" ones are zero."""
        n, horizon, nu = inputs.shape
        nx = start.shape[1]
        states = np.empty((n, horizon + 1, nx))
        states[:, 0] = start
        ab = np.zeros((n, horizon, nx, nx + nu))
        theta = np.ascontiguousarray(theta)
        # One environment at a time: its bits do not depend on how many there are.
        with np.errstate(all="ignore"):
            for row in range(n):
                self._rollout(way, theta[row], inputs[row], states[row], ab[row])
        return states, ab

    def _write_given(
        self, theta: np.ndarray, states: np.ndarray, inputs: np.ndarray, ab: np.ndarray
    ) -> None:
        x, u, p = self.tuples()
        nx = states.shape[2]
        for row in range(len(inputs)):
            numbers = p(theta[row])
            for k in range(inputs.shape[1]):
                point = x(states[row, k]), u(inputs[row, k]), numbers
                a, b = self._jacobians(*point)  # type: ignore[operator]
                ab[row, k, :, :nx], ab[row, k, :, nx:] = a, b

    def _check(
        self,
        found: np.ndarray,
        expected: np.ndarray,
        coarse: np.ndarray,
        states: np.ndarray,
        inputs: np.ndarray,
    ) -> None:
        point = np.concatenate([states[:-1], inputs], axis=1)
        step = FINITE_STEP * np.maximum(np.abs(point), 1.0)
        # Entry by entry: units differ, so that a small one matters as much as a large one.
        with np.errstate(all="ignore"):  # differences that are not finite tell nothing
            allowed = AGREES * np.abs(expected) + ERROR_FACTOR * np.abs(coarse - expected)
            allowed += ROUNDING * np.abs(states[1:, :, None]) / step[:, None]
            wrong = np.argwhere(np.abs(found - expected) > allowed)
        if len(wrong):
            k, i, j = wrong[0]
            raise ConfigError(
                f"model: at step {k} the Jacobian of {self.states[i]} in "
                f"{(*self.states, *self.inputs)[j]} is {found[k, i, j]:.6g}, by finite differences "
                f"{expected[k, i, j]:.6g}; a complex step needs a function that is smooth and "
                "takes complex numbers: else jacobians='finite'"
            )


def _reading(function: Function) -> Function:
    """Return a function of (x, u, p) whose arrays refuse to be changed.

    They are views of the integrator's own, so that a change in place would be one of the state.
    """

    def reading(x: Any, u: Any, p: Any) -> Any:
        for entry in (*x, *u):
            entry.setflags(write=False)
        return function(x, u, p)

    return reading


def _plain_rollout(dynamics: Dynamics) -> Callable[..., None]:
    """Return a rollout that differentiates in all directions at once, as columns of arrays."""
    advance = dynamics.advance()
    nx, nu = len(dynamics.states), len(dynamics.inputs)
    directions = np.eye(nx + nu)

    def rollout(
        way: str, p: np.ndarray, inputs: np.ndarray, states: np.ndarray, ab: np.ndarray
    ) -> None:
        for k in range(len(inputs)):
            point = np.concatenate([states[k], inputs[k]])[:, None]
            states[k + 1] = advance(point[:nx], point[nx:], p)[:, 0]
            if way == "complex":
                moved = point + 1j * COMPLEX_STEP * directions
                ab[k] = advance(moved[:nx], moved[nx:], p).imag / COMPLEX_STEP
            elif way in STEPS:
                step = STEPS[way] * np.maximum(np.abs(point[:, 0]), 1.0)
                up, down = point + step * directions, point - step * directions
                change = advance(up[:nx], up[nx:], p) - advance(down[:nx], down[nx:], p)
                ab[k] = change / (2.0 * step)

    return rollout


def _compiled_rollout(dynamics: Dynamics) -> Callable[..., None]:
    """Return a rollout that numba compiles, direction by direction."""
    import numba

    advance = dynamics.advance(numba.njit(error_model="numpy"))
    nx = len(dynamics.states)

    @numba.njit(error_model="numpy")
    def along(p: np.ndarray, inputs: np.ndarray, states: np.ndarray) -> None:
        for k in range(len(inputs)):
            states[k + 1] = advance(states[k].copy(), inputs[k].copy(), p)

    @numba.njit(error_model="numpy")
    def by_complex_step(
        p: np.ndarray, inputs: np.ndarray, states: np.ndarray, ab: np.ndarray
    ) -> None:
        for k in range(len(inputs)):
            for j in range(ab.shape[2]):
                moved = np.concatenate((states[k], inputs[k])) + 0j
                moved[j] += 1j * COMPLEX_STEP
                change = advance(moved[:nx].copy(), moved[nx:].copy(), p).imag
                ab[k, :, j] = change / COMPLEX_STEP

    @numba.njit(error_model="numpy")
    def by_differences(
        p: np.ndarray, inputs: np.ndarray, states: np.ndarray, ab: np.ndarray, size: float
    ) -> None:
        for k in range(len(inputs)):
            for j in range(ab.shape[2]):
                up = np.concatenate((states[k], inputs[k]))
                down = up.copy()
                step = size * max(abs(up[j]), 1.0)
                up[j] += step
                down[j] -= step
                change = advance(up[:nx].copy(), up[nx:].copy(), p)
                change = change - advance(down[:nx].copy(), down[nx:].copy(), p)
                ab[k, :, j] = change / (2.0 * step)

    def rollout(
        way: str, p: np.ndarray, inputs: np.ndarray, states: np.ndarray, ab: np.ndarray
    ) -> None:
        inputs = np.ascontiguousarray(inputs)
        along(p, inputs, states)
        if way == "complex":
            by_complex_step(p, inputs, states, ab)
        elif way in STEPS:
            by_differences(p, inputs, states, ab, STEPS[way])

    return rollout
