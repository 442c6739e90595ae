"""One sweep of four runs through every launcher that is installed: `python -m stress.launchers`.

The results must be equal to the last bit, clocks excepted. Prints wall seconds too.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tests.launchers.support import ROOT, results

PLUGINS = {
    "joblib": "hydra_plugins.hydra_joblib_launcher",
    "submitit_local": "hydra_plugins.hydra_submitit_launcher",
    "ray": "hydra_plugins.hydra_ray_launcher",
}


def sweep(launcher: str, budget: int, folder: Path) -> tuple[dict[str, Any], float]:
    """Return the result of each run without its clocks, by place, and the sweep's wall seconds."""
    begun = time.monotonic()
    done = subprocess.run(
        [
            sys.executable, "-m", "zoac.run", "-m", f"launcher={launcher}", "task=pid_acc",
            "tuner=zoac,zoac_plus", "seed=0,1", f"budget={budget}", f"eval_every={budget}",
            "evaluation.final_episodes=10", "variant=launchers", f"runs_dir={folder}",
        ],
        cwd=ROOT, env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True,
    )  # fmt: skip
    spent = time.monotonic() - begun
    if done.returncode != 0:
        sys.exit(f"launcher={launcher}: {done.stderr}")
    return results(folder), spent


def main() -> None:
    """Sweep with every launcher."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=int, default=20_000, help="environment steps a run")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        expected, alone = sweep("basic", options.budget, Path(temporary, "basic"))
        print(f"basic            {len(expected)} runs in {alone:.1f} s", flush=True)
        for launcher, plugin in PLUGINS.items():
            if find_spec("hydra_plugins") is None or find_spec(plugin) is None:
                print(f"{launcher:16} not installed")
                continue
            found, spent = sweep(launcher, options.budget, Path(temporary, launcher))
            if found != expected:
                sys.exit(f"{launcher}: the results differ from those of the basic launcher")
            ratio = alone / spent
            print(f"{launcher:16} same bits, {spent:.1f} s, {ratio:.2f} times as fast", flush=True)


if __name__ == "__main__":
    main()
