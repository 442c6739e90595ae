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
from pathlib import Path

import numpy as np

from zoac.runs.schema import is_done, read_metrics, read_result

SETTINGS = {
    "as published": [],
    "200 directions": ["tuner.exploration.segments=20"],
    "longer segments": ["tuner.exploration.segment_length=40", "tuner.lam=0.97"],
    "plain SGD": [
        "tuner.step_size.rule=sgd",
        "tuner.step_size.first=5e-4",
        "tuner.standardise_advantages=false",
    ],
    "fitted critic": ["tuner.critic.epochs_before=5"],
    "middle": ["tuner.start=middle"],
}
_ALL = [option for options in SETTINGS.values() for option in options]
SETTINGS["all but the middle"] = [option for option in _ALL if option != "tuner.start=middle"]
SETTINGS["all of them"] = _ALL


def launch(task: str, budget: int, seeds: int, runs: Path) -> None:
    """Run every setting with every seed, unless it is done."""
    common = [f"task={task}", "tuner=zoac", f"budget={budget}", "executor=serial"]
    common += [f"runs_dir={runs}", "mpc_solver=riccati", "-m", f"seed=range(0,{seeds})"]
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
