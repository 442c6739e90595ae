"""Beside do-mpc (CasADi + IPOPT) on its own example, the stirred-tank reactor of Klatt and Engell.

python -m benchmarks.do_mpc         # needs pip install do-mpc, which zoac does not depend on

The numbers are those of do-mpc's example `CSTR`, nominal: 20 steps of 0.005 h, the price of the
product's distance from 0.6 mol/l and of changes of both inputs, bounds on all states and inputs.
Both controllers run in the same states, those of do-mpc's closed loop, in turn in one process on
one thread. do-mpc plans by collocation, as its example does, and by the Runge-Kutta steps that
zoac takes, which is the same programme: there the first inputs are compared.
"""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import argparse
import time
import warnings
from importlib import import_module
from typing import Any

import casadi as ca
import numpy as np

from zoac.mpc import CasadiModel, Mpc

STATES = ("C_a", "C_b", "T_R", "T_K")
START = np.array([0.8, 0.5, 134.14, 130.0])
LOW, HIGH = np.array([0.1, 0.1, 50.0, 50.0]), np.array([2.0, 2.0, 140.0, 140.0])
INPUT_LOW, INPUT_HIGH = np.array([5.0, -8500.0]), np.array([100.0, 0.0])
HORIZON, DT, SUBSTEPS = 20, 0.005, 2
GOAL = 0.6
RATES, SCALES = np.array([0.1, 1e-3]), np.array([100.0, 2000.0])
"""The example's `rterm`, of inputs in units of its scaling."""


def reactor(x: Any, u: Any, p: Any) -> tuple[Any, ...]:
    """Return the derivative [1/h]."""
    kelvin = x.T_R + 273.15
    k1, k3 = 1.287e12 * np.exp(-9758.3 / kelvin), 9.043e9 * np.exp(-8560.0 / kelvin)
    heat = k1 * x.C_a * 4.2 - k1 * x.C_b * 11.0 - k3 * x.C_a**2 * 41.85
    cooling = 4032.0 * 0.215 * (x.T_R - x.T_K)
    return (
        u.F * (5.1 - x.C_a) - k1 * x.C_a - k3 * x.C_a**2,
        -u.F * x.C_b + k1 * x.C_a - k1 * x.C_b,
        -heat / (0.9342 * 3.01) + u.F * (130.0 - x.T_R) - cooling / (0.9342 * 3.01 * 10.01),
        (u.Q_dot + cooling) / (5.0 * 2.0),
    )


class Names:
    """What `reactor` takes, of do-mpc's variables."""

    def __init__(self, **values: Any) -> None:
        self.__dict__.update(values)


def do_mpc_controller(collocation: bool, tolerance: float) -> Any:
    """Return do-mpc's controller of its example."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        library = import_module("do_mpc")
    model = library.model.Model("continuous" if collocation else "discrete", "SX")
    x = Names(**{name: model.set_variable("_x", name) for name in STATES})
    u = Names(F=model.set_variable("_u", "F"), Q_dot=model.set_variable("_u", "Q_dot"))
    after = reactor(x, u, None)
    if not collocation:
        state = ca.vertcat(*(getattr(x, name) for name in STATES))

        def rate(value: Any) -> Any:
            parts = dict(zip(STATES, ca.vertsplit(value), strict=True))
            return ca.vertcat(*reactor(Names(**parts), u, None))

        h = DT / SUBSTEPS
        for _ in range(SUBSTEPS):
            a = rate(state)
            b = rate(state + h / 2 * a)
            c = rate(state + h / 2 * b)
            d = rate(state + h * c)
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
        after = ca.vertsplit(state)
    for name, value in zip(STATES, after, strict=True):
        model.set_rhs(name, value)
    model.setup()
    mpc = library.controller.MPC(model)
    mpc.settings.n_horizon, mpc.settings.n_robust, mpc.settings.t_step = HORIZON, 0, DT
    mpc.settings.store_full_solution = False
    mpc.settings.nlpsol_opts = {
        "ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0, "ipopt.tol": tolerance,
    }  # fmt: skip
    # The example's own scaling, without which IPOPT takes longer.
    mpc.scaling["_x", "T_R"] = mpc.scaling["_x", "T_K"] = 100.0
    mpc.scaling["_u", "F"], mpc.scaling["_u", "Q_dot"] = SCALES
    error = (x.C_b - GOAL) ** 2
    mpc.set_objective(mterm=error, lterm=error)
    mpc.set_rterm(F=RATES[0], Q_dot=RATES[1])
    for name, low, high in zip(STATES, LOW, HIGH, strict=True):
        mpc.bounds["lower", "_x", name], mpc.bounds["upper", "_x", name] = low, high
    for name, low, high in zip(("F", "Q_dot"), INPUT_LOW, INPUT_HIGH, strict=True):
        mpc.bounds["lower", "_u", name], mpc.bounds["upper", "_u", name] = low, high
    mpc.setup()
    return mpc


class OwnMpc:
    """An `Mpc` of one environment, with its memory."""

    def __init__(self, before: np.ndarray, **options: Any) -> None:
        model = CasadiModel(
            STATES, ("F", "Q_dot"), derivative=reactor, sample_time=DT, substeps=SUBSTEPS
        )
        bounds = dict(zip(STATES, zip(LOW.tolist(), HIGH.tolist(), strict=True), strict=True))
        self.mpc = Mpc(
            model, HORIZON, weights={"C_b": 1.0},
            rate_weights=dict(zip(("F", "Q_dot"), RATES / SCALES**2, strict=True)),
            bounds={**bounds, "F": (5.0, 100.0), "Q_dot": (-8500.0, 0.0)}, hard=STATES,
            reference={"C_b": GOAL},
            initial_input=dict(zip(("F", "Q_dot"), before, strict=True)), **options,
        )  # fmt: skip
        self._memory = self.mpc.init(1)
        self.failures = 0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the inputs (2,)."""
        actions, self._memory, found = self.mpc.act({}, x[None], self._memory)
        self.failures += int(found["solver_failed"][0])
        return actions[0]

    def follow(self, applied: np.ndarray) -> None:
        """Note what was applied in the states that both are shown."""
        self._memory["input"] = applied[None].copy()


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--tolerance", type=float, default=1e-8, help="of IPOPT")
    options = parser.parse_args()
    before = np.array([40.0, -1113.5])
    theirs = {
        name: do_mpc_controller(collocation, options.tolerance)
        for name, collocation in (
            ("do-mpc, collocation (its example)", True),
            ("do-mpc, Runge-Kutta (the same programme)", False),
        )
    }
    own_ones = {
        "zoac, three programmes": OwnMpc(before),
        "zoac, three, shifted plan": OwnMpc(before, initial_guess="shifted"),
        "zoac, one, shifted plan": OwnMpc(before, initial_guess="shifted", linearisations=1),
        "zoac, converged, shifted plan": OwnMpc(
            before, initial_guess="shifted", linearisations="converged"
        ),
    }
    x = START.copy()
    for controller in theirs.values():
        controller.x0, controller.u0 = x[:, None], before[:, None]
        controller.set_initial_guess()
    seconds: dict[str, list[float]] = {name: [] for name in (*theirs, *own_ones)}
    off: dict[str, float] = dict.fromkeys(seconds, 0.0)
    for step in range(options.steps + 1):
        inputs = {}
        for name, controller in theirs.items():
            began = time.thread_time()
            inputs[name] = np.array(controller.make_step(x[:, None])).ravel()
            seconds[name].append(time.thread_time() - began)
        for name, own in own_ones.items():
            began = time.thread_time()
            inputs[name] = own(x)
            seconds[name].append(time.thread_time() - began)
        applied = inputs["do-mpc, Runge-Kutta (the same programme)"]
        for name, value in inputs.items():
            difference = np.abs(value - applied) / (INPUT_HIGH - INPUT_LOW)
            off[name] = max(off[name], float(difference.max())) if step else 0.0
        for own in own_ones.values():
            own.follow(applied)
        for controller in theirs.values():
            controller.u0 = applied[:, None]
        x = own_ones["zoac, three programmes"].mpc.model.predict(
            np.empty((1, 0)), x[None], applied[None]
        )[0]
    fastest = min(float(np.median(seconds[name][1:])) for name in theirs)
    print(f"{options.steps} steps; the first of all is not counted: it compiles")
    for name, spent in seconds.items():
        median = float(np.median(spent[1:]))
        failures = own_ones[name].failures if name in own_ones else 0
        print(
            f"{name:42s} {median * 1e3:7.2f} ms a step, {fastest / median:5.1f} times as fast as "
            f"do-mpc; first input off by at most {off[name]:.1e} of its range, {failures} failures"
        )
    print("final state:", dict(zip(STATES, x.round(3).tolist(), strict=True)))


if __name__ == "__main__":
    main()
