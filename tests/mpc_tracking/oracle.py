"""The paper's nonlinear programme, written anew from its text in CasADi and solved by IPOPT.

Shares no code with the package: not the model, not the path, not the weights.
"""

from collections.abc import Mapping

import casadi as ca
import numpy as np

N, T_S, U_R, GAMMA = 25, 0.1, 18.0, 0.99
DELTA_MAX, A_MAX = 2 * np.pi / 15, 3.0
STATE = ("x", "y", "phi", "u", "v", "omega")


def bicycle(X: ca.SX, U: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
    """Return X(k + 1)."""
    x, y, phi, u, v, w = ca.vertsplit(X)
    delta, a = ca.vertsplit(U)
    m, Iz, kf, kr, lf, lr = (p[name] for name in ("m", "I_z", "k_f", "k_r", "l_f", "l_r"))
    v_next = (
        m * u * v + T_S * (lf * kf - lr * kr) * w - T_S * kf * delta * u - T_S * m * u**2 * w
    ) / (m * u - T_S * (kf + kr))
    w_next = (Iz * u * w + T_S * (lf * kf - lr * kr) * v - T_S * lf * kf * delta * u) / (
        Iz * u - T_S * (lf**2 * kf + lr**2 * kr)
    )
    return ca.vertcat(
        x + T_S * (u * ca.cos(phi) - v * ca.sin(phi)),
        y + T_S * (v * ca.cos(phi) + u * ca.sin(phi)),
        phi + T_S * w,
        u + T_S * a,
        v_next,
        w_next,
    )


class NonlinearMpc:
    """Built once; a solve sets numbers only."""

    def __init__(self, names: tuple[str, ...], tolerance: float = 1e-10) -> None:
        """
        Args:
            names: The 19 parameter names, in the order in which values will be given.
            tolerance: Of IPOPT.
        """
        values, start, points = ca.SX.sym("p", 19), ca.SX.sym("s", 6), ca.SX.sym("r", 3, N)
        p = dict(zip(names, ca.vertsplit(values), strict=True))
        X, U = ca.SX.sym("X", 6, N), ca.SX.sym("U", 2, N)
        stage = ca.vertcat(*[0.01 if s == "u" else p[f"stage_{s}"] for s in STATE])
        terminal = ca.vertcat(*[p[f"terminal_{s}"] for s in STATE])
        effort = ca.vertcat(p["input_delta"], p["input_a"])
        cost, defects, state, rollout = 0, [], start, [start]
        for k in range(N):
            cost += GAMMA**k * ca.dot(effort, U[:, k] ** 2)
            defects.append(X[:, k] - bicycle(state, U[:, k], p))
            rollout.append(bicycle(rollout[-1], ca.DM.zeros(2), p))
            state = X[:, k]
            error = state - ca.vertcat(points[:, k], U_R, 0, 0)
            weight = terminal if k == N - 1 else stage
            cost += GAMMA ** (k + 1) * ca.dot(weight, error**2)
        unknowns = ca.vertcat(ca.vec(X), ca.vec(U))
        data = ca.vertcat(values, start, ca.vec(points))
        options = {
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes", "tol": tolerance, "max_iter": 500},
        }
        nlp = {"x": unknowns, "p": data, "f": cost, "g": ca.vertcat(*defects)}
        self._solver = ca.nlpsol("mpc", "ipopt", nlp, options)
        self._guess = ca.Function("guess", [data], [ca.vertcat(*rollout[1:], ca.DM.zeros(2 * N))])
        bound = np.tile([DELTA_MAX, A_MAX], N)
        self._high = np.concatenate([np.full(6 * N, np.inf), bound])

    def plan(self, values: np.ndarray, observation: np.ndarray) -> np.ndarray | None:
        """Return the inputs (N, 2), or None if IPOPT did not converge.

        Args:
            values: Physical parameters (19,).
            observation: (81,).
        """
        data = np.concatenate([values, observation])
        answer = self._solver(
            x0=self._guess(data), p=data, lbx=-self._high, ubx=self._high, lbg=0, ubg=0
        )
        if not self._solver.stats()["success"]:
            return None
        return np.asarray(answer["x"])[6 * N :].reshape(N, 2)
