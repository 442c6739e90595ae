"""Many linear-quadratic programmes with bounded inputs at once, exactly: see README.md beside this.

The package needs NumPy and numba alone, and no other part of zoac: it can be copied out as it is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .kernel import Status, solve_lanes

__all__ = ["Pattern", "Solution", "Status", "pattern", "solve", "solve_about"]

Pattern = tuple[tuple[int | None, ...], ...]
"""Rows of [A B], None where an entry is always zero: compiled code knows it as a type."""

_VECTOR = 4  # a row is a whole number of these


class Solution(NamedTuple):
    """Plans of n programmes."""

    inputs: np.ndarray
    """(n, N, nu), inside the bounds."""
    status: np.ndarray
    """(n,) int8, values of `Status`."""
    iterations: np.ndarray
    """(n,) int64, number of Riccati recursions."""


def pattern(nonzero: np.ndarray) -> Pattern:
    """Return the pattern of a mask (nx, nx + nu): which entries of [A B] can be other than zero."""
    return tuple(tuple(0 if entry else None for entry in row) for row in nonzero.tolist())


def solve(
    initial_states: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    state_weights: np.ndarray,
    input_weights: np.ndarray,
    input_low: np.ndarray,
    input_high: np.ndarray,
    reference: np.ndarray | None = None,
    **options: Any,
) -> Solution:
    """Solve n programmes, each

        minimise    sum_{k=1..N} |x_k - reference_k|^2_{state_weights_k}
                  + sum_{k=0..N-1} |u_k|^2_{input_weights_k}
        subject to  x_0 given,  x_{k+1} = a_k x_k + b_k u_k + c_k,  input_low <= u_k <= input_high,

    where |e|^2_w = sum_i w_i e_i^2.

    Args:
        initial_states: x_0, (n, nx).
        a: (n, N, nx, nx).
        b: (n, N, nx, nu).
        c: (n, N, nx).
        state_weights: (n, N, nx), nonnegative, for x_1 .. x_N.
        input_weights: (n, N, nu), positive.
        input_low: (nu,), may be -inf.
        input_high: (nu,), may be inf, or equal to `input_low` to pin an input.
        reference: (n, N, nx), for x_1 .. x_N; default: zero.
        **options: See `solve_about`.

    Raises:
        ValueError: If a shape does not fit, a bound is NaN, or bounds are not in order.
    """
    low, high = input_low, input_high
    reference = np.zeros(np.shape(c)) if reference is None else reference
    given = (initial_states, a, b, c, state_weights, input_weights, low, high, reference)
    x, a, b, c, state_weights, input_weights, low, high, reference = _arrays(*given)
    n, horizon, nx, nu = b.shape
    inputs = np.broadcast_to(np.clip(np.zeros(nu), low, high), (n, horizon, nu)).copy()
    states = np.empty((n, horizon + 1, nx))
    states[:, 0] = x
    with np.errstate(invalid="ignore", over="ignore"):  # such data get a status
        for k in range(horizon):
            driven = np.einsum("nij,nj->ni", b[:, k], inputs[:, k]) + c[:, k]
            states[:, k + 1] = np.einsum("nij,nj->ni", a[:, k], states[:, k]) + driven
    return solve_about(
        states, inputs, a, b, reference, state_weights, input_weights, low, high, **options
    )


def _arrays(initial_states: Any, a: Any, b: Any, c: Any, *others: Any) -> list[np.ndarray]:
    """Return the arguments of `solve` as contiguous arrays of the right shapes."""
    if np.ndim(b) != 4:
        raise ValueError(f"expected b of shape (n, N, nx, nu), got {np.shape(b)}")
    n, horizon, nx, nu = np.shape(b)
    expected = {
        "initial_states": (n, nx),
        "a": (n, horizon, nx, nx),
        "b": (n, horizon, nx, nu),
        "c": (n, horizon, nx),
        "state_weights": (n, horizon, nx),
        "input_weights": (n, horizon, nu),
        "input_low": (nu,),
        "input_high": (nu,),
        "reference": (n, horizon, nx),
    }
    arrays = []
    for (name, shape), given in zip(
        expected.items(), (initial_states, a, b, c, *others), strict=True
    ):
        array = np.ascontiguousarray(given, np.float64)
        if array.shape != shape:
            raise ValueError(f"expected {name} of shape {shape}, got {array.shape}")
        arrays.append(array)
    return arrays


def solve_about(
    states: np.ndarray,
    inputs: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    reference: np.ndarray,
    state_weights: np.ndarray,
    input_weights: np.ndarray,
    input_low: np.ndarray,
    input_high: np.ndarray,
    *,
    nonzero: Pattern | None = None,
    robust: bool = False,
    sweeps: int = 6,
    max_active_set_steps: int = 1000,
) -> Solution:
    """Solve n programmes of which a trajectory inside the bounds is known.

    They are those of `solve` with x_{k+1} = states_{k+1} + a_k (x_k - states_k)
    + b_k (u_k - inputs_k), as a model linearised about a rollout gives them. Arrays must be
    C-contiguous float64 of these shapes, which is not checked.

    Status SOLVED means that the plan was certified: with the objective's gradient g, computed
    anew by the adjoint equation, every |u - clip(u - g / d)| is below 1e-7 of that input's
    range, d being the curvature in that input when all later ones respond; or below 1e-9,
    d being the curvature when none does. Programmes whose data are not finite, or that fail
    numerically, keep `inputs`.

    A plan depends on its own programme's data alone, to the bit, whatever else is solved beside.
    The first call with new nx and nu, or a new pattern, compiles for up to half a minute; numba
    keeps the result on disk.

    Args:
        states: (n, N + 1, nx), the trajectory, x_0 included.
        inputs: (n, N, nu), its inputs.
        a: (n, N, nx, nx).
        b: (n, N, nx, nu).
        reference: (n, N, nx), for x_1 .. x_N.
        state_weights: (n, N, nx), nonnegative, for x_1 .. x_N.
        input_weights: (n, N, nu), positive.
        input_low: (nu,).
        input_high: (nu,).
        nonzero: `pattern` of entries of [a b] that can be other than zero; None: any can.
        robust: Leave out the clipped sweeps: interior point and active set at once.
        sweeps: Clipped sweeps tried before the interior-point method takes over.
        max_active_set_steps: Limit of the active-set method that ends the solve.

    Raises:
        ValueError: If a bound is NaN or the lower bound of an input exceeds the upper.
    """
    n, horizon, nx, nu = b.shape
    width = -(-(nx + nu) // _VECTOR) * _VECTOR
    plans = np.empty((n, horizon, nu))
    status = np.empty(n, np.int8)
    iterations = np.empty(n, np.int64)
    data = states, inputs, a, b, reference, state_weights, input_weights
    sizes = (0,) * nx, (0,) * nu, (0,) * width, nonzero or ((0,) * (nx + nu),) * nx
    ordered = solve_lanes(
        data, input_low, input_high, sizes, robust, sweeps, max_active_set_steps,
        plans, status, iterations,
    )  # fmt: skip
    if not ordered:
        raise ValueError(
            "input bounds must be numbers in order, got "
            f"low {input_low.tolist()}, high {input_high.tolist()}"
        )
    return Solution(plans, status, iterations)
