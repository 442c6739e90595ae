"""Where the time of whole tuning runs goes: `python -m benchmarks.whole_run task=pid_acc`.

Take the overrides of `python -m zoac.run`, run once in a temporary folder, and print the seconds of
the critic (the tuner's part), of solvers, of environments, of evaluation and of the rest. The time
of environments is known only where they run in this process (`executor=serial`). An override with
several values (`mpc_solver=riccati,clarabel`) makes one run for each value, and prints their times
relative to the first. A short uncounted run before each loads and compiles.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import wraps
from itertools import product
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser

from zoac.config.compose import compose_config, resolved
from zoac.envs.base import ArrayVecEnv
from zoac.runs.training.lifecycle import run_session

SHORT = ("budget=500", "evaluation.episodes=1", "evaluation.final_episodes=1")


def timed(method: Callable[..., Any], spent: list[float]) -> Callable[..., Any]:
    """Return `method`, which then adds its seconds to `spent`."""

    @wraps(method)
    def call(*args: Any, **options: Any) -> Any:
        began = time.perf_counter()
        answer = method(*args, **options)
        spent.append(time.perf_counter() - began)
        return answer

    return call


def each_run(overrides: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the overrides of every run that overrides with several values stand for."""
    choices = []
    for override in OverridesParser.create().parse_overrides(list(overrides)):
        if override.is_sweep_override():
            key = override.get_key_element()
            choices.append([f"{key}={value}" for value in override.sweep_string_iterator()])
        else:
            choices.append([str(override.input_line)])
    return list(product(*choices))


def run(overrides: Sequence[str]) -> dict[str, Any]:
    """Make a run in a temporary folder, and return its result."""
    with tempfile.TemporaryDirectory() as folder:
        here = [] if any(o.startswith("executor=") for o in overrides) else ["executor=serial"]
        config = compose_config([*overrides, *here, f"runs_dir={folder}"])
        choices = config.hydra.runtime.choices
        return run_session(
            resolved(config), task=choices["task"], tuner=choices["tuner"], command=sys.argv
        )


def timed_run(overrides: Sequence[str], in_environments: list[float]) -> float:
    """Make a run, print where its time went, and return its seconds."""
    run([*overrides, *SHORT])
    in_environments.clear()
    result = run(overrides)
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
    return wall


def main() -> None:
    in_environments: list[float] = []
    for name in ("step", "reset"):
        setattr(ArrayVecEnv, name, timed(getattr(ArrayVecEnv, name), in_environments))
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("overrides", nargs="*", metavar="key=value")
    runs = each_run(parser.parse_args().overrides)
    walls = [timed_run(overrides, in_environments) for overrides in runs]
    if len(runs) > 1:
        print()
    for overrides, wall in zip(runs[1:], walls[1:], strict=True):
        other = set(overrides) - set(runs[0])
        print(f"{' '.join(sorted(other)):60} {wall / walls[0]:6.2f} times the first")


if __name__ == "__main__":
    main()
