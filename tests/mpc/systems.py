"""Three systems: each an `Mpc`, the same problem for IPOPT, and states to begin at."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from tests.mpc.oracle import Problem, runge_kutta
from tests.mpc_tracking.oracle import bicycle
from zoac.mpc import CasadiModel, Mpc
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.tasks.mpc_tracking import MpcTrackingVecEnv
from zoac.tasks.mpc_tracking.vehicle import BicycleModel

INF = np.inf
SOLVER = ClarabelSolver()
"""Shared, since a layout takes a third of a second to prepare."""


DEFAULTS = {"linearisations": "converged", "solver": SOLVER}


@dataclass
class System:
    """One problem, twice.

    Args:
        mpc: By zoac.
        problem: For IPOPT.
        observations: (n, o), random.
        references: (n, N, nx), what they mean.
        before: (nu,), the input before.
        guess: (nu,), what IPOPT's first guess is rolled out along.
    """

    mpc: Mpc
    problem: Problem
    observations: np.ndarray
    references: np.ndarray
    before: np.ndarray
    guess: np.ndarray


def cart_pole_derivative(x, u, p):
    """Gymnasium's cart-pole, upright at 0 [m, m/s, rad, rad/s], under a force [N]."""
    sin, cos = np.sin(x.angle), np.cos(x.angle)
    total = p.cart + p.pole
    push = (u.force + p.pole * p.half * x.rate**2 * sin) / total
    turn = (9.8 * sin - cos * push) / (p.half * (4.0 / 3.0 - p.pole * cos**2 / total))
    return x.speed, push - p.pole * p.half * turn * cos / total, x.rate, turn


def _cart_pole(x, u):
    """The same, from Lagrange's equations of a cart and a uniform rod of length 1."""
    mass, rod, length, gravity = 1.0, 0.1, 0.5, 9.8
    inertia = rod * (2 * length) ** 2 / 12
    matrix = ca.vertcat(
        ca.horzcat(mass + rod, rod * length * ca.cos(x[2])),
        ca.horzcat(rod * length * ca.cos(x[2]), inertia + rod * length**2),
    )
    force = ca.vertcat(
        u[0] + rod * length * x[3] ** 2 * ca.sin(x[2]), rod * gravity * length * ca.sin(x[2])
    )
    second = ca.solve(matrix, force)
    return ca.vertcat(x[1], second[0], x[3], second[1])


def cart_pole(n: int, seed: int, **options) -> System:
    """Cross terms, rates, the Riccati terminal weight, soft bounds on position and angle."""
    stage = np.diag([1.0, 0.1, 10.0, 0.1, 0.02])
    stage[0, 2] = stage[2, 0] = 1.0
    stage[2, 4] = stage[4, 2] = 0.1
    states = ("position", "speed", "angle", "rate")
    model = CasadiModel(
        states, ["force"], {"cart": 1.0, "pole": 0.1, "half": 0.5},
        derivative=cart_pole_derivative, sample_time=0.05,
    )  # fmt: skip
    given = {
        "weights": {
            "position": 1.0, "speed": 0.1, "angle": 10.0, "rate": 0.1, "force": 0.02,
            ("position", "angle"): 1.0, ("angle", "force"): 0.1,
        },
        "terminal": "riccati",
        "rate_weights": {"force": 0.01},
        "rate_bounds": {"force": 6.0},
        "bounds": {"force": (-10.0, 10.0), "position": (-0.7, 0.7), "angle": (None, 0.12)},
        "penalty": {"position": 1e3, "angle": 1e3},
        "reference": {"position": 0.5},
        "discount": 0.98,
    }  # fmt: skip
    mpc = Mpc(model, 20, **{**DEFAULTS, **given, **options})
    advance = runge_kutta(_cart_pole, 0.05)
    goal = np.array([0.5, 0.0, 0.0, 0.0])
    problem = Problem(
        model=advance, horizon=20, stage=stage,
        terminal=cost_to_go(advance, goal, np.zeros(1), stage, 0.98),
        rate=np.array([0.01]), input_bounds=np.array([[-10.0], [10.0]]),
        state_bounds=np.array([[-0.7, -INF, -INF, -INF], [0.7, INF, 0.12, INF]]),
        penalty=np.full(4, 1e3), max_rate=np.array([6.0]), discount=0.98,
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    starts = rng.uniform(-1.0, 1.0, (n, 4)) * (0.8, 0.8, 0.2, 0.6)
    return System(mpc, problem, starts, np.broadcast_to(goal, (n, 20, 4)), np.zeros(1), np.zeros(1))


def vehicle(n: int, seed: int, **options) -> System:
    """The paper's, with bounds on lateral velocity and yaw rate, the latter hard."""
    names = ("x", "y", "phi", "u", "v", "omega")
    stage, terminal = [0.01, 0.4, 1.0, 0.1, 0.01, 0.2], [0.1, 1.0, 2.0, 0.1, 0.1, 0.2]
    limit = 2.0 * np.pi / 15.0
    given = {
        "weights": dict(zip((*names, "delta", "a"), (*stage, 5.0, 0.05), strict=True)),
        "terminal": dict(zip(names, terminal, strict=True)),
        "bounds": {
            "delta": (-limit, limit), "a": (-3.0, 3.0), "v": (-0.25, 0.25), "omega": (-0.4, 0.4),
        },
        "penalty": 1e4,
        "hard": "omega",
        "reference": {
            "x": slice(6, 81, 3), "y": slice(7, 81, 3), "phi": slice(8, 81, 3), "u": 18.0,
        },
        "discount": 0.99,
    }  # fmt: skip
    mpc = Mpc(BicycleModel(), 25, **{**DEFAULTS, **given, **options})
    theta = {
        "I_z": 1536.7,
        "k_f": -128916.0,
        "k_r": -85944.0,
        "l_f": 1.06,
        "l_r": 1.85,
        "m": 1412.0,
    }

    problem = Problem(
        model=lambda x, u: bicycle(x, u, theta), horizon=25,
        stage=np.diag([*stage, 5.0, 0.05]), terminal=np.diag(terminal), rate=np.zeros(2),
        input_bounds=np.array([[-limit, -3.0], [limit, 3.0]]),
        state_bounds=np.array([[-INF] * 4 + [-0.25, -0.4], [INF] * 4 + [0.25, 0.4]]),
        penalty=np.array([INF] * 4 + [1e4, INF]), max_rate=np.full(2, INF), discount=0.99,
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    observations, _ = MpcTrackingVecEnv(n).reset(seed=seed)
    observations[:, 1:6] += rng.uniform(-1.0, 1.0, (n, 5)) * (0.8, 0.1, 1.0, 0.2, 0.1)
    references = np.zeros((n, 25, 6))
    references[:, :, :3] = observations[:, 6:].reshape(n, 25, 3)
    references[:, :, 3] = 18.0
    return System(mpc, problem, observations, references, np.zeros(2), np.zeros(2))


REACTOR = {"volume": 10.01, "cooled": 5.0, "area": 0.215}
HOLD = np.array([14.19, -1113.5])
"""Inputs that hold the reactor near (2.14, 1.09, 114.2, 112.9), Klatt and Engell's set-point."""
AT_REST = np.array([2.14, 1.09, 114.2, 112.9])


def reactor_derivative(x, u, p):
    """Klatt and Engell's reactor A -> B -> C, 2 A -> D, with concentrations [mol/l], temperatures
    [C], feed u.feed = F / V [1/h] and heat u.heat [kJ/h]; time in hours."""
    kelvin = x.reactor + 273.15
    first, second = 1.287e12 * np.exp(-9758.3 / kelvin), 9.043e9 * np.exp(-8560.0 / kelvin)
    density, heat_of_liquid = 0.9342, 3.01
    made = first * x.a * 4.2 + first * x.b * -11.0 + second * x.a**2 * -41.85
    flow = 4032.0 * p.area / (density * heat_of_liquid * p.volume) * (x.jacket - x.reactor)
    return (
        u.feed * (5.1 - x.a) - first * x.a - second * x.a**2,
        -u.feed * x.b + first * (x.a - x.b),
        u.feed * (130.0 - x.reactor) + flow - made / (density * heat_of_liquid),
        (u.heat + 4032.0 * p.area * (x.reactor - x.jacket)) / (p.cooled * 2.0),
    )


def _reactor(x, u):
    """The same from the published equations and numbers."""
    k1 = 1.287e12 * ca.exp(-9758.3 / (x[2] + 273.15))
    k3 = 9.043e9 * ca.exp(-8560.0 / (x[2] + 273.15))
    reaction = k1 * x[0] * 4.2 - k1 * x[1] * 11.0 - k3 * x[0] ** 2 * 41.85
    return ca.vertcat(
        u[0] * (5.1 - x[0]) - k1 * x[0] - k3 * x[0] ** 2,
        -u[0] * x[1] + k1 * x[0] - k1 * x[1],
        u[0] * (130.0 - x[2])
        + 4032.0 * 0.215 / (0.9342 * 3.01 * 10.01) * (x[3] - x[2])
        - reaction / (0.9342 * 3.01),
        (u[1] + 4032.0 * 0.215 * (x[2] - x[3])) / (5.0 * 2.0),
    )


def reactor(n: int, seed: int, **options) -> System:
    """References of inputs, a full terminal matrix, a hard temperature, a soft concentration."""
    states = ("a", "b", "reactor", "jacket")
    given = {
        "weights": {"a": 0.0, "b": 100.0, "reactor": 1e-3, "feed": 1e-3, "heat": 1e-8},
        "terminal": {"b": 500.0, "reactor": 5e-3, ("b", "reactor"): 0.2},
        "rate_weights": {"feed": 1e-3, "heat": 1e-7},
        "bounds": {
            "feed": (5.0, 35.0), "heat": (-8500.0, 0.0), "reactor": (None, 115.5), "b": (0.9, 1.2),
        },
        "hard": ["reactor"],
        "penalty": 1e5,
        "reference": {"a": 2.14, "b": 1.09, "reactor": 114.2, "feed": 14.19, "heat": -1113.5},
        "initial_input": {"feed": 14.19, "heat": -1113.5},
    }  # fmt: skip
    model = CasadiModel(
        states, ["feed", "heat"], REACTOR, derivative=reactor_derivative, sample_time=0.005,
        substeps=2,
    )  # fmt: skip
    mpc = Mpc(model, 20, **{**DEFAULTS, **given, **options})
    terminal = np.diag([0.0, 500.0, 5e-3, 0.0])
    terminal[1, 2] = terminal[2, 1] = 0.2
    problem = Problem(
        model=runge_kutta(_reactor, 0.0025, 2), horizon=20,
        stage=np.diag([0.0, 100.0, 1e-3, 0.0, 1e-3, 1e-8]), terminal=terminal,
        rate=np.array([1e-3, 1e-7]), input_bounds=np.array([[5.0, -8500.0], [35.0, 0.0]]),
        state_bounds=np.array([[-INF, 0.9, -INF, -INF], [INF, 1.2, 115.5, INF]]),
        penalty=np.array([INF, 1e5, INF, INF]), max_rate=np.full(2, INF), input_reference=HOLD,
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    starts = AT_REST + rng.uniform(-1.0, 1.0, (n, 4)) * (0.3, 0.2, 0.7, 1.5)
    starts[:, 1:] -= 0.15, 1.0, 1.0  # from where the hard bound can be kept
    goal = np.array([2.14, 1.09, 114.2, 0.0])
    return System(mpc, problem, starts, np.broadcast_to(goal, (n, 20, 4)), HOLD, HOLD)


SYSTEMS = {"cart-pole": cart_pole, "vehicle": vehicle, "reactor": reactor}


def cost_to_go(model, x, u, stage, discount):
    """Return P of the regulator at (x, u), by value iteration."""
    xs, us = ca.SX.sym("x", len(x)), ca.SX.sym("u", len(u))
    after = model(xs, us)
    jacobians = ca.Function("j", [xs, us], [ca.jacobian(after, xs), ca.jacobian(after, us)])
    ab = np.hstack([np.array(j) for j in jacobians(x, u)])
    nx = len(x)
    cost = stage[:nx, :nx]
    for _ in range(1000):
        h = stage + discount * ab.T @ cost @ ab
        cost = h[:nx, :nx] - h[:nx, nx:] @ np.linalg.solve(h[nx:, nx:], h[nx:, :nx])
    return cost
