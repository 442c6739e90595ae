"""A loop as a Gymnasium environment, tuned by `zoac.tune` with its defaults under two specs.

    python -m benchmarks.loop_by_tune --seeds 10

The plant 2 / ((0.5 s + 1)(0.2 s + 1)) with a dead time of 0.1 s, inputs within 2 and noise, begins
with the PI gains of Ziegler and Nichols. The answers are compared with a grid over both gains, of
which each point is judged on the same evaluation episodes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import control
import gymnasium as gym
import numpy as np

import zoac
from zoac import specs
from zoac.controllers import tuning_rules
from zoac.controllers.pid import PID
from zoac.core.seeding import stream_seed
from zoac.core.segments import Proposal
from zoac.envs.linear_loop import sampled
from zoac.rollout.engine import RolloutEngine
from zoac.tasks.user_task import user_task

PLANT, DEAD_TIME, SAMPLE_TIME = control.tf([2.0], [0.1, 0.7, 1.0]), 0.1, 0.05
STEPS, LIMIT, NOISE, EPISODES = 120, 2.0, 0.005, 20
SPACE = {"Kp": (0.02, 20.0, "log"), "Ki": (0.02, 20.0, "log")}
SPECS = (specs.overshoot("y", "r", max=0.05), specs.settling_time("y", "r", band=0.02, max=2.0))


class Loop(gym.Env):
    """One loop: observation (y measured, r, y), action u, cost T_s |r - y|."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (3,), np.float64)
    action_space = gym.spaces.Box(-LIMIT, LIMIT, (1,), np.float64)
    metadata = {"sample_time": SAMPLE_TIME}
    plant = sampled(PLANT, SAMPLE_TIME, DEAD_TIME)

    def reset(self, *, seed=None, options=None):
        """Begin an episode."""
        super().reset(seed=seed)
        self.x, self.inputs = np.zeros(2), [0.0] * self.plant.delay
        return self._observe(), {}

    def _observe(self):
        self.y = float(self.plant.c @ self.x)
        return np.array([self.y + NOISE * self.np_random.standard_normal(), 1.0, self.y])

    def step(self, action):
        """Advance by one sample."""
        self.inputs.append(float(np.clip(action[0], -LIMIT, LIMIT)))
        p = self.plant
        self.x = p.a @ self.x + p.b_early * self.inputs.pop(0) + p.b_late * self.inputs[0]
        observation = self._observe()
        return observation, -SAMPLE_TIME * abs(1.0 - self.y), False, False, {}


def arguments() -> dict:
    """Return what `zoac.tune` and `user_task` are given."""
    rule = tuning_rules.gains("ziegler_nichols", PLANT, "PI", DEAD_TIME, SAMPLE_TIME)
    return {
        "env": Loop,
        "controller": PID(sample_time=SAMPLE_TIME, r=1, output_limits=(-LIMIT, LIMIT)),
        "space": SPACE,
        "baseline": {name: rule[name] for name in SPACE},
        "signals": {"y": zoac.observation(2), "r": zoac.observation(1), "u": zoac.action(0)},
        "specs": SPECS,
        "max_episode_steps": STEPS,
    }


def judged(points: Sequence[dict[str, float]]) -> list[tuple[int, float]]:
    """Return in how many of the evaluation episodes each point keeps both specs, and its cost."""
    task = user_task(**arguments())
    engine = RolloutEngine(task, range(EPISODES), range(EPISODES))
    found = []
    for point in points:
        x = task.space.normalise(point)
        segments = engine.rollout(
            [Proposal(x, k, seed=stream_seed(7, "evaluation", k)) for k in range(EPISODES)]
        )
        costs = [s.costs.sum() for s in segments]
        found.append((sum(s.violation == 0 for s in segments), float(np.mean(costs))))
    return found


def best_of_grid(size: int) -> tuple[dict[str, float], float]:
    """Return the cheapest grid point that keeps both specs in all episodes, and its cost."""
    grid = [
        {"Kp": float(kp), "Ki": float(ki)}
        for kp in np.geomspace(0.2, 1.5, size) for ki in np.geomspace(0.3, 2.0, size)
    ]  # fmt: skip
    points = [(cost, k) for k, (kept, cost) in enumerate(judged(grid)) if kept == EPISODES]
    cost, k = min(points)
    return grid[k], cost


def main() -> None:
    """Tune with several seeds; print each answer beside the best grid point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--grid", type=int, default=20, help="points per gain")
    parser.add_argument("--tuner", help="another tuner than the default")
    given = parser.parse_args()
    start = arguments()["baseline"]
    print("baseline", start, "kept, cost:", *judged([start]))
    point, best = best_of_grid(given.grid)
    print("best grid point", point, f"cost {best:.4f}")
    chosen = {"tuner": given.tuner} if given.tuner else {}
    for seed in range(given.seeds):
        begun = time.perf_counter()
        result = zoac.tune(**arguments(), **chosen, seed=seed, quiet=True)
        ((kept, cost),) = judged([result.parameters])
        seconds = time.perf_counter() - begun
        print(
            f"seed {seed}: kept in {kept} of {EPISODES}, cost {cost:.4f}, {cost / best:.3f} of the "
            f"grid's, feasible {result.feasible}, {seconds:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
