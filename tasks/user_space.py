"""The parameters that a user names in a dict or a YAML file, as a space."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError
from zoac.core.parameters import Parameter, ParameterSpace, choice


def parse_space(
    space: ParameterSpace | Mapping[str, Any], baseline: Mapping[str, Any] | None = None
) -> tuple[ParameterSpace, dict[str, float], dict[str, Any]]:
    """Return a space, its fixed parameters and the baseline values.

    Args:
        space: A `ParameterSpace`, or by name: `(low, high)`, `(low, high, "log")`,
            `(low, high, "integer")`, `{"low": ..., "high": ..., "scale": ..., "unit": ...,
            "baseline": ...}`, `{"choices": [...], "baseline": ...}`, or one number, which is fixed.
        baseline: Values by name, which go before those of the space.

    Raises:
        ConfigError: If an entry is none of these, or a value cannot be used.
    """
    if not isinstance(baseline, Mapping | None):
        raise ConfigError(f"baseline={baseline!r}: expected values by name, such as {{'kp': 1.0}}")
    fixed: dict[str, float] = {}
    values: dict[str, Any] = {}
    if not isinstance(space, ParameterSpace):
        if not isinstance(space, Mapping):
            raise ConfigError(f"space={space!r}: expected bounds by name, such as {{'kp': (0, 5)}}")
        parameters = []
        for name, entry in space.items():
            if not isinstance(name, str) or not name:
                raise ConfigError(f"space: the name of a parameter must be text, got {name!r}")
            entry = _plain(entry)
            if isinstance(entry, (int, float)):
                fixed[name] = entry  # a whole number stays one: a controller may count with it
                continue
            fields = _fields(entry, f"space[{name!r}]")
            if "baseline" in fields:
                values[name] = fields.pop("baseline")
            parameters.append(_parameter(name, fields))
        space = ParameterSpace(parameters)
    values |= baseline or {}
    if values:
        space.normalise(values)  # says what is wrong with one
    return space, fixed, values


def _fields(entry: Any, where: str) -> dict[str, Any]:
    """Return a parameter's entry by name."""
    if isinstance(entry, Sequence) and not isinstance(entry, str):
        if len(entry) > len(_FIELDS):
            raise ConfigError(
                f"{where}={entry!r}: expected at most {', '.join(_FIELDS)}; a start value goes "
                f"into a dict, such as {{'low': 0, 'high': 5, 'baseline': 1}}"
            )
        entry = dict(zip(_FIELDS, entry, strict=False))
    if not isinstance(entry, Mapping):
        raise ConfigError(
            f"{where}={entry!r}: expected (low, high), (low, high, 'log'), a dict or a number"
        )
    fields = {key: _plain(value) for key, value in entry.items()}
    if "baseline" in fields and "choices" not in fields:
        given = fields["baseline"]
        try:
            fields["baseline"] = float(given)
        except (TypeError, ValueError):
            raise ConfigError(f"{where}.baseline={given!r}: expected a number") from None
    return fields


def _plain(value: Any) -> Any:
    """Return a NumPy array or number as a list or a number of Python's."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


_FIELDS = ("low", "high", "scale", "unit")


def _parameter(name: str, fields: dict[str, Any]) -> Parameter:
    if fields.get("scale") == "integer":
        fields |= {"scale": "linear", "kind": "integer"}
    try:
        if "choices" in fields:
            return choice(name, fields.pop("choices"), **fields)
        return Parameter(name=name, **fields)
    except (TypeError, OverflowError):  # which a whole number that no float can hold raises
        raise ConfigError(
            f"space[{name!r}]={dict(fields)!r}: expected low and high, and if wanted "
            "scale ('linear', 'log' or 'integer'), unit, baseline; or choices"
        ) from None
