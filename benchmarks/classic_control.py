"""Policies on Gymnasium's classic tasks: `python -m benchmarks.classic_control`.

Tune a linear policy, or one of eight tanh units where a linear one is not enough. Print the mean
return of 100 held-out episodes beside returns published for other methods. The published returns
are single runs chosen by their authors (RL Baselines3 Zoo, benchmark.md): they show what is
possible and are not a test of methods.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

import zoac
from zoac.controllers.neural import linear, neural


@dataclass(frozen=True)
class Entry:
    """A task, with the published returns of other methods.

    Args:
        env: Gymnasium's id.
        hidden: Units of the policy; 0: a linear one.
        bound: Of the weights.
        budget: Environment steps for zoac.
        published: Per method, mean return and environment steps.
    """

    env: str
    hidden: int
    bound: float
    budget: int
    published: dict[str, tuple[float, str]]


ENTRIES = (
    Entry("CartPole-v1", 0, 1.0, 50_000,
          {"ARS": (500.0, "50k"), "PPO": (500.0, "100k"), "DQN": (500.0, "50k")}),
    Entry("Acrobot-v1", 0, 1.0, 100_000,
          {"ARS": (-82.9, "500k"), "PPO": (-73.5, "1M"), "DQN": (-76.6, "100k")}),
    Entry("MountainCarContinuous-v0", 0, 10.0, 100_000,
          {"ARS": (96.7, "500k"), "PPO": (88.3, "20k"), "SAC": (94.7, "50k")}),
    Entry("Pendulum-v1", 8, 10.0, 200_000,
          {"ARS": (-212.5, "2M"), "PPO": (-172.2, "100k"), "SAC": (-157.0, "20k")}),
)  # fmt: skip


def returns(entry: Entry, tuner: str, seeds: int) -> list[float]:
    """Return the mean return of 100 held-out episodes for each seed."""
    found = []
    for seed in range(seeds):
        make = neural if entry.hidden else linear
        options = {"hidden": entry.hidden} if entry.hidden else {}
        controller, space = make(entry.env, bound=entry.bound, **options)
        result = zoac.tune(
            env=entry.env, controller=controller, space=space, tuner=tuner, budget=entry.budget,
            seed=seed, final_episodes=100, eval_every=entry.budget, quiet=True,
        )  # fmt: skip
        found.append(-result.record["cost_mean"])
    return found


def main() -> None:
    """Tune and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--tuners", nargs="*", default=["zoac", "zoac_plus", "cmaes_full"])
    parser.add_argument("--envs", nargs="*", default=[entry.env for entry in ENTRIES])
    options = parser.parse_args()
    for entry in (e for e in ENTRIES if e.env in options.envs):
        kind = f"{entry.hidden} tanh units" if entry.hidden else "linear"
        print(f"{entry.env}, {kind}, {entry.budget:,} steps", flush=True)
        for tuner in options.tuners:
            begun = time.process_time()
            found = returns(entry, tuner, options.seeds)
            spent = (time.process_time() - begun) / options.seeds
            print(
                f"  {tuner:11} mean {np.mean(found):8.1f}, seeds "
                f"{', '.join(f'{value:.1f}' for value in sorted(found))}; {spent:.0f} s a run",
                flush=True,
            )
        for method, (value, steps) in entry.published.items():
            print(f"  {method:11} {value:8.1f} after {steps} steps, published")


if __name__ == "__main__":
    main()
