"""Environment steps per second of the engine without learning: `python -m benchmarks.rollout`.

Drives PID-ACC through ZOAC-shaped segments (10 steps) and through whole episodes, for several
numbers of lanes, in one process.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from zoac.rollout import LaneGroup
from zoac.segments import Proposal
from zoac.tasks.pid_acc import PidAcc


def steps_per_second(lanes: int, horizon: int | None, seconds: float = 2.0) -> float:
    """Return the rate at `lanes` lanes for segments of `horizon` steps; None: whole episodes."""
    task = PidAcc()
    z = task.space.unit(task.nominal)
    group = LaneGroup(task, range(lanes), range(lanes))
    repeat = 1 if horizon is None else 4
    proposals = [Proposal(z, lane, horizon) for _ in range(repeat) for lane in range(lanes)]
    group.rollout(proposals)  # compiles
    steps, begun = 0, time.perf_counter()
    while (spent := time.perf_counter() - begun) < seconds:
        steps += sum(s.length for s in group.rollout(proposals))
    return steps / spent


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    print("lanes  segments of 10 [steps/s]  whole episodes [steps/s]")
    for lanes in (1, 10, 100, 1000):
        rates = [steps_per_second(lanes, horizon) for horizon in (10, None)]
        print(f"{lanes:5d}  {rates[0]:24,.0f}  {rates[1]:24,.0f}")


if __name__ == "__main__":
    np.seterr(all="raise")
    main()
