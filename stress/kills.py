"""Kill runs at random instants and see that they end on the same bits: `python -m stress.kills`.

For every pair of tuner and task, and for each executor, one run goes through untouched and one is
killed (SIGKILL) again and again at random instants and launched anew each time. The final result
and all evaluation rows must be equal to the last bit, clocks excepted.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from zoac.records import is_done, read_metrics, read_result

ROOT = Path(__file__).resolve().parents[1]
BUDGETS = {"pid_acc": 20_000, "mpc_tracking": 4_000, "mpc_tracking_reg": 4_000}
CLOCKS = ("wall_seconds", "compute_seconds", "solver_seconds", "tuner_seconds",
          "evaluation_seconds", "checkpoint_seconds")  # fmt: skip


def without_clocks(content: Any) -> str:
    """Return content as text, without what depends on the clock."""
    return json.dumps({k: v for k, v in content.items() if k not in CLOCKS}, sort_keys=True)


def outcome(folder: Path) -> list[str]:
    """Return everything that must be the same: the result and all evaluation rows."""
    rows = [row for row in read_metrics(folder) if row["kind"] == "eval"]
    return [without_clocks(read_result(folder)), *map(without_clocks, rows)]


def launch(arguments: list[str], folder: Path) -> subprocess.Popen[bytes]:
    """Start one run, quietly, in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "zoac.run", *arguments, f"runs_dir={folder}"],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def one_pair(task: str, tuner: str, executor: list[str], kills: int, rng: random.Random) -> int:
    """Return how often the run of this pair was killed; exits if the outcome differs."""
    arguments = [
        f"task={task}", f"tuner={tuner}", *executor, f"budget={BUDGETS[task]}", "variant=kills",
        f"eval_every={BUDGETS[task] // 4}", "evaluation.episodes=2", "evaluation.final_episodes=2",
        "checkpoint_seconds=0.05", "lanes=4", "mpc_solver=riccati",
    ]  # fmt: skip
    with tempfile.TemporaryDirectory() as temporary:
        whole, parts = Path(temporary, "whole"), Path(temporary, "parts")
        begun = time.monotonic()
        process = launch(arguments, whole)
        _, errors = process.communicate()
        spent = time.monotonic() - begun
        if process.returncode != 0:
            sys.exit(f"{task} {tuner}: {errors.decode()}")
        inside = Path(task, tuner, "seed=0", "variant=kills")
        killed = 0
        while not is_done(parts / inside):
            process = launch(arguments, parts)
            try:
                # Most of the time goes into starting up: aim anywhere, and beyond the end.
                wait = rng.uniform(0.3, 1.1) * spent if killed < kills else None
                _, errors = process.communicate(timeout=wait)
                if process.returncode != 0:
                    sys.exit(f"{task} {tuner} after {killed} kills: {errors.decode()}")
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()
                killed += 1
        if outcome(parts / inside) != outcome(whole / inside):
            sys.exit(f"{task} {tuner} {executor}: the outcome differs after {killed} kills")
    return killed


def main() -> None:
    """Run all pairs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=30, help="kills of each run, at most")
    parser.add_argument("--tasks", nargs="*", default=list(BUDGETS))
    tuners = sorted(p.stem for p in (ROOT / "conf" / "tuner").glob("*.yaml"))
    parser.add_argument("--tuners", nargs="*", default=[t for t in tuners if t != "nominal"])
    options = parser.parse_args()
    rng = random.Random(0)
    for task in options.tasks:
        for tuner in options.tuners:
            for executor in (["executor=serial"], ["executor=process", "executor.workers=2"]):
                killed = one_pair(task, tuner, executor, options.kills, rng)
                pair = f"{task:17} {tuner:10} {executor[0]:17}"
                print(f"{pair} {killed} kills: same bits", flush=True)


if __name__ == "__main__":
    main()
