"""What a search varies: ranges in the configuration, as Optuna's distributions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from zoac.core.errors import ConfigError, suggest
from zoac.core.types import is_number


def distributions(ranges: Mapping[str, Any]) -> dict[str, Any]:
    """Return Optuna's distributions by dotted key.

    Args:
        ranges: Nested like the configuration. At a key either `low` and `high`, with `log: true`
            for a logarithmic scale, whole numbers if both bounds are; or a list of choices.

    Raises:
        ConfigError: If a range cannot be used.
    """
    found: dict[str, Any] = {}
    for key, node in _leaves(ranges):
        try:
            found[key] = _distribution(node)
        except (TypeError, ValueError) as error:
            raise ConfigError(f"search.ranges.{key}: {error}") from None
    if not found:
        raise ConfigError("search.ranges: there is nothing to search")
    return found


def _leaves(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in node.items():
        if isinstance(value, Mapping) and not value.keys() & {"low", "high"}:
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _distribution(node: Any) -> Any:
    optuna = load_optuna()
    if isinstance(node, list):
        return optuna.distributions.CategoricalDistribution(node)
    if not isinstance(node, Mapping):
        raise ValueError(f"expected low and high, or a list of choices, got {node!r}")
    for key in node:
        if key not in ("low", "high", "log"):
            raise ValueError(f"unknown {key!r}; {suggest(key, ('low', 'high', 'log'))}")
    bounds = node.get("low"), node.get("high")
    if not all(map(is_number, bounds)):
        raise ValueError(f"low and high must be numbers, got {bounds[0]!r} and {bounds[1]!r}")
    whole = all(isinstance(b, int) for b in bounds)
    kind = optuna.distributions.IntDistribution if whole else optuna.distributions.FloatDistribution
    return kind(*bounds, log=node.get("log", False))


def contains(distribution: Any, value: Any) -> bool:
    """Tell whether a value lies in one of Optuna's distributions."""
    choices = getattr(distribution, "choices", None)
    if choices is not None:
        return value in choices
    return is_number(value) and bool(distribution.low <= value <= distribution.high)


def value_at(plain: Mapping[str, Any], key: str) -> Any:
    """Return the value at a dotted key of a configuration."""
    node: Any = plain
    for part in key.split("."):
        if not isinstance(node, Mapping) or part not in node:
            known = node if isinstance(node, Mapping) else ()
            raise ConfigError(f"search.ranges: there is no {key!r}; {suggest(part, known)}")
        node = node[part]
    return node


def load_optuna() -> Any:
    """Return the module, quiet.

    Raises:
        ConfigError: If it is not installed.
    """
    try:
        import optuna
    except ImportError as error:
        raise ConfigError("zoac.search needs Optuna: pip install 'zoac[search]'") from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
