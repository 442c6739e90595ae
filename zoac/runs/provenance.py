"""What `run.json` keeps of code and machine: versions, commit, processor."""

import functools
import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = (
    "zoac", "numpy", "torch", "gymnasium", "hydra-core", "cvxpy", "clarabel", "numba", "nevergrad",
)  # fmt: skip


def here_and_now() -> dict[str, Any]:
    """Return versions, commit, time and machine, for `run.json`."""
    return {
        "versions": _versions(),
        "commit": commit(),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "system": platform.platform(),
            "processor": _processor(),
            "cores": os.cpu_count(),
        },
    }


def differences(earlier: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Return what differs between two `run.json` in what a run's bits depend on."""
    then, here = (
        {**record["versions"], "processor": record["machine"]["processor"],
         "commit": record["commit"]}
        for record in (earlier, now)
    )  # fmt: skip
    return [
        f"{name} {here.get(name)}, at first {then.get(name)}"
        for name in {**then, **here}
        if then.get(name) != here.get(name)
    ]


def _processor() -> str:
    """Name the processor: libraries choose their code by its model, and with it their rounding."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, models), platform.processor() or platform.machine())


@functools.cache
def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:  # a clone without an installed package
            continue
    return versions


@functools.cache
def commit() -> str | None:
    """Return the commit of the clone that this package runs from, "+" behind it if changed.

    As it was when first asked for: a process goes on with the code that it has imported.
    """
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    try:
        # Without tags this is the whole hash.
        describe = ("describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+")
        done = subprocess.run(
            ["git", "-C", str(root), *describe],
            capture_output=True, text=True, check=True, timeout=10,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
