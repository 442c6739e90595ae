"""Environment steps per second of serial and process executors: `python -m benchmarks.executors`.

Drives ten lanes of mpc_tracking at the nominal parameters through ZOAC-shaped iterations; serial
and process take turns, so that the ratio holds when the machine's speed drifts.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import zoac
from zoac.executor import Executor, Serial
from zoac.process import Process
from zoac.segments import Proposal


def steps_per_second(executor: Executor, proposals: list[Proposal]) -> float:
    begun = time.perf_counter()
    steps = sum(s.length for s in executor.rollout(proposals))
    return steps / (time.perf_counter() - begun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--solver", default="clarabel")
    parser.add_argument("--lanes", type=int, default=10)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    task = zoac.make_task("mpc_tracking", mpc_solver=options.solver)
    assert task.nominal is not None
    z = task.space.unit(task.nominal)
    proposals = [Proposal(z, lane, 20) for _ in range(5) for lane in range(options.lanes)]
    executors = {"serial": Serial(), "process": Process(workers=options.workers)}
    rates: dict[str, list[float]] = {name: [] for name in executors}
    for executor in executors.values():
        executor.start(task, options.lanes, seed=0)
        executor.rollout(proposals)  # compiles
    for _ in range(options.rounds):
        for name, executor in executors.items():
            rates[name].append(steps_per_second(executor, proposals))
    for executor in executors.values():
        executor.close()
    for name, measured in rates.items():
        print(f"{name:8} {np.median(measured):10,.0f} steps/s")
    ratios = np.array(rates["process"]) / np.array(rates["serial"])
    print(
        f"process / serial, {options.workers} workers, {options.solver}: median "
        f"{np.median(ratios):.2f} (from {ratios.min():.2f} to {ratios.max():.2f})"
    )


if __name__ == "__main__":
    main()
