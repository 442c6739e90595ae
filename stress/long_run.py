"""Long load: `python -m stress.long_run`.

Run both plants with every solver, in segments of 50 steps, with parameters drawn uniformly from the
mapped box. Report exceptions, numbers that are not finite, and how the memory grows.
"""

from __future__ import annotations

import argparse
import gc
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from zoac import make_task
from zoac.core.segments import Proposal, Segment
from zoac.rollout.engine import RolloutEngine

NUM_ENVS, SEGMENT = 10, 50
STEPS = {"pid_acc": 1_000_000, "riccati": 1_000_000, "clarabel": 20_000, "cvxpy": 2_000}


def resident() -> int:
    """Return this process's resident memory [bytes]; Linux."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


def not_finite(segment: Segment) -> int:
    """Return how many numbers of a segment are not finite."""
    arrays = [
        segment.observations,
        segment.actions,
        segment.commands,
        segment.costs,
        *segment.diagnostics.values(),
    ]
    return sum(int((~np.isfinite(np.asarray(a, dtype=np.float64))).sum()) for a in arrays)


def batches(group: RolloutEngine, dimension: int, steps: int) -> Iterator[list[Segment]]:
    """Yield segments with fresh parameters until `steps` are done."""
    rng = np.random.default_rng(0)
    done = 0
    while done < steps:
        z = rng.uniform(-1.0, 1.0, (NUM_ENVS, dimension))
        segments = group.rollout([Proposal(z[i], i, SEGMENT) for i in range(NUM_ENVS)])
        done += sum(s.length for s in segments)
        yield segments


def main() -> None:
    """Load every task and solver."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(STEPS), help=", ".join(STEPS))
    parser.add_argument("--steps", type=int, help="instead of each one's own number")
    parser.add_argument(
        "--linearisations", type=int, default=3, help="a step of the MPC; fewer for slow solvers"
    )
    options = parser.parse_args()
    for name in options.names:
        mpc = {"linearisations": options.linearisations}
        task = (
            make_task(name)
            if name == "pid_acc"
            else make_task("mpc_tracking", mpc_solver=name, mpc=mpc)
        )
        group = RolloutEngine(task, range(NUM_ENVS), range(NUM_ENVS))
        done = bad = failed = terminated = 0
        memory: list[tuple[int, int]] = []
        total = options.steps or STEPS[name]
        for segments in batches(group, task.space.dimension, total):
            done += sum(s.length for s in segments)
            bad += sum(map(not_finite, segments))
            terminated += sum(s.terminated for s in segments)
            failed += sum(int(s.diagnostics.get("solver_failed", np.zeros(1)).sum())
                          for s in segments)  # fmt: skip
            if done >= total * (len(memory) + 1) / 20:
                gc.collect()
                memory.append((done, resident()))
        x, y = np.array(memory[len(memory) // 4 :], dtype=np.float64).T  # after warming up
        slope = np.polyfit(x, y, 1)[0] * 1e5
        print(
            f"{name:9} {done:>9,} steps, no exception; {bad} numbers not finite, {terminated} "
            f"episodes terminated, {failed} solves failed; memory {y[-1] / 2**20:.0f} MiB, "
            f"{slope / 1024:+.1f} KiB per 100,000 steps",
            flush=True,
        )


if __name__ == "__main__":
    main()
