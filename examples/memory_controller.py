"""A controller that remembers: a PID on a drifting mass, with baseline gains and a constraint.

python examples/memory_controller.py         # writes gains.h for the target
"""

import argparse
from pathlib import Path

import gymnasium
import numpy as np
from gymnasium.spaces import Box

import zoac

DT = 0.1  # [s]


class Mass(gymnasium.Env):
    """Position and speed of a mass [m, m/s] under a force [N] and a constant wind."""

    observation_space = Box(-np.inf, np.inf, (2,), np.float64)
    action_space = Box(-5.0, 5.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        """Begin 1 m away, in another wind."""
        super().reset(seed=seed)
        self.x = np.array([1.0, 0.0])
        self.mass = 1.0  # [kg]
        self.wind = self.np_random.uniform(-1.0, 1.0)
        return self.x.copy(), {}

    def step(self, action):
        """Advance by DT."""
        force = float(action[0]) + self.wind
        self.x = self.x + DT * np.array([self.x[1], force / self.mass])
        cost = self.x[0] ** 2 + 0.01 * float(action[0]) ** 2
        return self.x.copy(), -cost, False, False, {"cost": cost}


class Pid:
    """A PID on the position; its integral begins anew in `reset`."""

    def reset(self):
        """Forget."""
        self.integral = 0.0

    def act(self, params, obs):
        """Return the force [N]."""
        self.integral += DT * obs[0]
        return -params["kp"] * obs[0] - params["kd"] * obs[1] - params["ki"] * self.integral


def too_fast(segment):
    """Above zero where the mass is faster than 1 m/s."""
    return np.abs(segment.observations[1:, 1]) - 1.0


def main():
    """Tune, print, export."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=int, default=20_000, help="environment steps")
    parser.add_argument("--out", type=Path, default=Path("gains.h"), help=".h, .m, .yaml, .json")
    options = parser.parse_args()
    result = zoac.tune(
        env=Mass,
        controller=Pid(),
        space={
            "kp": {"low": 0.0, "high": 10.0, "baseline": 1.0, "unit": "N/m"},
            "ki": {"low": 0.0, "high": 5.0, "baseline": 0.1, "unit": "N/(m s)"},
            "kd": {"low": 0.0, "high": 10.0, "baseline": 1.0, "unit": "N s/m"},
        },
        constraints={"speed": too_fast},
        tuner="cmaes",
        max_episode_steps=100,
        budget=options.budget,
        quiet=True,
    )
    print(f"cost {result.cost_mean:.2f}, by hand {result.baseline_cost_mean:.2f}")
    print(result.export(options.out).read_text())


if __name__ == "__main__":
    main()
