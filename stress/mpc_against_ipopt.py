"""First inputs of MPCs with all kinds of constraints against IPOPT's.

python -m stress.mpc_against_ipopt --states 200
"""

from __future__ import annotations

import argparse

import numpy as np

from tests.mpc.oracle import Ipopt
from tests.mpc.systems import SYSTEMS, System


def differences(system: System) -> tuple[np.ndarray, np.ndarray]:
    """Return by how much each first input (n, nu) differs, in its range, and both plans' sense.

    Returns:
        Differences, NaN where one of the two has no plan; and whether only one has (n,).
    """
    ipopt = Ipopt(system.problem)
    n = len(system.observations)
    mpc, memory = system.mpc, dict(system.mpc.init(n))
    if "input" in memory:
        memory["input"] = np.tile(system.before, (n, 1))
    actions, _, found = mpc.act({}, system.observations, memory)
    width = np.ptp(system.problem.input_bounds, axis=0)
    states = system.observations[:, : len(system.problem.terminal)]
    off = np.full(actions.shape, np.nan)
    alone = np.zeros(n, bool)
    for k in range(n):
        plan = ipopt.plan(states[k], system.before, system.references[k], system.guess)
        alone[k] = (plan is None) != bool(found["solver_failed"][k])
        if plan is not None and not found["solver_failed"][k]:
            off[k] = np.abs(actions[k] - plan[0]) / width
    return off, alone


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=200)
    parser.add_argument("--system", choices=SYSTEMS, action="append")
    options = parser.parse_args()
    for name in options.system or SYSTEMS:
        off, alone = differences(SYSTEMS[name](options.states, 0))
        worst = off.max(axis=1)
        solved = ~np.isnan(worst)
        print(
            f"{name}: {options.states} states, both have a plan in {solved.sum()}, only one in "
            f"{alone.sum()}; first inputs differ by at most {np.nanmax(worst):.1e} of their range, "
            f"above 1e-4 in {(worst[solved] > 1e-4).sum()}, median {np.nanmedian(worst):.1e}"
        )


if __name__ == "__main__":
    main()
