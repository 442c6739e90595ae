"""Which tuner "auto" stands for, in Python and on the command line.

`docs/which_tuner.md` has the rule and its measurements.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from zoac.config.files import AUTO, configuration
from zoac.core.errors import ConfigError, option_names
from zoac.core.types import is_number
from zoac.rollout.horizon import horizon_of
from zoac.rollout.task import Task

MAX_COORDINATES = 20
"""Beyond, a whole episode says too little about each coordinate."""

COMMON = {"common_random_numbers": True}


@dataclass(frozen=True)
class Choice:
    """A tuner that the rule has chosen, why, and settings of the run that go with it."""

    tuner: str
    because: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        more = " with common random numbers" if self.settings else ""
        return f"{self.tuner}{more}, for {self.because}"


def tuner_for(task: Task) -> Choice:
    """Return the tuner that "auto" stands for.

    Specs are judged over whole episodes, so CMA-ES tunes what has some. Without specs, successive
    halving finds its start and held-out episodes choose its answer. Differential evolution takes
    its place for a single parameter, and ZOAC for many.
    """
    dimension = task.space.dimension
    size = f"{dimension} parameter{'s' if dimension > 1 else ''}"
    if task.specs:
        return Choice("cmaes_full" if dimension > 1 else "nevergrad", f"specs and {size}")
    if dimension == 1:
        return Choice("nevergrad", size, COMMON)
    if dimension <= MAX_COORDINATES:
        return Choice("cmaes_plus", size, COMMON)
    return Choice("zoac_plus", size)


def budget_of(experiments: Any, budget: Any, task: Task) -> Any:
    """Return the budget in environment steps; `experiments`, if given, replace it."""
    if not is_number(experiments) or experiments <= 0:  # which is refused where all settings are
        return budget
    return experiments * horizon_of(task).steps


def settled(
    config: Mapping[str, Any], task: Task, chosen: Mapping[str, str]
) -> tuple[dict[str, Any], Choice | None]:
    """Return a command line's configuration with its budget in steps and the tuner of "auto".

    The choice of a tuner is returned beside it, if there was one. `chosen` has the names of the
    groups' choices, such as {"task": "pid_acc", "tuner": "auto"}.

    Raises:
        ConfigError: If the configuration has options for a tuner that is yet to be chosen.
    """
    config = {**config, "budget": budget_of(config["experiments"], config["budget"], task)}
    if chosen["tuner"] != AUTO:
        return config, None
    if options := option_names(config["tuner"]):
        raise ConfigError(
            f"tuner.{options[0]}: tuner={AUTO} has no options; name the tuner that has this one"
        )
    choice = tuner_for(task)
    known = {group: chosen[group] for group in ("task", "fidelity") if group in chosen}
    node = configuration(**known, tuner=choice.tuner)["tuner"]
    unset = {name: value for name, value in choice.settings.items() if config[name] is None}
    return {**config, "tuner": node, **unset}, choice
