"""Numbers of a user's environment that are set before every episode: fixed ones and drawn ones."""

import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.core.types import is_number

Bounds = tuple[float, float] | list[float]


class PlantNumbers:
    """Attributes of the innermost environment. One that holds a whole number stays whole."""

    def __init__(
        self, env: gymnasium.Env, plant: Mapping[str, float], vary: Mapping[str, Bounds]
    ) -> None:
        """
        Args:
            env: An environment that has the attributes.
            plant: Numbers by attribute.
            vary: Likewise, ranges (low, high), of which every episode draws uniformly.

        Raises:
            ConfigError: If there is no such attribute, or it cannot be set to these numbers.
        """
        inner = env.unwrapped
        for name in (*plant, *vary):
            _set(inner, name, _found(inner, name))  # whether it can be set at all
        self.fixed = {
            name: _number(f"plant.{name}={value!r}", value, getattr(inner, name))
            for name, value in plant.items()
        }
        self._ranges = {
            name: _range(f"vary.{name}={bounds!r}", bounds, getattr(inner, name))
            for name, bounds in vary.items()
        }

    @property
    def drawn(self) -> bool:
        """Whether any are drawn."""
        return bool(self._ranges)

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        """Return one episode's numbers by attribute."""
        return self.fixed | {
            name: int(rng.integers(low, high, endpoint=True))
            if isinstance(low, int)
            else float(rng.uniform(low, high))
            for name, (low, high) in self._ranges.items()
        }

    @staticmethod
    def put(env: gymnasium.Env, numbers: Mapping[str, Any]) -> None:
        """Set the numbers; before a reset, whose start may depend on them.

        Raises:
            ConfigError: If there is no such attribute, or it cannot be set to its number.
        """
        for name, value in numbers.items():
            _found(env.unwrapped, name)
            _set(env.unwrapped, name, value)

    @staticmethod
    def check(env: gymnasium.Env, numbers: Mapping[str, Any]) -> None:
        """See that the numbers that were set before a reset are still there after it.

        Raises:
            ConfigError: If not.
        """
        inner = env.unwrapped
        for name, value in numbers.items():
            found: Any = getattr(inner, name, None)
            # Not to the last bit: an environment may keep it in single precision.
            if not (is_number(found) and np.isclose(found, value, rtol=1e-6, atol=0.0)):
                raise ConfigError(
                    f"{type(inner).__name__}.reset sets {name!r} to {found!r} itself, so it cannot "
                    f"be set to {value:g} by plant or vary; set it in __init__, and let reset read "
                    "it"
                )


def lost_number(env: gymnasium.Env, twin: gymnasium.Env) -> str | None:
    """Return the name of a number that is another one in `twin`, a copy of `env`."""
    for name, value in vars(env.unwrapped).items():
        found = getattr(twin.unwrapped, name, None)
        kept = is_number(value) or isinstance(value, bool | np.bool_)
        if kept and found != value and value == value:  # no NaN
            return name
    return None


def _found(inner: gymnasium.Env, name: str) -> Any:
    found = getattr(inner, name, None) if isinstance(name, str) else None
    if not is_number(found):
        raise ConfigError(
            f"{type(inner).__name__} has no number {name!r} to set; {_nearest(inner, name)}"
        )
    return found


def _set(inner: gymnasium.Env, name: str, value: Any) -> None:
    try:
        setattr(inner, name, value)
    except Exception as error:  # a property without a setter, or whatever a setter raises
        raise ConfigError(
            f"{type(inner).__name__}.{name} cannot be set to {value!r} ({type(error).__name__}: "
            f"{error}); {_nearest(inner, name)}"
        ) from error


def _nearest(inner: gymnasium.Env, name: str) -> str:
    return suggest(name, [k for k, v in vars(inner).items() if is_number(v) and k != name])


def _number(where: str, value: Any, found: Any) -> Any:
    """Return `value` as a number of the kind that the attribute holds.

    Raises:
        ConfigError: If it is none.
    """
    if not is_number(value) or not math.isfinite(value):
        raise ConfigError(f"{where}: expected a finite number")
    if not isinstance(found, int | np.integer):
        return float(value)
    if value != int(value):
        raise ConfigError(
            f"{where}: the environment has {found!r} there; expected a whole number. If any number "
            f"will do, have the environment begin with {float(found)!r}"
        )
    return int(value)


def _range(where: str, bounds: Any, found: Any) -> tuple[Any, Any]:
    try:
        low, high = bounds
    except (TypeError, ValueError):
        raise ConfigError(f"{where}: expected [low, high]") from None
    low, high = _number(where, low, found), _number(where, high, found)
    if not low <= high or not math.isfinite(float(high) - float(low)):
        raise ConfigError(f"{where}: expected [low, high], a finite distance apart")
    return low, high
