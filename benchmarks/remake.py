"""All of `results/` anew: runs, kept files, tables and figures.

    python -m benchmarks.remake runs                    # launches what is missing, then builds
    python -m benchmarks.remake runs --only text code   # launches these sweeps, builds nothing
    python -m benchmarks.remake runs --only             # launches nothing, builds

A sweep that was stopped continues when the same command is given again. The suite of problems has
a command of its own: see docs/which_tuner.md.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from zoac.analysis import beyond, compact, curves, table2
from zoac.runs.schema import METRICS, RESULT, RUN, is_done

_MPC = "mpc_solver=riccati executor=serial"
_TEN = "-m seed=range(0,10)"
_START = f"initial_samples=40 common_random_numbers=true {_MPC}"
_PART = "experiment=beyond_plus -m task={} budget={} {} variant='budget=${{budget}},{}'"
_SAFE = "task=pid_acc tuner=zoac_plus budget=100000 executor=serial"
_PARTS = (
    "tuner.halving_fraction=0",
    "tuner.halving_fraction=1",
    "tuner.paired=False",
    "tuner.paired=False tuner.halving_fraction=0",
    "tuner.selection_fraction=0",
    "tuner.critic.hidden=[256,256]",
    "tuner.critic.normalise_observations=False",
)


def _part(task: str, budget: int, options: str) -> str:
    return _PART.format(task, budget, options, options.replace(" ", ","))


SWEEPS = {
    "text": (
        "experiment=table2 mpc_solver=riccati method=bo,cmaes,nominal,zoac_reg -m",
        f"experiment=table2 mpc_solver=riccati method=zoac {_TEN}",
        "experiment=fig3_acc tuner=bo,cmaes,cmaes_full,nominal -m",
        "experiment=fig3_acc tuner=zoac -m seed=range(0,40)",
        f"task=mpc_tracking tuner=cmaes_full {_MPC} -m seed=range(0,5)",
        f"tuner=zoac_plus tuner.selection_baseline=false {_MPC} -m "
        "task=mpc_tracking,mpc_tracking_reg seed=range(0,5)",
        f"tuner=zoac_plus tuner.selection_baseline=false {_MPC} -m task=pid_acc seed=range(0,8)",
    ),
    "code": (
        "experiment=table2 mpc_solver=riccati method=zoac_code -m seed=range(0,20)",
        "experiment=table2 mpc_solver=riccati method=zoac_reg_code -m",
        "experiment=fig3_acc_code -m tuner=zoac seed=range(0,16)",
        "experiment=fig3_acc_code -m tuner=zoac seed=range(0,16) tuner.step_size.anneal=true "
        "variant=authors_code_annealed",
        "experiment=fig3_acc_code -m tuner=cmaes,nominal",
    ),
    "beyond": (
        "experiment=beyond_plus -m",
        "experiment=beyond_plus -m seed=range(100,110)",
        "experiment=beyond -m tuner=cmaes_full,nevergrad",
        "experiment=beyond -m tuner=zoac budget=25000,50000,100000",
        "experiment=beyond -m tuner=nominal budget=25000 seed=0",
        f"task=mpc_tracking tuner=zoac budget=50000 initial_samples=40 {_MPC} {_TEN}",
        f"task=mpc_tracking tuner=cmaes_full,nevergrad budget=50000 {_START} {_TEN}",
        f"task=pid_acc tuner=cmaes_full,nevergrad budget=100000,500000 {_START} {_TEN}",
        f"task=mpc_tracking tuner=optuna budget=25000 {_MPC} -m seed=range(0,5)",
        f"task=pid_acc tuner=optuna budget=25000,50000,100000 {_MPC} {_TEN}",
    ),
    "ablation": (
        *(_part("mpc_tracking", 50_000, part) for part in _PARTS),
        *(_part("mpc_tracking", 500_000, part) for part in _PARTS[1:3]),
        *(_part("pid_acc", 100_000, part) for part in _PARTS),
    ),
    "careful": (
        f"{_SAFE} tuner.start=baseline tuner.halving_fraction=0 tuner.exploration.sigma=0.2 "
        f"tuner.max_termination_rate=0,null tuner.step_size.first=0.05,0.01 {_TEN}",
        f"{_SAFE} tuner.start=baseline tuner.halving_fraction=0 tuner.exploration.sigma=0.1 "
        f"tuner.max_termination_rate=0,null tuner.step_size.first=0.01 {_TEN}",
        f"{_SAFE} variant=halving {_TEN}",
        "experiment=beyond -m task=pid_acc tuner=nominal budget=100000 seed=0",
    ),
}
"""Folder of runs -> the options of the commands that fill it."""


def launch(name: str, runs: Path) -> None:
    """Run a sweep's commands, but for runs that are done."""
    for options in SWEEPS[name]:
        command = [sys.executable, "-m", "zoac.run", *options.split(), f"runs_dir={runs / name}"]
        subprocess.run(command, check=True)


Keep = Callable[[dict[str, Any]], bool]


def _all(run: dict[str, Any]) -> bool:
    return True


def _first_seeds(run: dict[str, Any]) -> bool:
    seeds = 5 if run["task"].startswith("mpc_tracking") else 8
    return run["seed"] < seeds and run["variant"] != "authors_code_annealed"


def _many_seeds(run: dict[str, Any]) -> bool:
    return (run["task"], run["tuner"]) == ("pid_acc", "zoac")


def _fig_4(run: dict[str, Any]) -> bool:
    return run["task"] == "pid_acc_code" and run["tuner"] == "zoac" and _first_seeds(run)


def _at_500_000(run: dict[str, Any]) -> bool:
    return run["task"] != "mpc_tracking_reg" and run["tuner"] in ("zoac", "bo") and run["seed"] < 10


def _whole(run: dict[str, Any]) -> bool:
    compared = {("mpc_tracking", 50_000), ("mpc_tracking", 500_000), ("pid_acc", 100_000)}
    is_whole = run["tuner"] == "zoac_plus" and run["seed"] < 10
    return run["tuner"] == "nominal" or (is_whole and (run["task"], run["budget"]) in compared)


KEPT: dict[str, tuple[dict[str, Keep], str]] = {
    ".": ({"text": _first_seeds, "code": _first_seeds}, "--every 25000 --digits 5"),
    "seeds": ({"text": _many_seeds}, "--summary --digits 5"),
    "authors_code": ({"code": _all}, "--summary --digits 5"),
    "fig4": ({"code": _fig_4}, "--parameters --digits 6"),
    "beyond": ({"beyond": _all, "text": _at_500_000}, "--summary --digits 5"),
    "ablation": ({"ablation": _all, "beyond": _whole}, "--summary --digits 5"),
    "careful": ({"careful": _all}, "--summary --digits 5"),
}
"""Folder of results/ -> which runs it keeps, by sweep, and how `zoac.analysis.compact` does."""

_FOUR = "--variant none --metric cost_mean --tuners zoac,zoac_plus,bo,cmaes,nominal"
_TABLES, _FIGURES = "results/tables", "docs/images/reproduction"
MADE: dict[str, tuple[ModuleType, str, str]] = {
    **{
        f"{_TABLES}/{task}": (table2, ".", f"--task {task}")
        for task in ("mpc_tracking", "pid_acc", "pid_acc_code")
    },
    **{
        f"{_TABLES}/beyond-{seeds}-{by}": (beyond, "beyond", f"--seeds {seeds} --reference {by}")
        for seeds in ("0-9", "100-109")
        for by in ("nominal", "best")
    },
    **{f"{_TABLES}/{name}": (beyond, name, "") for name in ("ablation", "careful")},
    **{
        f"{_FIGURES}/{task}": (curves, ".", f"--task {task} --format svg")
        for task in ("mpc_tracking", "pid_acc", "pid_acc_code")
    },
    f"{_FIGURES}/four_tuners": (curves, ".", f"--task mpc_tracking --format svg {_FOUR}"),
}
"""Folder -> the command of `zoac.analysis` that fills it, its folder of results/, its options."""


def build(runs: Path) -> None:
    """Write `results/` and the figures from runs that are done."""
    for name, (sources, options) in KEPT.items():
        with tempfile.TemporaryDirectory() as folder:
            for source, keep in sources.items():
                _gather(runs / source, Path(folder, source), keep)
            _made(compact.main([folder, *options.split(), "--out", f"results/{name}"]))
    for folder, (command, name, options) in MADE.items():
        _made(command.main([f"results/{name}", *options.split(), "--out", folder]))
        Path(folder, "beyond.csv").unlink(missing_ok=True)  # runs.csv has the same numbers


def _gather(runs: Path, into: Path, keep: Keep) -> None:
    """Copy what is read of the runs to keep; those of the text are the rows without a variant."""
    for identity_file in sorted(runs.rglob(RUN)):
        folder = identity_file.parent
        run = json.loads(identity_file.read_text())
        if not is_done(folder) or not keep(run | {"budget": run["config"]["budget"]}):
            continue
        kept = into / folder.relative_to(runs)
        kept.mkdir(parents=True)
        for name in (RUN, METRICS, RESULT):
            shutil.copy(folder / name, kept / name)
        if runs.name == "text":
            for name in (RUN, RESULT):
                record = json.loads((kept / name).read_text()) | {"variant": None}
                (kept / name).write_text(json.dumps(record))


def _made(code: int) -> None:
    if code:
        raise SystemExit(code)


def main() -> None:
    """Launch sweeps, build `results/`, or both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, help="folder of the runs")
    parser.add_argument("--only", nargs="*", choices=SWEEPS, metavar="SWEEP")
    options = parser.parse_args()
    for name in SWEEPS if options.only is None else options.only:
        launch(name, options.runs)
    if not options.only:
        build(options.runs)


if __name__ == "__main__":
    main()
