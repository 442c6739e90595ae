"""Steps per second of a user's environment, beside a bare loop: `python -m benchmarks.user_env`.

The same controller drives ten environments `Pendulum-v1` once in a loop as anyone would write it
and once through zoac's engine, turn about, in one process. Processor seconds are compared, so that
other work of the machine counts little; the median of the ratios is printed.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import gymnasium
import numpy as np

from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.user_task import user_task

ENV, NUM_ENVS, EPISODES = "Pendulum-v1", 10, 5
GAINS = {"kp": 10.0, "kd": 2.5}


def act(params: dict[str, Any], obs: np.ndarray) -> np.ndarray:
    """Return the torque of a PD controller."""
    return np.array([-params["kp"] * obs[1] - params["kd"] * obs[2]])


def bare() -> float:
    """Return steps per processor second of a loop without zoac."""
    envs = [gymnasium.make(ENV) for _ in range(NUM_ENVS)]
    begun, steps = time.process_time(), 0
    for seed in range(EPISODES):
        for env in envs:
            obs, _ = env.reset(seed=seed)
            over = False
            while not over:
                obs, _, terminated, truncated, _ = env.step(act(GAINS, obs))
                over, steps = terminated or truncated, steps + 1
    return steps / (time.process_time() - begun)


def by_zoac(engine: RolloutEngine) -> float:
    """Return the same of zoac's engine, which records every step and checks every number."""
    begun = time.process_time()
    asked = [Proposal(np.zeros(len(GAINS)), i) for _ in range(EPISODES) for i in range(NUM_ENVS)]
    steps = sum(segment.length for segment in engine.rollout(asked))
    return steps / (time.process_time() - begun)


def main() -> None:
    """Print one line for each turn and the median of the ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=9)
    turns = parser.parse_args().turns
    space = {name: (0.0, 2.0 * gain) for name, gain in GAINS.items()}
    task = user_task(env=ENV, controller=act, space=space)
    engine = RolloutEngine(task, range(NUM_ENVS), range(NUM_ENVS))
    ratios = []
    for _ in range(turns):
        alone, through = bare(), by_zoac(engine)
        ratios.append(through / alone)
        print(f"bare {alone:,.0f} steps/s, zoac {through:,.0f} steps/s: {ratios[-1]:.2f}")
    print(f"median ratio {statistics.median(ratios):.2f} over {turns} turns")


if __name__ == "__main__":
    main()
