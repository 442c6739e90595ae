"""How close the MPC is to its nonlinear programme: `python -m benchmarks.mpc_agreement`.

The reference is that programme solved to convergence by CasADi + IPOPT, written independently
(tests/mpc_tracking/oracle.py). Actions are compared in the states that the reference visits, costs
in each controller's own closed loop.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from tests.mpc_tracking.oracle import NonlinearMpc
from zoac.core.controller import Diagnostics, Memory, Parameters
from zoac.core.seeding import stream, stream_seed
from zoac.core.segments import Proposal, Segment
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver
from zoac.mpc.sqp import MpcOptions
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.task import Task
from zoac.tasks.mpc_tracking import MpcTracking
from zoac.tasks.mpc_tracking.controller import NOMINAL, SPACE
from zoac.tasks.mpc_tracking.vehicle import INPUT_HIGH, INPUT_LOW

SOLVER = ClarabelSolver()
VARIANTS = {
    "1": MpcOptions(linearisations=1),
    "2": MpcOptions(linearisations=2),
    "3": MpcOptions(linearisations=3),
    "5": MpcOptions(linearisations=5),
    "converged": MpcOptions(linearisations="converged"),
    "1, shifted plan": MpcOptions(linearisations=1, initial_guess="shifted"),
}


class Ipopt:
    """The nonlinear programme as a controller; zero input where IPOPT does not converge."""

    def __init__(self) -> None:
        self._mpc = NonlinearMpc(SPACE.names)

    def init(self, n: int) -> Memory:
        return {}

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        values = np.stack([params[name] for name in SPACE.names], axis=1)
        plans = [self._mpc.plan(v, o) for v, o in zip(values, obs, strict=True)]
        actions = np.stack([np.zeros(2) if plan is None else plan[0] for plan in plans])
        return actions, memory, {"failed": np.array([plan is None for plan in plans])}


class IpoptTracking(MpcTracking):
    """The task with the reference controller."""

    def make_controller(self) -> Ipopt:  # type: ignore[override]
        return Ipopt()


def episodes(task: Task, x: np.ndarray, starts: int) -> list[Segment]:
    """Return `starts` episodes for each row of `x`, the same starts for all."""
    group = RolloutEngine(task, range(10), range(10))
    proposals = [
        Proposal(row, env_index=k % 10, seed=stream_seed(0, "agreement", k))
        for row in x
        for k in range(starts)
    ]
    return group.rollout(proposals)


def replayed(options: MpcOptions, reference: Sequence[Segment]) -> np.ndarray:
    """Return the actions (steps, 2) of a controller in the states of `reference`."""
    controller = MpcTracking(solver=SOLVER, mpc=options).make_controller()
    actions = []
    memory = controller.init(len(reference))
    for t in range(max(s.length for s in reference)):
        obs = np.stack([s.observations[min(t, s.length - 1)] for s in reference])
        params = SPACE.denormalise(np.stack([s.proposal.x for s in reference]))
        action, memory, _ = controller.act(params, obs, memory)
        actions.append(action)
    return np.concatenate([np.array(actions)[: s.length, i] for i, s in enumerate(reference)])


def table(name: str, x: np.ndarray, starts: int) -> None:
    """Print one table of disagreement over the parameter vectors `x` (n, 19)."""
    reference = episodes(IpoptTracking(solver=SOLVER), x, starts)
    failed = np.concatenate([s.diagnostics["failed"] for s in reference])
    actions = np.concatenate([s.commands for s in reference])[~failed]
    costs = np.array([s.costs.sum() for s in reference])
    print(f"\n{name}: {len(x)} parameter vectors x {starts} starts, {len(actions)} states")
    print(f"IPOPT: not converged in {failed.sum()} states; mean cost {costs.mean():.6f}")
    print("| linearisations | off by > 1e-4 | off by > 1% | largest | cost: median | 90% | mean |")
    print("|---|---|---|---|---|---|---|")
    for label, options in VARIANTS.items():
        own = episodes(MpcTracking(solver=SOLVER, mpc=options), x, starts)
        relative = np.abs(np.array([s.costs.sum() for s in own]) / costs - 1)
        mean = sum(s.costs.sum() for s in own) / costs.sum() - 1
        off = np.abs(replayed(options, reference)[~failed] - actions) / (INPUT_HIGH - INPUT_LOW)
        off = off.max(axis=1)
        print(
            f"| {label} | {np.mean(off > 1e-4):.2%} | {np.mean(off > 1e-2):.2%} | {off.max():.1e} "
            f"| {np.median(relative):.1e} | {np.quantile(relative, 0.9):.1e} | {mean:+.1e} |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vectors", type=int, default=20, help="random parameter vectors")
    parser.add_argument("--starts", type=int, default=2, help="starts for each")
    arguments = parser.parse_args()
    table("nominal parameters", SPACE.normalise(NOMINAL)[None], arguments.starts)
    x = stream(0, "agreement").uniform(-1.0, 1.0, (arguments.vectors, SPACE.dimension))
    table("the whole box", x, arguments.starts)


if __name__ == "__main__":
    main()
