"""What must hold of a task before it is tuned: every check, and what it found."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from zoac.check.controller import dead_parameters, hidden_state
from zoac.check.environment import (
    baseline_specs,
    determinism,
    env_state,
    episodes_end,
    round_trip,
    shapes,
    time_per_step,
)
from zoac.check.samples import Found
from zoac.core.errors import ZoacError, as_text
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
            yield Verdict(name, False, f"raised {as_text(error)}")


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
