"""Where the time of a whole tuning run goes: `python -m benchmarks.whole_run task=pid_acc`.

Takes the overrides of `python -m zoac.run`, runs once in a temporary folder, and prints the
seconds of the critic (the tuner's share), of solvers, of environments, of evaluation and of the
rest. What environments take is known only where they run in this process (`executor=serial`).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from functools import wraps
from typing import Any

from zoac.config import compose_config, resolved
from zoac.environment import ArrayLanes
from zoac.session import run_session


def timed(method: Callable[..., Any], spent: list[float]) -> Callable[..., Any]:
    """Return `method`, which then adds its seconds to `spent`."""

    @wraps(method)
    def call(*args: Any, **options: Any) -> Any:
        began = time.perf_counter()
        answer = method(*args, **options)
        spent.append(time.perf_counter() - began)
        return answer

    return call


def main() -> None:
    in_environments: list[float] = []
    for name in ("step", "reset"):
        setattr(ArrayLanes, name, timed(getattr(ArrayLanes, name), in_environments))
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
    parts = {
        "tuner (critic, gradient)": result["tuner_seconds"],
        "evaluation": result["evaluation_seconds"],
        "rollouts and rest": rest,
        "of both, inside solvers": result["solver_seconds"],
    }
    if in_environments:
        parts["of both, in environments"] = sum(in_environments)
    for name, seconds in parts.items():
        print(f"  {name:26} {seconds:7.1f} s  {seconds / wall:5.1%}")


if __name__ == "__main__":
    main()
