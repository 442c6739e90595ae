"""Solve with bounds on states over random parameters and states, and count every status.

python -m stress.mpc_bounds --solves 100000

Half of the solves are the vehicle's, with parameters from the whole box of `mpc_tracking`, a
quarter each the cart-pole's and the reactor's, with weights of five decades. Bounds and penalties
are random; every fifth batch has hard bounds.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from benchmarks.mpc_robustness import random_observations
from tests.mpc.systems import cart_pole, reactor, vehicle
from zoac.mpc import Mpc
from zoac.mpc.problem import LinearisedProblem, Solution, Status
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver

BATCH = 250
NEAR = 1e-5


class Counting(ClarabelSolver):
    """Count solves, those that end in each status, and those with a bound on a state active."""

    def __init__(self) -> None:
        super().__init__()
        self.statuses: Counter[tuple[str, str]] = Counter()
        self.solves = self.active = self.not_finite = self.without_plan = 0

    def solve(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        """See `Solver`."""
        answer = super().solve(problem, robust)
        kind = "robust" if robust else "fast"
        for status in answer.status:
            self.statuses[kind, Status(status).name] += 1
        # A failed solve is followed by a robust one, unless its numbers are not finite.
        self.without_plan += int((answer.status != Status.SOLVED).sum()) if robust else 0
        self.not_finite += int((~np.isfinite(answer.inputs)).sum())
        if not robust:
            self.solves += len(answer.status)
            self.active += int(at_bounds(problem, answer.inputs).sum())
        return answer


def at_bounds(problem: LinearisedProblem, inputs: np.ndarray) -> np.ndarray:
    """Tell for each plan (n,) whether a state is at one of its bounds, or beyond."""
    bounds, moved = problem.bounds, np.zeros_like(problem.states[:, 0])
    active = np.zeros(len(inputs), bool)
    assert bounds is not None
    for k in range(inputs.shape[1]):
        moved = np.einsum("nij,nj->ni", problem.a[:, k], moved)
        moved += np.einsum("nij,nj->ni", problem.b[:, k], inputs[:, k] - problem.inputs[:, k])
        x = problem.states[:, k + 1] + moved
        near = NEAR * (1.0 + np.abs(x))
        active |= ((x > bounds.high - near) | (x < bounds.low + near)).any(axis=1)
    return active


def random_params(mpc: Mpc, rng: np.random.Generator, model: dict) -> dict[str, np.ndarray]:
    """Return a batch of parameters: weights over five decades, bounds and penalties over one."""
    params = {}
    for name, value in mpc.numbers.values.items():
        kind = name.split("_")[0]
        if kind in ("weight", "terminal", "rate") and name.count("_") < 3 and value > 0.0:
            params[name] = value * 10.0 ** rng.uniform(-2.5, 2.5, BATCH)
        elif kind == "penalty":
            params[name] = value * 10.0 ** rng.uniform(-2.0, 1.0, BATCH)
        elif name in model:
            params[name] = rng.uniform(*model[name], BATCH)
    return params


def batches(hard: bool, solver: Counting) -> list:
    """Return a function of a generator for each system, which makes and solves one batch."""
    options = {"solver": solver, "linearisations": 2}
    roads = vehicle(1, 0, **options, hard=("v", "omega") if hard else ()).mpc
    poles = cart_pole(
        1, 0, **options, **({"hard": ("position", "angle"), "penalty": None} if hard else {}),
        terminal=None,
    ).mpc  # fmt: skip
    tanks = reactor(1, 0, **options, **({"hard": ("reactor", "b"), "penalty": None} if hard else {
        "hard": ()})).mpc  # fmt: skip
    box = {"I_z": (1e3, 2e3), "k_f": (-16e4, -8e4), "k_r": (-16e4, -8e4), "l_f": (0.8, 2.2),
           "l_r": (0.8, 2.2), "m": (1e3, 2e3), "low_v": (-1.0, 0.0), "high_v": (0.0, 1.0),
           "low_omega": (-0.5, 0.0), "high_omega": (0.0, 0.5)}  # fmt: skip
    rod = {"pole": (0.05, 0.2), "half": (0.3, 0.8), "low_position": (-1.5, -0.2),
           "high_position": (0.2, 1.5), "high_angle": (0.02, 0.3)}  # fmt: skip
    heat = {"volume": (9.0, 11.0), "high_reactor": (113.0, 117.0), "high_b": (1.0, 1.3)}

    def act(mpc: Mpc, rng: np.random.Generator, obs: np.ndarray, model: dict) -> np.ndarray:
        return mpc.act(random_params(mpc, rng, model), obs, mpc.init(BATCH))[0]

    def of_vehicle(rng: np.random.Generator) -> np.ndarray:
        return act(roads, rng, random_observations(BATCH, rng), box)

    def of_cart_pole(rng: np.random.Generator) -> np.ndarray:
        return act(poles, rng, rng.uniform(-1.0, 1.0, (BATCH, 4)) * (1.5, 1.0, 0.4, 1.0), rod)

    def of_reactor(rng: np.random.Generator) -> np.ndarray:
        start = np.array([2.0, 1.0, 113.5, 112.0])
        return act(tanks, rng, start + rng.uniform(-1, 1, (BATCH, 4)) * (0.5, 0.3, 2, 2), heat)

    return [of_vehicle, of_cart_pole, of_vehicle, of_reactor]


def main() -> None:
    """Solve and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--solves", type=int, default=100_000)
    options = parser.parse_args()
    solvers, rng = {"soft": Counting(), "hard": Counting()}, np.random.default_rng(0)
    made = {kind: batches(kind == "hard", solver) for kind, solver in solvers.items()}
    count = not_finite = 0
    while sum(solver.solves for solver in solvers.values()) < options.solves:
        actions = made["hard" if count % 5 == 4 else "soft"][(count // 5 + count) % 4](rng)
        not_finite += int((~np.isfinite(actions)).sum())
        count += 1
    print(f"{not_finite} inputs applied that are not finite")
    for kind, solver in solvers.items():
        print(
            f"{kind} bounds: {solver.solves} solves, a state's bound active in "
            f"{solver.active / solver.solves:.1%}; {solver.not_finite} inputs planned that are not "
            f"finite; {solver.without_plan} without a plan after a second attempt"
        )
        for (attempt, name), number in sorted(solver.statuses.items()):
            print(f"{number:9d} {attempt:6s} {name}: {Status[name].sentence}")
        total = sum(n for (attempt, _), n in solver.statuses.items() if attempt == "fast")
        print(f"every status accounted for: {total == solver.solves}")


if __name__ == "__main__":
    main()
