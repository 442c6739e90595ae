"""Where the time of a whole tuning run goes: `python -m benchmarks.whole_run task=pid_acc`.

Takes the overrides of `python -m zoac.run`, runs once in a temporary folder, and prints the
seconds of the critic (the tuner's share), of solvers, of evaluation and of the rest.
"""

from __future__ import annotations

import argparse
import sys
import tempfile

from zoac.config import compose_config, resolved
from zoac.session import run_session


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    given = parser.parse_args().overrides
    with tempfile.TemporaryDirectory() as folder:
        overrides = [*given, f"runs_dir={folder}"]
        config = compose_config(overrides)
        choices = config.hydra.runtime.choices
        result = run_session(
            resolved(config), task=choices["task"], tuner=choices["tuner"], command=sys.argv
        )
    wall = result["wall_seconds"]
    steps, compute = result["env_steps"], result["compute_seconds"]
    print(f"{steps:,} steps in {wall:.1f} s, {compute:.1f} s of processor time")
    rest = wall - result["tuner_seconds"] - result["evaluation_seconds"]
    for name, seconds in (
        ("tuner (critic, gradient)", result["tuner_seconds"]),
        ("evaluation", result["evaluation_seconds"]),
        ("rollouts and rest", rest),
        ("of both, inside solvers", result["solver_seconds"]),
    ):
        print(f"  {name:26} {seconds:7.1f} s  {seconds / wall:5.1%}")


if __name__ == "__main__":
    main()
