"""One experiment of a study: its parameters, and what came of it."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.core.parameters import ParameterSpace
from zoac.core.types import is_number
from zoac.specs.spec import Spec
from zoac.specs.trace import judged

if TYPE_CHECKING:
    import pandas as pd

State = Literal["pending", "told", "failed", "abandoned"]


@dataclass(frozen=True)
class Measured:
    """What an experiment gave.

    Args:
        cost: To be minimised.
        metrics: Further numbers by name, which are only recorded.
        constraints: Measured values by name; each must not be above its limit.
        specs: Values of the specs that judged a trace, by label.
        excess: By how much hard ones were exceeded.
    """

    cost: float
    metrics: dict[str, float] = field(default_factory=dict)
    constraints: dict[str, float] = field(default_factory=dict)
    specs: dict[str, float] = field(default_factory=dict)
    excess: float = 0.0


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
        specs: Values of the specs that judged its trace, by label.
        violation: By how much constraints and specs were exceeded; 0 where all hold.
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
    specs: dict[str, float] = field(default_factory=dict)
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
    numbers = _numbers(answer.get("metrics"), "metrics") | _numbers(metrics, "metrics")
    values = _numbers(answer.get("constraints"), "constraints")
    values |= _numbers(constraints, "constraints")
    missing = [name for name in limits if name not in values]
    if missing:
        raise ConfigError(
            f"the answer does not say the constraint(s) {', '.join(missing)}, which have a limit"
        )
    return Measured(cost, numbers, values)


def measured_trace(
    trace: pd.DataFrame,
    specs: Sequence[Spec],
    cost: float | None,
    limits: Mapping[str, float],
    metrics: Mapping[str, float] | None = None,
    constraints: Mapping[str, float] | None = None,
) -> Measured:
    """Return what a recorded trace says by specs; see `measured` for the others.

    Args:
        trace: See `zoac.specs.trace.episode_of`.
        specs: Of the study.
        cost: Needed if no spec is without a limit.
        limits: See `measured`.
        metrics: Likewise.
        constraints: Likewise.

    Raises:
        ConfigError: If the trace cannot be judged.
    """
    if not specs:
        raise ConfigError("a trace needs specs to judge it; give the study specs=[...]")
    objective, excess, values = judged(specs, trace)
    if (objective is None) == (cost is None):
        raise ConfigError(
            "a trace needs a cost beside it, since every spec of the study has a limit"
            if cost is None
            else "the cost comes from the specs without a limit; give none beside the trace"
        )
    found = measured(cost if objective is None else objective, limits, metrics, constraints)
    return replace(found, specs=values, excess=excess)


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
    if result.excess:
        row["excess"] = result.excess
    for name in ("metrics", "constraints", "specs"):
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
