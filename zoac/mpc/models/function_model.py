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
        self._roll_out, self._advance = (_compiled if compiled else _plain)(self)
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
        states = self._rollout(theta, start, inputs)
        if isinstance(self._jacobians, str):
            ab = self._differences(self._jacobians, theta, states, inputs)
        else:
            ab = self._given_jacobians(theta, states, inputs)
        if not self._checked and len(start):
            first = theta[:1], states[:1], inputs[:1]
            expected, coarse = (self._differences(step, *first)[0] for step in STEPS)
            self._check(ab[0], expected, coarse, states[0], inputs[0])
            self._checked = True
        nx = start.shape[1]
        return states, np.ascontiguousarray(ab[..., :nx]), np.ascontiguousarray(ab[..., nx:])

    def predict(self, theta: np.ndarray, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Return F_theta(states (n, nx), inputs (n, nu)) (n, nx)."""
        return self._rollout(theta, states, inputs[:, None])[:, 1]

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
        theta, inputs = np.array([[*self.parameters.values()]]), np.ones((1, 1, len(self.inputs)))
        try:
            states = self._rollout(theta, np.ones((1, len(self.states))), inputs)
            self._differences(way, theta, states, inputs)
        except ArithmeticError:
            return None  # a point that the model may refuse, since nobody asked for it
        except Exception as error:  # whatever a user's function raises
            return as_text(error)
        return None

    def _rollout(self, theta: np.ndarray, start: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Return states (n, N + 1, nx)."""
        states = np.empty((len(start), inputs.shape[1] + 1, start.shape[1]))
        states[:, 0] = start
        with np.errstate(all="ignore"):
            self._roll_out(np.ascontiguousarray(theta), np.ascontiguousarray(inputs), states)
        return states

    def _differences(
        self, way: str, theta: np.ndarray, states: np.ndarray, inputs: np.ndarray
    ) -> np.ndarray:
        """Return Jacobians (n, N, nx, nx + nu) along a rollout, by small steps in all directions.

        Each point (nx + nu,) of the rollout is moved once in each direction.
        """
        point = np.concatenate([states[:, :-1], inputs], axis=2)
        n, horizon, size = point.shape
        points, directions = point.swapaxes(1, 2)[..., None], np.eye(size)[:, None]
        theta = np.ascontiguousarray(theta)

        def after(moved: np.ndarray) -> np.ndarray:
            return self._advance(theta, np.ascontiguousarray(moved.reshape(n, size, -1)))

        with np.errstate(all="ignore"):
            if way == "complex":
                change = after(points + 1j * COMPLEX_STEP * directions).imag / COMPLEX_STEP
            else:
                step = STEPS[way] * np.maximum(np.abs(point), 1.0)
                moves = step.swapaxes(1, 2)[..., None] * directions
                change = after(points + moves) - after(points - moves)
                change /= (2.0 * step).reshape(n, 1, -1)
        return change.reshape(n, -1, horizon, size).swapaxes(1, 2)

    def _given_jacobians(
        self, theta: np.ndarray, states: np.ndarray, inputs: np.ndarray
    ) -> np.ndarray:
        x, u, p = self.tuples()
        (n, horizon, nu), nx = inputs.shape, states.shape[2]
        ab = np.empty((n, horizon, nx, nx + nu))
        for row in range(n):
            numbers = p(theta[row])
            for k in range(horizon):
                point = x(states[row, k]), u(inputs[row, k]), numbers
                a, b = self._jacobians(*point)  # type: ignore[operator]
                ab[row, k, :, :nx], ab[row, k, :, nx:] = a, b
        return ab

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


def _plain(dynamics: Dynamics) -> tuple[Callable[..., None], Callable[..., np.ndarray]]:
    """Return functions that roll out, and that advance points (n, nx + nu, m) by one sample.

    They take one environment at a time, whose bits then do not depend on how many there are.
    """
    advance, nx = dynamics.advance(), len(dynamics.states)

    def roll_out(theta: np.ndarray, inputs: np.ndarray, states: np.ndarray) -> None:
        for p, commands, along in zip(theta, inputs, states, strict=True):
            for k, u in enumerate(commands):
                along[k + 1] = advance(along[k][:, None], u[:, None], p)[:, 0]

    def several(theta: np.ndarray, points: np.ndarray) -> np.ndarray:
        after = np.empty_like(points[:, :nx])
        for row, (p, at) in enumerate(zip(theta, points, strict=True)):
            after[row] = advance(at[:nx], at[nx:], p)
        return after

    return roll_out, several


def _compiled(dynamics: Dynamics) -> tuple[Callable[..., None], Callable[..., np.ndarray]]:
    """Return the functions of `_plain`, compiled by numba, point by point.

    Numbers are copied one by one, after a check: of arrays, numba would also compile the text that
    says which shapes differ.
    """
    import numba

    compiled = numba.njit(error_model="numpy")
    advance, nx = dynamics.advance(compiled), len(dynamics.states)

    @compiled
    def roll_out(theta: np.ndarray, inputs: np.ndarray, states: np.ndarray) -> None:
        for row in range(len(inputs)):
            for k in range(inputs.shape[1]):
                x, u = states[row, k].copy(), inputs[row, k].copy()
                after = advance(x, u, theta[row])
                if len(after) != nx:
                    raise ValueError("the function returned too few or too many entries")
                for i in range(nx):
                    states[row, k + 1, i] = after[i]

    @compiled
    def several(theta: np.ndarray, points: np.ndarray) -> np.ndarray:
        after = np.empty((len(points), nx, points.shape[2]), points.dtype)
        for row in range(len(points)):
            for j in range(points.shape[2]):
                x, u = points[row, :nx, j].copy(), points[row, nx:, j].copy()
                moved = advance(x, u, theta[row])
                for i in range(nx):
                    after[row, i, j] = moved[i]
        return after

    return roll_out, several
