"""What `zoac.tune_pid` is asked for: plants, the controller's structure, limits and noise."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from zoac.controllers import tuning_rules
from zoac.controllers.pid import PID
from zoac.core.errors import ConfigError, suggest
from zoac.core.types import is_number
from zoac.envs.linear_loop import SampledPlant, sampled

Gains = dict[str, float]

PARAMETERS = {
    "P": ("Kp",), "PI": ("Kp", "Ki"), "PD": ("Kp", "Kd", "Tf"), "PID": ("Kp", "Ki", "Kd", "Tf"),
}  # fmt: skip
RULES = ("simc", "ziegler_nichols", "tyreus_luyben")


@dataclass(frozen=True)
class Design:
    """What `zoac.tune_pid` was asked for: its arguments, with a dead time [s] for each system.

    Raises:
        ConfigError: If an argument is out of its range.
    """

    systems: Sequence[Any]
    dead_times: Sequence[float]
    sample_time: float
    structure: str = "PI"
    input_limits: tuple[float, float] = (-math.inf, math.inf)
    noise: float = 0.0

    def __post_init__(self) -> None:
        _known(self.structure)
        _ = self.pid, self.plants  # refuses a sample time and plants that are none
        for system in self.systems:
            if np.abs(system.zeros()).min(initial=np.inf) < 1e-9 or system(1j) == 0:
                raise ConfigError(
                    "plant: a lasting input has no lasting effect on its output (a zero at 0), so "
                    "nothing holds a reference; of a pole and a zero that cancel give "
                    "plant.minreal()"
                )
        low, high = self.input_limits
        if not low <= 0.0 <= high:
            raise ConfigError(
                f"input_limits={self.input_limits}: expected (low, high) around 0, the input at "
                "rest; state limits as deviations from it"
            )
        if not (is_number(self.noise) and math.isfinite(self.noise) and self.noise >= 0):
            raise ConfigError(f"noise={self.noise!r}: expected a standard deviation, 0 or more")

    @property
    def pid(self) -> PID:
        """The controller's structure."""
        return PID(sample_time=self.sample_time, r=1, output_limits=self.input_limits)

    @cached_property
    def plants(self) -> list[SampledPlant]:
        """The plants as seen at the samples."""
        return [
            sampled(system, self.sample_time, dead_time)
            for system, dead_time in zip(self.systems, self.dead_times, strict=True)
        ]

    @cached_property
    def by_rule(self) -> dict[str, Gains | ConfigError]:
        """Gains of each rule, of several plants those of the smallest Kp; or why it has none."""
        return {rule: self._answer(rule) for rule in RULES}

    def _answer(self, rule: str) -> Gains | ConfigError:
        try:
            found = [
                tuning_rules.gains(rule, system, self.structure, dead_time, self.sample_time)
                for system, dead_time in zip(self.systems, self.dead_times, strict=True)
            ]
        except ConfigError as error:
            return error
        weakest = min(found, key=lambda gains: abs(gains["Kp"]))
        if not (weakest["Kp"] and all(map(math.isfinite, weakest.values()))):
            return ConfigError(f"{rule} gives Kp={weakest['Kp']:g} here, which is no gain to use")
        return {name: float(weakest[name]) for name in PARAMETERS[self.structure]}


def gains_of(structure: str, given: Mapping[str, float]) -> Gains:
    """Return given gains, those of a structure, with a filter where none is named.

    Raises:
        ConfigError: If the structure is unknown, gains are not given by name, or a gain is unknown,
            missing or not finite, or Tf is negative.
    """
    _known(structure)
    names = PARAMETERS[structure]
    if not isinstance(given, Mapping):
        raise ConfigError(
            f"baseline={given!r}: expected a rule such as 'simc', or gains such as "
            "{'Kp': 1.0, 'Ki': 0.5}"
        )
    for name, value in given.items():
        if name not in names:
            raise ConfigError(f"baseline: unknown gain {name!r}; {suggest(name, names)}")
        if not (is_number(value) and math.isfinite(value)):
            raise ConfigError(f"baseline: {name}={value!r}, expected a finite number")
        if name == "Tf" and value < 0:
            raise ConfigError(f"baseline: Tf={value!r}, expected seconds, 0 or more")
    gains = dict(given)
    if "Tf" in names and {"Kp", "Kd"} <= gains.keys() and gains["Kp"]:
        gains.setdefault("Tf", tuning_rules.FILTER * abs(gains["Kd"] / gains["Kp"]))
    missing = [name for name in names if name not in gains]
    if missing:
        raise ConfigError(f"baseline: no value for {', '.join(missing)} of a {structure}")
    return {name: float(gains[name]) for name in names}


def _known(structure: str) -> None:
    if not isinstance(structure, str) or structure not in PARAMETERS:
        raise ConfigError(f"structure={structure!r}: {suggest(str(structure), PARAMETERS)}")
