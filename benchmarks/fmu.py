"""Steps a second of an FMU whose instance is kept, and of one made anew each episode:

python -m benchmarks.fmu plant.fmu --observations y --actions u
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from zoac.envs import FmuEnv


def steps_a_second(env: FmuEnv, episodes: int, anew: bool) -> float:
    action, steps = np.zeros(env.action_space.shape), 0
    begun = time.perf_counter()
    for episode in range(episodes):
        env.reset(seed=episode)
        over = False
        while not over:
            *_, terminated, truncated, _ = env.step(action)
            over, steps = terminated or truncated, steps + 1
        if anew:
            env.close()
    return steps / (time.perf_counter() - begun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path")
    parser.add_argument("--observations", nargs="+", required=True)
    parser.add_argument("--actions", nargs="+", required=True)
    parser.add_argument("--step-size", type=float, default=0.05)
    parser.add_argument("--stop-time", type=float, default=5.0)
    parser.add_argument("--episodes", type=int, default=50)
    given = parser.parse_args()
    env = FmuEnv(
        given.path, observations=given.observations, actions=given.actions,
        step_size=given.step_size, stop_time=given.stop_time, cost=lambda values: 0.0,
    )  # fmt: skip
    steps_a_second(env, 2, anew=False)
    for told, anew in (("kept", False), ("made anew", True)):
        print(f"{told}: {steps_a_second(env, given.episodes, anew):,.0f} steps a second")


if __name__ == "__main__":
    main()
