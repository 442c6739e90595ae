"""One experiment of a study: its parameters, and what came of it."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.core.parameters import ParameterSpace
from zoac.core.types import is_number

State = Literal["pending", "told", "failed", "abandoned"]


@dataclass(frozen=True)
class Measured:
    """What an experiment gave.

    Args:
        cost: To be minimised.
        metrics: Further numbers by name, which are only recorded.
        constraints: Measured values by name; each must not be above its limit.
    """

    cost: float
    metrics: dict[str, float] = field(default_factory=dict)
    constraints: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Trial:
    """An experiment.

    Args:
        number: From 1; no other trial of the study ever has it.
        parameters: Physical values by name, fixed ones included.
        x: Normalised parameters (d,).
        state: "pending" until a result is told; then "told", "failed" or "abandoned".
        cost: None unless told.
        metrics: By name.
        constraints: Measured values by name.
        violation: By how much constraints were exceeded; 0 where all hold.
        reason: Why it failed or was abandoned.
        by: Who asked, if the caller said so.
        asked: When, in seconds since 1970.
        ended: When the result was told, likewise; None while pending.
    """

    number: int
    parameters: dict[str, Any]
    x: tuple[float, ...] = field(repr=False)
    state: State = "pending"
    cost: float | None = None
    metrics: dict[str, float] = field(default_factory=dict)
    constraints: dict[str, float] = field(default_factory=dict)
    violation: float = 0.0
    reason: str | None = None
    by: str = ""
    asked: float = 0.0
    ended: float | None = None

    @property
    def pending(self) -> bool:
        """Whether no result is known yet."""
        return self.state == "pending"


KEYS = ("cost", "metrics", "constraints")


def measured(
    answer: Any,
    limits: Mapping[str, float],
    metrics: Mapping[str, float] | None = None,
    constraints: Mapping[str, float] | None = None,
) -> Measured:
    """Return what an experiment's answer says.

    Args:
        answer: The cost; or a mapping with `cost` and, if wanted, `metrics` and `constraints`,
            numbers by name.
        limits: Of the constraints that every experiment must measure.
        metrics: Beside those of the answer.
        constraints: Beside those of the answer.

    Raises:
        ConfigError: If the answer is neither, the cost is not finite, or a constraint with a limit
            was not measured.
    """
    if not isinstance(answer, Mapping):
        answer = {"cost": answer}
    for key in answer:
        if key not in KEYS:
            raise ConfigError(f"the answer has an unknown key {key!r}; {suggest(str(key), KEYS)}")
    if "cost" not in answer:
        raise ConfigError(f"the answer has no 'cost'; it has {', '.join(answer) or 'nothing'}")
    cost = _number(answer["cost"], "the cost")
    if not math.isfinite(cost):
        raise ConfigError(f"the cost is {cost}, expected a finite number")
    beside = {"metrics": metrics, "constraints": constraints}
    numbers = {
        kind: _numbers(answer.get(kind), kind) | _numbers(more, kind)
        for kind, more in beside.items()
    }
    missing = [name for name in limits if name not in numbers["constraints"]]
    if missing:
        raise ConfigError(
            f"the answer does not say the constraint(s) {', '.join(missing)}, which have a limit"
        )
    return Measured(cost, **numbers)


def _numbers(given: Any, kind: str) -> dict[str, float]:
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ConfigError(f"{kind}: expected numbers by name, got {given!r}")
    return {str(name): _number(value, f"{kind}: {name!r}") for name, value in given.items()}


def _number(value: Any, what: str) -> float:
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    if not is_number(value):
        raise ConfigError(f"{what} is {value!r}, expected a number")
    return float(value)


def violation(constraints: Mapping[str, float], limits: Mapping[str, float]) -> float:
    """Return by how much measured values exceed their limits, as `zoac.rollout.constraints` does.

    Each exceeded constraint counts 1 + v / (1 + v), v being the excess relative to the limit. A
    constraint without a limit has the limit 0, and an excess of 1 then counts as v = 1.

    Args:
        constraints: Measured values by name.
        limits: By name.
    """
    total = 0.0
    for name, value in constraints.items():
        limit = limits.get(name, 0.0)
        excess = (value - limit) / (abs(limit) or 1.0)
        if not math.isfinite(excess):
            total += 2.0
        elif excess > 0:
            total += 1.0 + excess / (1.0 + excess)
    return total


def asked_row(
    number: int, space: ParameterSpace, fixed: Mapping[str, Any], x: np.ndarray, by: str
) -> dict[str, Any]:
    """Return the journal's row for an experiment with normalised parameters x (d,)."""
    x = space.clip(x)
    parameters = {**space.named(x), **fixed}
    return {"kind": "asked", "number": number, "time": time.time(), "by": by,
            "parameters": parameters, "x": x.tolist()}  # fmt: skip


def told_row(number: int, result: Measured | str, kind: str, now: float) -> dict[str, Any]:
    """Return the journal's row for a result: a measurement, or the reason of a failure."""
    row: dict[str, Any] = {"kind": kind, "number": number, "time": now}
    if isinstance(result, str):
        return {**row, "reason": result}
    row["cost"] = result.cost
    for name in ("metrics", "constraints"):
        if values := getattr(result, name):
            row[name] = {k: v if math.isfinite(v) else None for k, v in values.items()}
    return row


def same_result(trial: Trial, result: Measured | str, kind: str) -> bool:
    """Tell whether a trial has exactly this result already."""
    if trial.state != kind:
        return False
    if isinstance(result, str):
        return trial.reason == result
    known = [trial.cost, trial.metrics, trial.constraints]
    return json.dumps(known) == json.dumps([result.cost, result.metrics, result.constraints])
