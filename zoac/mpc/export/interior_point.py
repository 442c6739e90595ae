"""Mehrotra's interior-point method for the condensed programme, as CasADi functions.

minimise v'Hv / 2 + g'v + penalty' s  subject to  C v - s + t = d, s >= 0, t >= 0 (s = 0: hard rows)

Multipliers: y of C v <= d, p of s >= 0, where y + p = penalty. With D = 1 / (t / y + s / p), both
steps of an iteration solve (H + C'DC) dv = r (Nocedal and Wright, Numerical Optimization, 16.6).

CasADi's own interior point (`ipqp`) cannot be generated as C, and its `qrqp`, which can, sticks
in a tenth of these programmes; see docs/export_mpc.md.
"""

from typing import Any

import casadi
import numpy as np

TO_BOUNDARY = 0.9, 0.995
"""How far towards the boundary a step may go: at first, and where the predictor's step is a whole
one. With the second number always, a few programmes run along the boundary without end."""


def functions(rows: Any, soft: np.ndarray) -> tuple[Any, Any]:
    """Return the functions `begin` and `iterate`.

    `begin` maps (H, g, C, d, penalty) to the state, (v, y, t, s, p) one after the other, and the
    scale of the multipliers. `iterate` maps (H, g, C, d, state, scale) to the next state, and to a
    residual of the one that it was given: of gradient, rows and complementarity; NaN where one is.

    Args:
        rows: CasADi's sparsity of C (m, n).
        soft: (m,) bool, the soft rows.
    """
    m, n = rows.shape
    shapes = {"H": (n, n), "g": (n, 1), "C": (rows,), "d": (m, 1)}
    data = {name: casadi.MX.sym(name, *shape) for name, shape in shapes.items()}
    state = casadi.MX.sym("state", n + 4 * m)
    is_soft = casadi.DM(soft.astype(float))
    scale, penalty = casadi.MX.sym("scale"), casadi.MX.sym("penalty", m)
    first = _begin(data, penalty, is_soft)
    begin = casadi.Function("mpc_begin", [*data.values(), penalty], first)
    arguments = [*data.values(), state, scale]
    return begin, casadi.Function("mpc_iterate", arguments, _iterate(data, state, scale, is_soft))


def _begin(data: dict[str, Any], penalty: Any, soft: Any) -> list[Any]:
    """Begin at v = 0 with slacks of 1 or more and multipliers of the gradient's size."""
    g, d = data["g"], data["d"]
    size = casadi.norm_inf(g) + casadi.norm_inf(casadi.diag(data["H"]))
    y = casadi.if_else(soft, casadi.fmin(0.5 * penalty, size), size)
    p = casadi.if_else(soft, penalty - y, 1.0)
    s = soft * (casadi.fmax(-d, 0.0) + 1.0)
    t = casadi.fmax(d + s, 1.0)
    return [casadi.vertcat(casadi.MX.zeros(g.numel()), y, t, s, p), size]


def _iterate(data: dict[str, Any], state: Any, scale: Any, soft: Any) -> list[Any]:
    """Take one step. A hard row has s = 0 and p = 1 throughout."""
    h, g, c, d = data.values()
    n, m = g.numel(), d.numel()
    parts: Any = casadi.vertsplit(state, [0, n, n + m, n + 2 * m, n + 3 * m, n + 4 * m])
    v, y, t, s, p = parts
    dual = h @ v + g + c.T @ y
    beyond = c @ v - d  # C v - s + t - d is 0 at the solution
    gap = casadi.dot(y, t) + casadi.dot(p, s)
    # Sums, since a maximum may pass over NaN.
    residual = (casadi.norm_1(dual) + gap) / scale + casadi.norm_1(beyond - s + t)
    count = soft.numel() + float(casadi.sum1(soft))
    weight = 1.0 / (t / y + s / p)
    matrix = h + c.T @ (casadi.repmat(weight, 1, v.numel()) * c)

    def direction(for_t: Any, for_s: Any) -> tuple[Any, ...]:
        """Return the Newton step to y t = for_t and p s = for_s."""
        wanted = weight * (beyond + for_t / y - soft * for_s / p)
        dv = casadi.solve(matrix, -(dual + c.T @ wanted), "ldl")
        dy = weight * (c @ dv) + wanted
        return dv, dy, (for_t - t * dy) / y - t, soft * ((for_s + s * dy) / p - s), -soft * dy

    def longest(step: tuple[Any, ...]) -> Any:
        """Return how much of a step, at most all of it, leaves nothing negative."""
        x, dx = casadi.vertcat(y, t, s, p), casadi.vertcat(*step[1:])
        return casadi.fmin(casadi.mmin(casadi.if_else(dx < 0.0, -x / dx, 1.0)), 1.0)

    zero = casadi.MX.zeros(soft.numel())
    step = direction(zero, zero)
    alpha, (_, dy, dt, ds, dp) = longest(step), step
    ahead = casadi.dot(y + alpha * dy, t + alpha * dt) + casadi.dot(p + alpha * dp, s + alpha * ds)
    target = gap / count * (ahead / gap) ** 3
    step = direction(target - dy * dt, target - dp * ds)
    fraction = TO_BOUNDARY[0] + alpha * (TO_BOUNDARY[1] - TO_BOUNDARY[0])
    alpha = casadi.fmin(1.0, fraction * longest(step))
    return [state + alpha * casadi.vertcat(*step), residual]
