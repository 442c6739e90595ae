"""Exported C beside the Python controller, on three systems.

python -m benchmarks.mpc_export         # needs gcc and zoac[casadi]

Each solves one programme in each of the same random states. Errors are those of the first inputs,
in parts of their ranges, against Clarabel at a tolerance of 1e-13. Times are CPU times on one
thread; trust their ratios only.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.mpc.systems import SYSTEMS
from zoac.mpc import Mpc
from zoac.mpc.solvers.clarabel_qp import ClarabelSolver


def by_python(mpc: Mpc, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return actions, which of them failed, and CPU times [ms]."""
    actions, failed, times = [], [], []
    for obs in states:
        began = time.process_time()
        action, _, told = mpc.act({}, obs[None], mpc.init(1))
        times.append(1e3 * (time.process_time() - began))
        actions.append(action[0])
        failed.append(told["solver_failed"][0])
    return np.array(actions), np.array(failed), np.array(times)


def by_c(path: Path, states: np.ndarray, nu: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the same of an exported file."""
    library = path.with_suffix(".so")
    command = ["gcc", "-O2", "-shared", "-fPIC", "-o", str(library), str(path), "-lm"]
    subprocess.run(command, check=True)
    step, memory = ctypes.CDLL(str(library)), (ctypes.c_double * 10_000)()
    actions, failed, times = [], [], []
    for obs in states:
        given, action = (ctypes.c_double * len(obs))(*obs), (ctypes.c_double * nu)()
        step.mpc_init(memory)
        began = time.process_time()
        failed.append(bool(step.mpc_step(memory, given, action)))
        times.append(1e3 * (time.process_time() - began))
        actions.append(list(action))
    return np.array(actions), np.array(failed), np.array(times)


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=200)
    options = parser.parse_args()
    print("| system | way | failed | error: median | largest | ms: median | largest | kB |")
    print("|---|---|---|---|---|---|---|---|")
    for name, make in SYSTEMS.items():
        mpc, tight = (
            make(options.states, 1, linearisations=1, solver=ClarabelSolver(tolerance)).mpc
            for tolerance in (1e-10, 1e-13)
        )
        states = make(options.states, 1).observations
        wanted, _, _ = by_python(tight, states)
        values, inputs = mpc.numbers.values, mpc.model.inputs
        width = np.array([values[f"high_{j}"] - values[f"low_{j}"] for j in inputs])
        with tempfile.TemporaryDirectory() as folder:
            path = mpc.export({}, Path(folder) / f"{name}.c", states.shape[1])
            size = f"{path.stat().st_size / 1e3:.0f}"
            ways = {
                "Python": (*by_python(mpc, states), ""),
                "C": (*by_c(path, states, len(inputs)), size),
            }
        for way, (actions, failed, times, kilobytes) in ways.items():
            errors = np.abs((actions - wanted) / width).max(axis=1)
            print(
                f"| {name} | {way} | {failed.sum()} | {np.median(errors):.1e} | "
                f"{errors.max():.1e} | {np.median(times):.2f} | {times.max():.2f} | {kilobytes} |"
            )


if __name__ == "__main__":
    main()
