"""What is reported of segments beside their cost: metrics, constraints, and traces for figures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from zoac.core.errors import ConfigError, ZoacError, as_text, suggest
from zoac.core.types import is_number

if TYPE_CHECKING:
    from zoac.core.segments import Segment

CLOCKS = (
    "wall_seconds", "compute_seconds", "solver_seconds", "tuner_seconds", "evaluation_seconds",
    "checkpoint_seconds",
)  # fmt: skip
"""Keys of results and rows that tell time: all else is the same for the same seed."""

RESERVED = frozenset({
    "format", "task", "tuner", "seed", "variant", "config_hash", "kind", "final", "x", "parameters",
    "env_steps", "cost_mean", "cost_std", "cost_per_episode", "episode_lengths", "terminations",
    "violations", "violations_by_constraint", "env_restarts", "tuning_terminations",
    "baseline_cost_mean", "baseline", "acceptance_test", "select", "held_specs", "shown",
    "warnings", "failures", "first_failure", "failed_episodes", "specs", "by_spec", "stopped_by",
    "finished", "evaluated_after_steps", "experiments", "best_trial", *CLOCKS,
})  # fmt: skip
"""Keys of evaluation rows and of results, which no metric may take. `solver_failures` is
free: a metric of that name counts an evaluation's, `result.json` those of the whole run."""


def refuse_reserved(name: str) -> None:
    """Refuse the name of a metric that would overwrite a number of a result.

    Raises:
        ConfigError: If it is one of `RESERVED`.
    """
    if name in RESERVED:
        raise ConfigError(
            f"metric {name!r}: results have a number of that name already; call it otherwise, "
            f"such as {f'my_{name}'!r}"
        )


def read_from(
    function: Callable[[Segment], Any], segment: Segment, what: str, dtype: Any = None
) -> np.ndarray:
    """Return what a user's function of a segment returns, as an array.

    Args:
        function: The user's.
        segment: Its argument.
        what: What it is, for the message.
        dtype: Of the array; None: as it comes.

    Raises:
        ConfigError: If the function raises, or returns what is no such array. It tells what a
            segment has.
    """
    try:
        return np.asarray(function(_read_only(segment)), dtype=dtype)
    except ZoacError:
        raise
    except Exception as error:  # whatever a user's function raises
        diagnostics = ", ".join(segment.diagnostics) or "none"
        raise ConfigError(
            f"{what} raised {as_text(error)}; a segment has observations "
            f"{segment.observations.shape}, actions {segment.actions.shape}, costs "
            f"{segment.costs.shape}, and diagnostics: {diagnostics}"
        ) from error


def _read_only(segment: Segment) -> Segment:
    """Return a segment whose arrays cannot be changed: other functions read them too."""
    names = ("observations", "actions", "commands", "costs")
    views: dict[str, Any] = {name: _locked(getattr(segment, name)) for name in names}
    diagnostics = {name: _locked(values) for name, values in segment.diagnostics.items()}
    return replace(segment, **views, diagnostics=diagnostics)


def _locked(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, slots=True)
class _Quantity:
    """A name, and a function of a segment that returns one value per step, (T,)."""

    name: str
    per_step: Callable[[Segment], np.ndarray]

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ConfigError(f"the name of a {self._what()} must be text, got {self.name!r}")
        if not callable(self.per_step):
            raise ConfigError(
                f"{self._what()} {self.name!r}: expected a function of a segment, got "
                f"{self.per_step!r}"
            )

    def _what(self) -> str:
        return type(self).__name__.lower()

    def values(self, segment: Segment) -> np.ndarray:
        """Return one number per step, (T,).

        Raises:
            ConfigError: If `per_step` raises, or returns anything else.
        """
        values = read_from(self.per_step, segment, f"{self._what()} {self.name!r}")
        if values.shape != (segment.length,) or values.dtype.kind not in "biuf":
            raise ConfigError(
                f"{self._what()} {self.name!r} returned {values.dtype} of shape {values.shape}, "
                f"expected one number per step, ({segment.length},)"
            )
        return values


@dataclass(frozen=True, slots=True)
class Metric(_Quantity):
    """A quantity reported beside the cost.

    Args:
        name: Name in logs and results.
        per_step: Function of a segment that returns one value per step, (T,).
        reduce: "mean" over all steps of all episodes, or "sum".

    Raises:
        ConfigError: If the name is one that results have already (`RESERVED`), or an argument
            cannot be used.
    """

    reduce: Literal["mean", "sum"] = "mean"

    def __post_init__(self) -> None:
        _Quantity.__post_init__(self)
        refuse_reserved(self.name)
        if self.reduce not in ("mean", "sum"):
            raise ConfigError(
                f"metric {self.name!r}: unknown reduce {self.reduce!r}; "
                f"{suggest(self.reduce, ('mean', 'sum'))}"
            )


@dataclass(frozen=True, slots=True)
class Constraint(_Quantity):
    """A quantity that must not be above a limit at any step; see `zoac.rollout.constraints`.

    Args:
        name: Name in logs and results.
        per_step: Function of a segment that returns one value per step, (T,); above the limit is a
            violation, by so much.
        scale: What counts as a large excess over the limit, in the quantity's own unit; above
            zero. None: as much as the limit itself; where that is 0, the largest excess so far.
        limit: In the quantity's own unit.

    Raises:
        ConfigError: If limit or scale cannot be used, or another argument.
    """

    scale: float | None = None
    limit: float = 0.0

    def __post_init__(self) -> None:
        _Quantity.__post_init__(self)
        if not is_number(self.limit) or not math.isfinite(self.limit):
            raise ConfigError(
                f"constraint {self.name!r}: limit={self.limit!r}, expected a finite number, in the "
                "quantity's own unit"
            )
        scale = self.scale
        if scale is not None and not (is_number(scale) and math.isfinite(scale) and scale > 0):
            raise ConfigError(
                f"constraint {self.name!r}: scale={scale!r}, expected a number above zero, "
                "what counts as a large excess, in the quantity's own unit"
            )

    def excess(self, segment: Segment) -> np.ndarray:
        """Return by how much the limit is exceeded at each step, (T,); infinite for NaN.

        Raises:
            ConfigError: If `per_step` does not return one number per step.
        """
        over = self.values(segment).astype(np.float64) - self.limit
        return np.where(np.isnan(over), np.inf, np.maximum(over, 0.0))


@dataclass(frozen=True, eq=False, slots=True)
class Trace:
    """One line that figures show of a segment.

    Args:
        title: Quantity and unit.
        x: Abscissae (K,).
        y: Ordinates (K,).
        x_label: Quantity and unit of `x`.
        reference: Points (x, y) of a line to see it against, if any.
        limits: Ordinates that bound it.
    """

    title: str
    x: np.ndarray
    y: np.ndarray
    x_label: str = "Step"
    reference: tuple[np.ndarray, np.ndarray] | None = None
    limits: tuple[float, ...] = ()
