"""Part of a run's processor time that saving and restoring a MuJoCo environment takes:

python -m benchmarks.snapshots

It needs Gymnasium's MuJoCo environments: pip install 'gymnasium[mujoco]'.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from typing import Any

import gymnasium
import numpy as np

import zoac
from zoac.envs.gymnasium_adapter import GymnasiumVecEnv
from zoac.envs.single_env import single_env
from zoac.tasks.user_task import UserTask, user_task

SECONDS = {"state": 0.0, "restore": 0.0}


class TimedVecEnv(GymnasiumVecEnv):
    def state(self, *arguments: Any) -> Any:
        return _timed("state", super().state, *arguments)

    def restore(self, *arguments: Any) -> Any:
        return _timed("restore", super().restore, *arguments)


class TimedTask(UserTask):
    def make_env(self, n: int) -> GymnasiumVecEnv:
        make = partial(single_env, self._env)
        return TimedVecEnv([make() for _ in range(n)], None, make=make)


def _timed(name: str, method: Any, *arguments: Any) -> Any:
    begun = time.process_time()
    result = method(*arguments)
    SECONDS[name] += time.process_time() - begun
    return result


def linear(parameters: dict[str, float], seen: np.ndarray) -> np.ndarray:
    gains = np.array(list(parameters.values())).reshape(-1, len(seen))
    return gains @ seen


def timed_task(name: str) -> TimedTask:
    env = gymnasium.make(name)
    size = int(np.prod(env.observation_space.shape) * np.prod(env.action_space.shape))
    space = {f"k{i}": (-1.0, 1.0) for i in range(size)}
    task = user_task(env=name, controller=linear, space=space)
    task.__class__ = TimedTask
    return task


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env", default="Swimmer-v5")
    parser.add_argument("--tuner", default="zoac_plus")
    parser.add_argument("--budget", type=int, default=30_000)
    given = parser.parse_args()
    task = timed_task(given.env)
    print(f"restorable: {task.restore_fault or 'yes'}")
    SECONDS.update(state=0.0, restore=0.0)
    begun = time.process_time()
    zoac.tune(task=task, tuner=given.tuner, budget=given.budget, episodes=1, final_episodes=2,
              executor="serial", quiet=True)  # fmt: skip
    whole = time.process_time() - begun
    for name, seconds in SECONDS.items():
        print(f"{name}: {100 * seconds / whole:.1f}% of {whole:.1f} s")


if __name__ == "__main__":
    main()
