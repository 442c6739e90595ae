"""Environment steps per second of serial and process executors: `python -m benchmarks.executors`.

Drive ten environments of mpc_tracking at the baseline parameters through iterations of ZOAC's
shape. The executors take turns, so that the ratio stays valid when the machine's speed changes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

import zoac
from zoac.core.segments import Proposal
from zoac.rollout.executors.base import Executor, Serial
from zoac.rollout.executors.process import Process


def steps_per_second(
    solver: str, num_envs: int, workers: Sequence[int], rounds: int
) -> dict[int, list[float]]:
    """Return each round's rate for each number of workers, of which 0 means serial."""
    task = zoac.make_task("mpc_tracking", mpc_solver=solver)
    assert task.baseline is not None
    x = task.space.normalise(task.baseline)
    proposals = [Proposal(x, env_index, 20) for _ in range(5) for env_index in range(num_envs)]
    executors: dict[int, Executor] = {
        count: Process(workers=count) if count else Serial() for count in workers
    }
    rates: dict[int, list[float]] = {count: [] for count in workers}
    for executor in executors.values():
        executor.start(task, num_envs, seed=0)
        executor.rollout(proposals)  # compiles
    for _ in range(rounds):
        for count, executor in executors.items():
            begun = time.perf_counter()
            steps = sum(segment.length for segment in executor.rollout(proposals))
            rates[count].append(steps / (time.perf_counter() - begun))
    for executor in executors.values():
        executor.close()
    return rates


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--solver", default="clarabel")
    parser.add_argument("--environments", type=int, default=10)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    if options.workers < 1:
        parser.error("--workers: at least 1; serial is always the other side")
    rates = steps_per_second(options.solver, options.num_envs, (0, options.workers), options.rounds)
    serial, process = (np.array(measured) for measured in rates.values())
    for name, measured in (("serial", serial), ("process", process)):
        print(f"{name:8} {np.median(measured):10,.0f} steps/s")
    ratios = process / serial
    print(
        f"process / serial, {options.workers} workers, {options.solver}: median "
        f"{np.median(ratios):.2f} (from {ratios.min():.2f} to {ratios.max():.2f})"
    )


if __name__ == "__main__":
    main()
