"""The quadratic programme of one linearisation, in the inputs alone, as a CasADi function.

With v what the inputs of the horizon change by, the only variables, and the linearised states
z_k = (rollout)_k + G_k v, the programme of `zoac.mpc.problem.LinearisedProblem` is

    minimise v'Hv / 2 + g'v + sum_i penalty_i max(C_i v - d_i, 0) over soft rows i
    subject to C_i v <= d_i, hard rows i.

Rows are scaled: those of the box by its width, those of a state by how far the inputs move it.
"""

from typing import Any

import casadi
import numpy as np

from zoac.mpc.export.embedded import EmbeddedMpc

LEAST = 1e-9
"""Scale of the rows of a state that no input moves."""


def programme(embedded: EmbeddedMpc) -> tuple[Any, np.ndarray]:
    """Return the function of (observation, input before (nu,), plan (N * nu,)) to the programme.

    The function returns H, g, C, d and penalties, 0 where a row is hard. Rows of C: the box's
    finite bounds, then for each bound of a state one for each step.

    Returns:
        The function, and which rows are soft (m,) bool.
    """
    horizon, nu, nz = embedded.options.horizon, embedded.step.size1_in(1), embedded.step.size1_in(0)
    n, given = horizon * nu, embedded.objective
    observation = casadi.MX.sym("observation", embedded.observation)
    before, plan = casadi.MX.sym("before", nu), casadi.MX.sym("plan", n)
    start = casadi.vertcat(*(observation[i] for i in embedded.state))
    start = casadi.vertcat(start, casadi.MX.zeros(nz - len(embedded.state)))
    for i, j in embedded.before:
        start[i] = before[j]
    along = _stage(embedded.step, n).mapaccum("along", horizon, 2)
    states, moved = along(
        start, casadi.MX.zeros(nz, n), casadi.reshape(plan, nu, horizon), casadi.DM(np.eye(n))
    )
    motion: Any = casadi.vertcat(*casadi.horzsplit(moved, n))  # (N * nz, n)

    slope = casadi.sparsify(casadi.DM(embedded.preview))
    reference = casadi.DM(embedded.reference.reshape(-1)) + slope @ observation
    weights = casadi.DM(2.0 * given.state_weights[0].reshape(-1))
    own = casadi.DM(2.0 * given.input_weights[0].reshape(-1))
    weighed = casadi.repmat(weights, 1, n) * motion
    hessian = motion.T @ weighed + casadi.diag(own)
    gradient = weighed.T @ (casadi.vec(states) - reference) + own * plan

    rows, limits = map(list, zip(*_box(embedded, plan), strict=True))
    count = sum(limit.numel() for limit in limits)
    prices, soft = [casadi.DM.zeros(count)], [np.zeros(count, bool)]
    for i, sign, bound, penalty in _state_bounds(embedded):
        row = motion[i::nz, :]
        size = casadi.fmax(casadi.mmax(casadi.sum2(casadi.fabs(row))), LEAST)
        rows.append(sign * row / size)
        limits.append(sign * (bound - states[i, :].T) / size)
        is_soft = bool(np.isfinite(penalty))
        soft.append(np.full(horizon, is_soft))
        prices.append(casadi.repmat(penalty * size if is_soft else 0.0, horizon))
    outputs = [casadi.densify(hessian), gradient, casadi.vertcat(*rows)]
    outputs += [casadi.densify(casadi.vertcat(*part)) for part in (limits, prices)]
    return casadi.Function("mpc_programme", [observation, before, plan], outputs), np.concatenate(
        soft
    )


def _stage(step: Any, n: int) -> Any:
    """Return (z, G, u, place) -> next z and G, where `place` (nu, n)' says which of v are u."""
    nz, nu = step.size1_in(0), step.size1_in(1)
    points = casadi.SX.sym("z", nz), casadi.SX.sym("u", nu)
    ahead = step(*points)
    jacobians = [casadi.densify(casadi.jacobian(ahead, of)) for of in points]
    linear = casadi.Function("linear", [*points], [ahead, *jacobians])
    z, motion, u, place = (
        casadi.MX.sym(name, *shape)
        for name, shape in (("z", (nz, 1)), ("G", (nz, n)), ("u", (nu, 1)), ("place", (n, nu)))
    )
    after, a, b = linear(z, u)
    return casadi.Function("stage", [z, motion, u, place], [after, a @ motion + b @ place.T])


def _box(embedded: EmbeddedMpc, plan: Any) -> list[tuple[Any, Any]]:
    """Return rows and limits of the box's finite bounds; one that holds always if there is none."""
    horizon = embedded.options.horizon
    low, high = (np.tile(bound, horizon) for bound in embedded.box)
    width = np.where(np.isfinite(high - low) & (high > low), high - low, 1.0)
    found = []
    for sign, bound in ((-1.0, low), (1.0, high)):
        finite = np.flatnonzero(np.isfinite(bound)).tolist()
        if finite:
            row = casadi.sparsify(casadi.DM(sign * np.diag(1.0 / width)[finite]))
            limit = (sign * bound / width)[finite] - row @ plan
            found.append((row, limit))
    return found or [(casadi.DM(1, plan.numel()), casadi.MX(1.0))]


def _state_bounds(embedded: EmbeddedMpc) -> list[tuple[int, float, float, float]]:
    """Return (position, sign, bound, penalty) of each finite bound on z."""
    if (given := embedded.objective.bounds) is None:
        return []
    return [
        (i, sign, bounds[0, i], given.penalty[0, i])
        for sign, bounds in ((-1.0, given.low), (1.0, given.high))
        for i in np.flatnonzero(np.isfinite(bounds[0])).tolist()
    ]
