"""One experiment of a study: its parameters, and what came of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from zoac.core.errors import ConfigError, StudyError, as_text, suggest
from zoac.core.measures import refuse_reserved
from zoac.core.types import is_number
from zoac.runs.schema import plain
from zoac.specs.spec import Spec, graded
from zoac.specs.trace import judged

if TYPE_CHECKING:
    import pandas as pd

State = Literal["pending", "told", "failed", "abandoned"]


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

    @property
    def rank(self) -> tuple[float, float]:
        """Violation and cost: the least is the best."""
        return self.violation, math.inf if self.cost is None else self.cost


def number_of(given: Any) -> int:
    """Return the number of a trial, which is given by itself or by its number."""
    number = given.number if isinstance(given, Trial) else given
    if not is_number(number) or number % 1:
        raise StudyError(f"there is no trial {given!r}; expected a trial or its number")
    return int(number)


def reason_of(given: Any) -> dict[str, Any]:
    """Return why an experiment has no cost, as the journal's row holds it."""
    if isinstance(given, Exception):
        given = as_text(given)
    if not isinstance(given, str):
        raise ConfigError(f"the reason of a failure is {given!r}, expected text or an exception")
    return {"reason": given}


KEYS = ("cost", "metrics", "constraints")


def measured(
    answer: Any,
    limits: Mapping[str, float],
    metrics: Mapping[str, float] | None = None,
    constraints: Mapping[str, float] | None = None,
    *,
    trace: pd.DataFrame | None = None,
    specs: Sequence[Spec] = (),
) -> dict[str, Any]:
    """Return what an experiment gave, as the journal's row holds it; see `Study.tell`.

    Args:
        answer: The cost; or a mapping with `cost` and, if wanted, `metrics` and `constraints`,
            numbers by name. None beside a trace whose specs give the cost.
        limits: Of the constraints that every experiment must measure.
        metrics: Beside those of the answer.
        constraints: Beside those of the answer.
        trace: See `zoac.specs.trace.episode_of`.
        specs: Of the study, which judge the trace.
    """
    excess, of_specs = 0.0, dict[str, float]()
    if trace is not None:
        answer, excess, of_specs = judged(specs, trace, answer)
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
    named = dict[str, dict[str, float]]()
    for kind, beside in (("metrics", metrics), ("constraints", constraints)):
        named[kind] = numbers(answer.get(kind), kind) | numbers(beside, kind)
    named["specs"] = of_specs
    for name in named["metrics"]:
        refuse_reserved(name)
    if missing := [name for name in limits if name not in named["constraints"]]:
        raise ConfigError(
            f"the answer does not say the constraint(s) {', '.join(missing)}, which have a limit"
        )
    # Text such as "-inf" stands for what JSON has no number for.
    storable = {
        kind: {name: v if math.isfinite(v) else str(v) for name, v in given.items()}
        for kind, given in named.items()
    }
    row = {"cost": cost, "excess": excess, **storable}
    return {key: plain(value) for key, value in row.items() if value or key == "cost"}


def numbers(given: Any, kind: str) -> dict[str, float]:
    """Return numbers by name; refuse what is none."""
    if not isinstance(given, Mapping | None):
        raise ConfigError(f"{kind}: expected numbers by name, got {given!r}")
    pairs = (given or {}).items()
    return {str(name): _number(value, f"{kind}: {name!r}") for name, value in pairs}


def _number(value: Any, what: str) -> float:
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    if not is_number(value):
        raise ConfigError(f"{what} is {value!r}, expected a number")
    return float(value)


def violation(constraints: Mapping[str, float], limits: Mapping[str, float]) -> float:
    """Return by how much measured values exceed their limits, as `zoac.rollout.constraints` does.

    Each counts as `graded` by its excess relative to the limit. A constraint without a limit has
    the limit 0, and an excess of 1 then counts as v = 1.
    """
    above = ((value, limits.get(name, 0.0)) for name, value in constraints.items())
    return sum(graded((value - limit) / (abs(limit) or 1.0)) for value, limit in above)


def ended(trial: Trial, row: Mapping[str, Any], limits: Mapping[str, float]) -> Trial:
    """Return a trial with the result in a row of the journal."""
    numbers: dict[str, Any] = {
        kind: {name: math.nan if v is None else float(v) for name, v in row.get(kind, {}).items()}
        for kind in ("metrics", "constraints", "specs")
    }
    return replace(
        trial,
        state=row["kind"],
        cost=row.get("cost"),
        violation=violation(numbers["constraints"], limits) + row.get("excess", 0.0),
        reason=row.get("reason"),
        ended=row["time"],
        **numbers,
    )
