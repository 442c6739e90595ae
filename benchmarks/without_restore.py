"""`zoac.run` where no environment can be restored to an earlier state, as on a rig.

    python -m benchmarks.without_restore experiment=suite \\
        task=suite/lqr,suite/loop_0 tuner=cmaes_plus,random -m

Tuners then cannot try parts of episodes from one state.
"""

import runpy

import zoac.rollout.probe


def main() -> None:
    """Run the command line."""
    zoac.rollout.probe.restore_fault = lambda make_env, pickled=False: "it is a rig"
    runpy.run_module("zoac.run", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
