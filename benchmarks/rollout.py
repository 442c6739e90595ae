"""Environment steps per second of the engine without learning: `python -m benchmarks.rollout`.

Drive PID-ACC through segments of ZOAC's length (10 steps) and through whole episodes, for several
numbers of environments, in one process.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.pid_acc import PidAcc


def steps_per_second(num_envs: int, horizon: int | None, seconds: float = 2.0) -> float:
    """Return the rate of `num_envs` environments; `horizon` None: whole episodes."""
    task = PidAcc()
    x = task.space.normalise(task.baseline)
    group = RolloutEngine(task, range(num_envs), range(num_envs))
    repeat = 1 if horizon is None else 4
    proposals = [
        Proposal(x, env_index, horizon) for _ in range(repeat) for env_index in range(num_envs)
    ]
    group.rollout(proposals)  # compiles
    steps, begun = 0, time.perf_counter()
    while (spent := time.perf_counter() - begun) < seconds:
        steps += sum(s.length for s in group.rollout(proposals))
    return steps / spent


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    print("environments  segments of 10 [steps/s]  whole episodes [steps/s]")
    for num_envs in (1, 10, 100, 1000):
        rates = [steps_per_second(num_envs, horizon) for horizon in (10, None)]
        print(f"{num_envs:5d}  {rates[0]:24,.0f}  {rates[1]:24,.0f}")


if __name__ == "__main__":
    np.seterr(all="raise")
    main()
