"""Trajectory tracking from the start vectors of the authors' release, with its switches in turn.

    python -m benchmarks.released_starts --seeds 2                      # as in the release
    python -m benchmarks.released_starts --starts 4 9 14 15 --each      # one switch at a time

Runs of 200,000 steps with the weights of the release, whose step size falls by 2e-4 an iteration.
The release draws its start from numpy's legacy generator, seeded with 100, 200, and so on. Costs
are means over the 100 final episodes; a run above 100 counts as lost. What is done is not run
again.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import zoac
from zoac.mpc.solvers.riccati import Riccati
from zoac.tasks.mpc_tracking.controller import SPACE
from zoac.tasks.mpc_tracking.task import MpcTracking

BUDGET, LOST = 200_000, 100.0

ORDER = (
    "k_f", "k_r", "l_f", "l_r", "m", "I_z", "stage_x", "stage_y", "stage_phi", "stage_v",
    "stage_omega", "input_delta", "input_a", "terminal_x", "terminal_phi", "terminal_u",
    "terminal_y", "terminal_v", "terminal_omega",
)  # fmt: skip
"""Ours that does what each entry of the release's vector does there (`weights=aliased`)."""

RELEASE = {"weights": "aliased", "remainder": "joined", "anneal": True}
SWITCHES: dict[str, dict[str, Any]] = {
    "as in the release": {},
    "13 separate weights": {"weights": "separate"},
    "left-over states separate": {"remainder": "separate"},
    "constant step size": {"anneal": False},
}


def start(number: int) -> dict[str, float]:
    """Return the parameters that the release begins with under seed 100 `number`."""
    drawn = np.random.RandomState(100 * number).uniform(-1.0, 1.0, len(ORDER))
    x = np.empty(len(ORDER))
    x[[SPACE.names.index(name) for name in ORDER]] = drawn
    return {name: float(value) for name, value in SPACE.denormalise(x).items()}


def run(number: int, seed: int, switches: Mapping[str, Any], folder: Path) -> float:
    """Tune from a start, unless the folder holds the result; return the final cost."""
    chosen = {**RELEASE, **switches}
    task = MpcTracking(solver=Riccati(), weights=chosen["weights"])
    task.baseline = start(number)
    result = zoac.tune(
        task=task,
        tuner="zoac",
        tuner_options={
            "start": "baseline",
            "step_size": {"first": 5e-2, "slope": 2e-4, "anneal": chosen["anneal"]},
            "critic": {"minibatch_remainder": chosen["remainder"]},
        },
        budget=BUDGET,
        seed=seed,
        num_envs=10,
        final_episodes=100,
        eval_every=BUDGET // 5,
        executor="serial",
        folder=folder,
        quiet=True,
    )
    return float(result.cost_mean)


def main() -> None:
    """Run what is missing; print the costs from each start and how many runs are lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, nargs="+", default=list(range(1, 16)))
    parser.add_argument("--seeds", type=int, default=2, help="of the noise, for each start")
    parser.add_argument("--each", action="store_true", help="try the switches one at a time, too")
    parser.add_argument("--runs", type=Path, default=Path("runs/released_starts"))
    given = parser.parse_args()
    for name, switches in SWITCHES.items():
        if not switches or given.each:
            _print(name, switches, given.starts, given.seeds, given.runs / name.replace(" ", "_"))


def _print(
    name: str, switches: Mapping[str, Any], starts: Sequence[int], seeds: int, runs: Path
) -> None:
    costs = np.empty((len(starts), seeds))
    for row, number in zip(costs, starts, strict=True):
        for seed in range(seeds):
            row[seed] = run(number, seed, switches, runs / f"{number}-{seed}")
        print(f"{name}, start {number}:", " ".join(f"{c:.1f}" for c in row), flush=True)
    lost = costs > LOST
    print(
        f"{name}: {lost.sum()} of {lost.size} runs lost; the others {costs[~lost].mean():.1f} ± "
        f"{costs[~lost].std(ddof=1):.1f}, median of all {np.median(costs):.1f}"
    )


if __name__ == "__main__":
    main()
