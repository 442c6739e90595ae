"""ZOAC with settings of its authors' later code (IEEE TEVC 2025), one at a time.

    python -m benchmarks.later_code --task mpc_tracking       # launches what is missing
    python -m benchmarks.later_code --task mpc_tracking --only-table

The table gives the cost of the last iterate over the final episodes, and how much the iterate
wanders: the mean change from one evaluation to the next in the last fifth of the run, as a part of
the mean cost there. Evaluations use the same ten episodes.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zoac.algorithm.advantage import estimate
from zoac.algorithm.options import CriticOptions
from zoac.algorithm.zoac import Zoac, within_float32
from zoac.core.segments import Segment
from zoac.core.tuner import Problem
from zoac.core.types import Positive
from zoac.runs.schema import is_done, read_metrics, read_result

SETTINGS = {
    "as published": [],
    "200 directions": ["tuner.exploration.segments=20"],
    "longer segments": ["tuner.exploration.segment_length=40", "tuner.lam=0.97"],
    "plain SGD": ["+tuner.gradient_step=5e-4", "tuner.standardise_advantages=false"],
    "fitted critic": ["+tuner.critic_first=true"],
    "middle": ["+tuner.middle=true"],
}
_ALL = [option for options in SETTINGS.values() for option in options]
SETTINGS["all but the middle"] = [option for option in _ALL if option != "+tuner.middle=true"]
SETTINGS["all of them"] = _ALL


class LaterCode(Zoac):
    """ZOAC with three rules that its options do not have."""

    def __init__(
        self,
        problem: Problem,
        *,
        gradient_step: Positive | None = None,
        critic_first: bool = False,
        middle: bool = False,
        critic: CriticOptions = CriticOptions(),
        **options: Any,
    ) -> None:
        """
        Args:
            problem: What is tuned.
            gradient_step: Step size of plain gradient descent; None: Adam.
            critic_first: Advantages come from the critic after half of its epochs.
            middle: Begin in the middle of the box.
            critic: Its network and fit.
            options: Of ZOAC.
        """
        if critic_first:
            critic = replace(critic, epochs=critic.epochs // 2)
        super().__init__(problem, critic=critic, **options)
        self._gradient_step, self._critic_first = gradient_step, critic_first
        self._told: Sequence[Segment] = ()
        if middle:
            self._theta = np.zeros(problem.space.dimension)
            self._average = self._theta.copy()

    def tell(self, segments: Sequence[Segment]) -> dict[str, float]:
        """See `Tuner.tell`."""
        self._told = segments
        return super().tell(segments)

    def _weights(self, advantages: np.ndarray) -> np.ndarray:
        if self._critic_first and self._pending is not None:
            self._critic.fit(*self._pending)  # the other half follows as the background update
            observations = [within_float32(s.observations) for s in self._finite(self._told)]
            values = self._critic.values(np.concatenate(observations))
            ends = np.cumsum([len(o) for o in observations])[:-1]
            advantages, _ = estimate(
                self._finite(self._told), np.split(values, ends), self._gamma, self._lam
            )
        return super()._weights(advantages)

    def _move(self, gradient: np.ndarray, step_size: float) -> None:
        if self._gradient_step is None:
            super()._move(gradient, step_size)
        else:
            theta = self._theta - self._gradient_step * gradient
            self._theta = self._problem.space.clip(theta)


def launch(task: str, budget: int, seeds: int, runs: Path) -> None:
    """Run every setting with every seed, unless it is done."""
    common = [f"task={task}", "tuner=zoac", f"budget={budget}", "executor=serial"]
    common += [f"tuner._target_={__spec__.name}.LaterCode", f"runs_dir={runs}"]
    common += ["mpc_solver=riccati", "-m", f"seed=range(0,{seeds})"]
    for name, options in SETTINGS.items():
        command = [sys.executable, "-m", "zoac.run", *common, _variant(name), *options]
        subprocess.run(command, check=True)


def _variant(setting: str) -> str:
    return f"variant={setting.replace(' ', '_')}"


def table(task: str, runs: Path) -> str:
    """Return a row for each setting of the runs that are done."""
    lines = [
        "| setting | seeds | cost | median | worst | wandering |",
        "|---|---:|---|---:|---:|---:|",
    ]
    for name in SETTINGS:
        folders = [f for f in runs.glob(f"{task}/zoac/*/{_variant(name)}") if is_done(f)]
        if not folders:
            continue
        costs = np.array([read_result(folder)["cost_mean"] for folder in folders])
        wandering = np.median([_wandering(folder) for folder in folders])
        average = f"{costs.mean():.1f} ± {costs.std(ddof=1):.1f}" if len(costs) > 1 else ""
        lines.append(
            f"| {name} | {len(costs)} | {average} | {np.median(costs):.2f} | {costs.max():.1f} "
            f"| {wandering:.3f} |"
        )
    return "\n".join(lines)


def _wandering(folder: Path) -> float:
    rows = [row for row in read_metrics(folder) if row["kind"] == "eval" and not row["final"]]
    costs = np.array([row["cost_mean"] for row in rows])
    late = costs[len(costs) * 4 // 5 :]
    return float(np.abs(np.diff(late)).mean() / late.mean())


def main() -> None:
    """Run what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", default="mpc_tracking", choices=("mpc_tracking", "pid_acc"))
    parser.add_argument("--budget", type=int, default=250_000)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--runs", type=Path, default=Path("runs/later_code"))
    parser.add_argument("--only-table", action="store_true")
    given = parser.parse_args()
    if not given.only_table:
        launch(given.task, given.budget, given.seeds, given.runs)
    print(table(given.task, given.runs))


if __name__ == "__main__":
    main()
