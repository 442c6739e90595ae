"""Is a task fit to be tuned? `python -m zoac.check task=my_task [task.option=value ...]`

One verdict a line; exit code 1 if any is bad. It works on a user's task from their own folder.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from zoac.cli.pipes import reader_may_leave
from zoac.core.errors import ZoacError
from zoac.preconditions.controller import dead_parameters, hidden_state
from zoac.preconditions.environment import (
    determinism,
    env_state,
    episodes_end,
    round_trip,
    shapes,
    time_per_step,
)
from zoac.preconditions.samples import Found
from zoac.preconditions.specs import baseline_specs
from zoac.rollout.task import Task


class Verdict(NamedTuple):
    """What one check found."""

    name: str
    good: bool
    text: str

    def __str__(self) -> str:
        return f"{'ok  ' if self.good else 'FAIL'} {self.name}: {self.text}"


def check(task: Task) -> Iterator[Verdict]:
    """Yield one verdict for each check of `task`."""
    checks = {**CHECKS, "specs": baseline_specs} if task.specs else CHECKS
    for name, body in checks.items():
        try:
            yield Verdict(name, *body(task))
        except ZoacError as error:
            yield Verdict(name, False, str(error))
        except Exception as error:  # whatever a user's environment raises
            yield Verdict(name, False, f"raised {type(error).__name__}: {error}")


CHECKS: dict[str, Callable[[Task], Found]] = {
    "transform round trip": round_trip,
    "shapes and bounds": shapes,
    "episodes end": episodes_end,
    "seeded determinism": determinism,
    "saved and restored": env_state,
    "hidden state in the controller": hidden_state,
    "dead parameters": dead_parameters,
    "time per step": time_per_step,
}


@reader_may_leave()
def main(arguments: Sequence[str] | None = None) -> int:
    """Check the task that the overrides name; return the exit code."""
    from zoac.config.compose import compose_config, resolved
    from zoac.config.factory import build_task

    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help"):
        print(__doc__.strip())
        return 0 if arguments else 1
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        task = build_task(resolved(compose_config(arguments)))
    except ZoacError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    good = True
    for verdict in check(task):
        print(verdict, flush=True)
        good &= verdict.good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
