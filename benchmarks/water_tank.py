"""The water tank of MathWorks' example, tuned by `zoac.tune` with its defaults.

python -m benchmarks.water_tank --seeds 3
"""

from __future__ import annotations

import argparse
import time

import zoac
from zoac.controllers.pid import PID
from zoac.tasks.suite.water_tank import PUBLISHED, SAMPLE_TIME, SPACE, STEPS, WaterTank


def main() -> None:
    """Tune with several seeds; print the cost beside that of the published gains."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--tuner", default="auto")
    given = parser.parse_args()
    for seed in range(given.seeds):
        begun = time.perf_counter()
        result = zoac.tune(
            env=WaterTank,
            controller=PID(sample_time=SAMPLE_TIME, r=1),
            space=SPACE,
            baseline=PUBLISHED,  # compared with on the same episodes
            tuner=given.tuner,
            tuner_options={"start": "random"},  # the search does not begin at these gains
            max_episode_steps=STEPS,
            final_episodes=500,
            seed=seed,
            quiet=True,
        )
        ratio = result.cost_mean / result.baseline_cost_mean
        seconds = time.perf_counter() - begun
        print(
            f"seed {seed}: {result.parameters}, cost {result.cost_mean:.2f}, {ratio:.4f} of the "
            f"published gains', {seconds:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
