"""First inputs of MPCs with all kinds of constraints against IPOPT's.

python -m stress.mpc_against_ipopt --states 200
"""

from __future__ import annotations

import argparse

import numpy as np

from tests.mpc.oracle import Ipopt
from tests.mpc.systems import SYSTEMS, System


def first_inputs(system: System) -> list[np.ndarray | None]:
    """Return IPOPT's first inputs (nu,), None where it has no plan."""
    ipopt = Ipopt(system.problem)
    states = system.observations[:, : len(system.problem.terminal)]
    plans = [
        ipopt.plan(x, system.before, goal, system.guess)
        for x, goal in zip(states, system.references, strict=True)
    ]
    return [None if plan is None else plan[0] for plan in plans]


def differences(system: System, by_ipopt: list[np.ndarray | None]) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much each first input (n, nu) differs from IPOPT's, in its range.

    Returns:
        Differences, NaN where one of the two has no plan; and whether only one has (n,).
    """
    n = len(system.observations)
    mpc, memory = system.mpc, dict(system.mpc.init(n))
    if "input" in memory:
        memory["input"] = np.tile(system.before, (n, 1))
    actions, _, found = mpc.act({}, system.observations, memory)
    width = np.ptp(system.problem.input_bounds, axis=0)
    off = np.full(actions.shape, np.nan)
    alone = np.zeros(n, bool)
    for k, wanted in enumerate(by_ipopt):
        alone[k] = (wanted is None) != bool(found["solver_failed"][k])
        if wanted is not None and not found["solver_failed"][k]:
            off[k] = np.abs(actions[k] - wanted) / width
    return off, alone


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=200)
    parser.add_argument("--system", choices=SYSTEMS, action="append")
    options = parser.parse_args()
    for name in options.system or SYSTEMS:
        system = SYSTEMS[name](options.states, 0)
        off, alone = differences(system, first_inputs(system))
        worst = off.max(axis=1)
        solved = ~np.isnan(worst)
        print(
            f"{name}: {options.states} states, both have a plan in {solved.sum()}, only one in "
            f"{alone.sum()}; first inputs differ by at most {np.nanmax(worst):.1e} of their range, "
            f"above 1e-4 in {(worst[solved] > 1e-4).sum()}, median {np.nanmedian(worst):.1e}"
        )


if __name__ == "__main__":
    main()
