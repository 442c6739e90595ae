"""Solve over the whole box and count every status: `python -m benchmarks.mpc_robustness`."""

from __future__ import annotations

import argparse

import numpy as np

from tests.mpc.problems import box_points, duality_gap, objective, tracking_problems
from zoac.core.seeding import stream
from zoac.mpc.problem import Status
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.solvers.cvxpy_qp import CvxpySolver
from zoac.tasks.mpc_tracking import TrackingMpc, path
from zoac.tasks.mpc_tracking.controller import SPACE

BATCH = 1000


def random_observations(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return observations (n, 81) of states anywhere inside the limits that end an episode."""
    observations = np.empty((n, 81))
    x = rng.uniform(0.0, 1200.0, n)  # one period of the path
    lateral = np.array([path.lateral(value) for value in x])
    heading = np.array([path.heading(value) for value in x])
    observations[:, 0] = x
    observations[:, 1] = lateral + rng.uniform(-4.0, 4.0, n)
    observations[:, 2] = heading + rng.uniform(-np.pi / 4, np.pi / 4, n)
    observations[:, 3] = rng.uniform(14.0, 22.0, n)
    observations[:, 4] = rng.uniform(-2.0, 2.0, n)
    observations[:, 5] = rng.uniform(-1.0, 1.0, n)
    for row in observations:
        path.preview(row[0], row[6:])
    return observations


def compare_paths(n: int) -> None:
    """Print the distance of the Clarabel and CVXPY paths from each other and from the optimum."""
    problem = tracking_problems(box_points(n, seed=0), seed=0)
    plans = [solver.solve(problem) for solver in (ClarabelSolver(), CvxpySolver())]
    fast, plain = (objective(problem, plan.inputs) for plan in plans)
    print(
        f"{n} problems, half of them at corners of the box, all solved by both paths: "
        f"{all((plan.status == Status.SOLVED).all() for plan in plans)}"
    )
    print(
        f"relative difference of the optimal values: at most {np.abs(fast / plain - 1).max():.1e}"
    )
    for name, plan, value in zip(("clarabel", "cvxpy"), plans, (fast, plain), strict=True):
        gap = duality_gap(problem, plan.inputs) / value
        print(f"{name}: duality gap, relative: median {np.median(gap):.1e}, most {gap.max():.1e}")


def stress(wanted: int) -> None:
    """Plan from random states until `wanted` programmes are solved; print every status."""
    rng = stream(0, "robustness")
    controller = TrackingMpc(ClarabelSolver())
    solves = retried = not_finite = 0
    statuses = np.zeros(len(Status), dtype=np.int64)
    while solves < wanted:
        z = rng.uniform(-1.0, 1.0, (BATCH, SPACE.dimension))
        observations = random_observations(BATCH, rng)
        actions, _, diagnostics = controller.act(SPACE.denormalise(z), observations, {})
        solves += int(diagnostics["linearisations"].sum())
        retried += int(diagnostics["solver_retried"].sum())
        not_finite += int((~np.isfinite(actions)).sum())
        statuses += np.bincount(diagnostics["solver_status"], minlength=len(Status))
    print(f"{solves} solves, {statuses.sum()} steps; {not_finite} actions not finite")
    print(f"steps that needed a robust solve: {retried}")
    for status in Status:
        print(f"{statuses[status]:8d} {status.name}: {status.sentence}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--solves", type=int, default=100_000)
    parser.add_argument("--compare", type=int, default=1000, help="problems for both paths")
    arguments = parser.parse_args()
    compare_paths(arguments.compare)
    stress(arguments.solves)


if __name__ == "__main__":
    main()
