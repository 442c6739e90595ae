"""The nonlinear programme of an MPC with everything in it, in CasADi, solved by IPOPT.

Shares no code with the package: models are written anew, weights are matrices, rates differences of
inputs, soft bounds slack variables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

Model = Callable[[ca.SX, ca.SX], ca.SX]
"""The next state of (x, u)."""


def runge_kutta(derivative: Model, dt: float, steps: int = 1) -> Model:
    """Return the classical method over `steps` of `dt`, with u constant."""

    def advance(x: ca.SX, u: ca.SX) -> ca.SX:
        for _ in range(steps):
            a = derivative(x, u)
            b = derivative(x + dt / 2 * a, u)
            c = derivative(x + dt / 2 * b, u)
            d = derivative(x + dt * c, u)
            x = x + dt * (a + 2 * b + 2 * c + d) / 6
        return x

    return advance


@dataclass
class Problem:
    """Numbers of one MPC.

    Args:
        model: Next state.
        horizon: N.
        stage: (nx + nu, nx + nu), weight on errors and inputs.
        terminal: (nx, nx).
        rate: (nu,), weights on changes of inputs.
        input_bounds: (2, nu).
        state_bounds: (2, nx).
        penalty: (nx,); inf: hard.
        max_rate: (nu,).
        discount: From step to step.
        input_reference: (nu,).
    """

    model: Model
    horizon: int
    stage: np.ndarray
    terminal: np.ndarray
    rate: np.ndarray
    input_bounds: np.ndarray
    state_bounds: np.ndarray
    penalty: np.ndarray
    max_rate: np.ndarray
    discount: float = 1.0
    input_reference: np.ndarray = field(default_factory=lambda: np.zeros(0))


class Ipopt:
    """The programme, built once."""

    def __init__(self, problem: Problem, tolerance: float = 1e-10) -> None:
        self.problem = p = problem
        self._nx, self._nu = nx, nu = len(p.terminal), len(p.rate)
        n = p.horizon
        goal = p.input_reference if len(p.input_reference) else np.zeros(nu)
        start, before = ca.SX.sym("start", nx), ca.SX.sym("before", nu)
        reference = ca.SX.sym("reference", nx, n)
        x, u = ca.SX.sym("x", nx, n), ca.SX.sym("u", nu, n)
        slack = ca.SX.sym("slack", nx, n)
        soft = np.isfinite(p.penalty) & np.isfinite(p.state_bounds).any(axis=0)
        cost, rows, low, high = 0, [], [], []
        now = start
        for k in range(n):
            error = now - reference[:, max(k - 1, 0)]
            point = ca.vertcat(error, u[:, k] - goal)
            change = u[:, k] - (before if k == 0 else u[:, k - 1])
            cost += p.discount**k * ca.bilin(p.stage, point, point)
            cost += p.discount**k * ca.dot(p.rate, change**2)
            rows += [x[:, k] - p.model(now, u[:, k]), change]
            low += [np.zeros(nx), -p.max_rate]
            high += [np.zeros(nx), p.max_rate]
            now = x[:, k]
            for i in range(nx):
                for side, sign in ((0, 1.0), (1, -1.0)):
                    if np.isfinite(p.state_bounds[side, i]):
                        over = sign * (now[i] - p.state_bounds[side, i])
                        rows.append(over + slack[i, k] if soft[i] else over)
                        low.append([0.0])
                        high.append([np.inf])
            cost += sum(p.penalty[i] * slack[i, k] for i in range(nx) if soft[i])
        error = now - reference[:, n - 1]
        cost += p.discount**n * ca.bilin(p.terminal, error, error)
        unknowns = ca.vertcat(ca.vec(x), ca.vec(u), ca.vec(slack))
        data = ca.vertcat(start, before, ca.vec(reference))
        options = {
            "print_time": False,
            "ipopt": {
                "print_level": 0, "sb": "yes", "tol": tolerance, "max_iter": 1000,
                "bound_relax_factor": 0.0,
            },
        }  # fmt: skip
        nlp = {"x": unknowns, "p": data, "f": cost, "g": ca.vertcat(*rows)}
        self._solver = ca.nlpsol("mpc", "ipopt", nlp, options)
        box = np.tile(p.input_bounds, (1, n))
        slacks = np.tile(np.where(soft, np.inf, 0.0), n)
        self._lower = np.concatenate([np.full(nx * n, -np.inf), box[0], np.zeros(nx * n)])
        self._upper = np.concatenate([np.full(nx * n, np.inf), box[1], slacks])
        self._rows = np.concatenate(low), np.concatenate(high)

    def plan(
        self, start: np.ndarray, before: np.ndarray, reference: np.ndarray, guess: np.ndarray
    ) -> np.ndarray | None:
        """Return the inputs (N, nu), or None if IPOPT did not converge.

        Args:
            start: (nx,).
            before: (nu,), the input before.
            reference: (N, nx).
            guess: (nu,), input along which the first guess is rolled out.
        """
        n, nx, nu = self.problem.horizon, self._nx, self._nu
        states, x = [], start
        for _ in range(n):
            x = np.array(ca.DM(self.problem.model(ca.DM(x), ca.DM(guess)))).ravel()
            states.append(x)
        first = np.concatenate([np.ravel(states), np.tile(guess, n), np.zeros(nx * n)])
        answer = self._solver(
            x0=first, p=np.concatenate([start, before, reference.ravel()]),
            lbx=self._lower, ubx=self._upper, lbg=self._rows[0], ubg=self._rows[1],
        )  # fmt: skip
        if not self._solver.stats()["success"]:
            return None
        return np.asarray(answer["x"]).ravel()[nx * n : (nx + nu) * n].reshape(n, nu)
