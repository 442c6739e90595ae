"""Steps per second of a user's environment.

    python -m benchmarks.user_env                 # beside a bare loop
    python -m benchmarks.user_env --step-us 200   # two worker processes beside one process

The same controller drives ten environments `Pendulum-v1` once in a loop as anyone would write it
and once through zoac's engine, turn about, in one process. Processor seconds are compared, so that
other work of the machine counts little; the median of the ratios is printed. With `--step-us`, an
environment computes so long at every step; wall seconds are compared, so both cores must be idle.
"""

from __future__ import annotations

import argparse
import statistics
import time
from functools import partial
from typing import Any

import gymnasium
import numpy as np

from zoac.core.segments import Proposal
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.executors.base import Executor, Serial
from zoac.rollout.executors.process import Process
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


class Slow(gymnasium.Env):
    """x follows the action; every step computes for `step_us` microseconds."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def __init__(self, step_us: float) -> None:
        self._seconds, self._x = step_us * 1e-6, 0.0

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        """Start at 1."""
        super().reset(seed=seed)
        self._x = 1.0
        return np.full(3, self._x), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Move by a part of the action."""
        end = time.perf_counter() + self._seconds
        self._x += 0.01 * float(action[0])
        while time.perf_counter() < end:
            pass
        return np.full(3, self._x), -(self._x**2), False, False, {}


def by_processes(step_us: float, turns: int) -> None:
    """Print how many times as fast two worker processes are as one process, turn about."""
    space = {name: (0.0, 2.0 * gain) for name, gain in GAINS.items()}
    task = user_task(env=partial(Slow, step_us), controller=act, space=space, max_episode_steps=200)
    asked = [Proposal(np.zeros(len(GAINS)), i, 20) for _ in range(5) for i in range(NUM_ENVS)]
    executors: list[Executor] = [Serial(), Process(workers=2)]
    for executor in executors:
        executor.start(task, NUM_ENVS, seed=0)
        executor.rollout(asked)
    ratios = []
    for _ in range(turns):
        seconds = []
        for executor in executors:
            begun = time.perf_counter()
            executor.rollout(asked)
            seconds.append(time.perf_counter() - begun)
        ratios.append(seconds[0] / seconds[1])
    for executor in executors:
        executor.close()
    print(f"{step_us:g} us a step: {statistics.median(ratios):.2f} times as fast, {turns} turns")


def main() -> None:
    """Print one line for each turn and the median of the ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=9)
    parser.add_argument("--step-us", type=float, help="microseconds; compares processes instead")
    options = parser.parse_args()
    turns = options.turns
    if options.step_us is not None:
        by_processes(options.step_us, turns)
        return
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
