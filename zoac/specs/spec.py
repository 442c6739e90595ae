"""One requirement: a figure of the response or of the loop, its limit, and over what it counts."""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError, ZoacError, as_text
from zoac.core.types import is_number
from zoac.specs.signals import Episode

Over = str | tuple[str, float]
Loop = Callable[[Mapping[str, Any]], Any]
"""Function of the parameters, by name, that returns an open loop: a system of python-control."""

NEVER = 1e6
"""Relative excess of a value that is not finite."""


def cvar(part: float) -> tuple[str, float]:
    """Return "the mean of the worst `1 - part` of the episodes", for `over`.

    Raises:
        ConfigError: If `part` is not from 0 to below 1.
    """
    if not (is_number(part) and 0.0 <= part < 1.0):
        raise ConfigError(f"cvar({part!r}): expected a part from 0 to below 1, such as 0.9")
    return "cvar", float(part)


@dataclass(frozen=True)
class Spec:
    """One requirement.

    With a limit it is hard: parameters that break it rank behind all that keep it. Without one it
    is soft, a part of the objective.

    Args:
        name: Name of the figure.
        signals: Names of the signals that `figure` takes; empty for a figure of a loop.
        figure: Function of the time (K,) [s] and of the samples (K,) of each signal; of a loop for
            figures of a loop. Returns one number.
        options: Further arguments of `figure`, by name.
        max: Largest value allowed; None: none.
        min: Smallest value allowed.
        over: How evaluation episodes are summarised: "worst", "mean" or `cvar(0.9)`; None: the
            worst for a hard spec, the mean for a soft one.
        weight: Weight of a soft spec in the objective.
        window: Start and end [s] of the part of the episode that is judged; None: all of it.
        loop: Function of the parameters that returns the open loop, for figures of a loop.
        unit: For people to read.
        timed: Whether the figure needs seconds.
        beyond: Function like `figure`, used where the figure is an infinite time. It returns by
            what factor, above 1, that time counts as later than both the last sample and `max`, so
            that of two responses that never settle the nearer one is better.

    Raises:
        ConfigError: If a limit is not finite, or an argument cannot be used.
    """

    name: str
    signals: tuple[str, ...]
    figure: Callable[..., float] = field(repr=False)
    options: Mapping[str, Any] = field(default_factory=dict)
    max: float | None = None
    min: float | None = None
    over: Over | None = None
    weight: float = 1.0
    window: tuple[float, float] | None = None
    loop: Loop | None = field(default=None, repr=False)
    unit: str = ""
    timed: bool = False
    beyond: Callable[..., float] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.window is not None and not _is_window(self.window):
            raise ConfigError(
                f"{self.name}: window={self.window!r}, expected (from, to) in seconds, such as "
                "(0, 2.5)"
            )
        for side, limit in (("max", self.max), ("min", self.min)):
            if limit is not None and not (is_number(limit) and math.isfinite(limit)):
                raise ConfigError(f"{self}: {side}={limit!r}, expected a finite number")
        if self.max is not None and self.min is not None and self.min > self.max:
            raise ConfigError(f"{self}: min={self.min} lies above max={self.max}")
        if self.over not in (None, "worst", "mean") and not _is_cvar(self.over):
            raise ConfigError(f"{self}: over={self.over!r}; expected 'worst', 'mean' or cvar(0.9)")
        if not (is_number(self.weight) and math.isfinite(self.weight) and self.weight > 0):
            raise ConfigError(f"{self}: weight={self.weight!r}, expected a number above 0")
        if self.of_loop and self.window is not None:
            raise ConfigError(f"{self.name}: window={self.window!r}, and a loop has no time")
        if not self.hard and self.of_loop:
            raise ConfigError(f"{self}: a figure of a loop needs a limit: give max= or min=")
        if not self.hard and self.over not in (None, "mean"):
            raise ConfigError(
                f"{self}: over={self.over!r} without a limit; the objective is a mean over episodes"
            )

    def __str__(self) -> str:
        known = inspect.signature(self.figure).parameters
        options = [
            f"{name}={value:g}"
            for name, value in self.options.items()
            if name not in known or known[name].default != value
        ]
        if self.window is not None:
            options.append(f"{self.window[0]:g} to {self.window[1]:g} s")
        arguments = [*self.signals, *options]
        return f"{self.name}({', '.join(arguments)})" if arguments else self.name

    @property
    def hard(self) -> bool:
        """Whether it has a limit."""
        return self.max is not None or self.min is not None

    @property
    def of_loop(self) -> bool:
        """Whether it is judged from the parameters alone, without a simulation."""
        return not self.signals

    @property
    def _over(self) -> Over:
        return self.over or ("worst" if self.hard else "mean")

    @property
    def limit(self) -> str:
        """The limit for people to read; empty for a soft spec."""
        pairs = ((">=", self.min), ("<=", self.max))
        text = " and ".join(f"{sign} {limit:g}" for sign, limit in pairs if limit is not None)
        return f"{text} {self.unit}" if text and self.unit else text

    @property
    def worst(self) -> float:
        """The value of what cannot be measured: minus infinity with a lower limit only."""
        return -math.inf if self.max is None and self.min is not None else math.inf

    @property
    def label(self) -> str:
        """What and its limit, for people to read; no two specs of a task have the same."""
        return f"{self} {self.limit}".rstrip()

    def of_episode(self, episode: Episode) -> float:
        """Return the figure of one episode; `worst` if it ended before its time.

        Signals (K, m) of m loops side by side have m figures: the worst counts, of a soft spec the
        mean.
        """
        return self.worst if episode.ended < 1.0 else self._over_loops(self.figure, episode)

    def violation_of(self, episode: Episode, value: float) -> float:
        """Return 1 + v / (1 + v), v being the excess; 0 if the limit holds.

        An episode that ended early breaks every limit, and an objective too: by 2, more than any
        excess, and by the part of the time that it missed.

        Args:
            episode: Its signals.
            value: What `of_episode` returned.
        """
        if episode.ended < 1.0 and not self.of_loop:
            return 3.0 - episode.ended
        if not self.hard:
            return 0.0 if math.isfinite(value) else graded(NEVER)
        if self.beyond is not None and self.max is not None and value == math.inf:
            value = self._finite_beyond(self.beyond, self.max, episode)
        return graded(self.excess(value))

    def _finite_beyond(self, beyond: Callable[..., float], most: float, episode: Episode) -> float:
        """Return the time [s] above the limit `most` that stands for an infinite one."""
        time = episode.within(self.window).time
        value = max(float(time[-1] - time[0]), most) * self._over_loops(beyond, episode)
        return max(math.nextafter(most, math.inf), value)  # a factor may round to 1

    def of_loops(self, episode: Episode, figure: Callable[..., float] | None = None) -> list[float]:
        """Return a figure, by default this spec's, of each of the loops side by side."""
        episode = episode.within(self.window)
        samples = [episode.values[name] for name in self.signals]
        count = max(s.shape[1] if s.ndim > 1 else 1 for s in samples)
        columns = [[s if s.ndim == 1 else s[:, j] for s in samples] for j in range(count)]
        of = figure or self.figure
        return [self._number(of(episode.time, *column, **self.options)) for column in columns]

    def _over_loops(self, figure: Callable[..., float], episode: Episode) -> float:
        """Return a figure of an episode; of the loops side by side the worst, or the mean."""
        values = self.of_loops(episode, figure)
        return self._most_binding(values) if self.hard else float(np.mean(values))

    def of_parameters(self, parameters: Mapping[str, Any]) -> float:
        """Return the figure of the loop with these parameters, by name.

        Raises:
            ConfigError: If the loop cannot be made, or is none of a single input and output.
        """
        assert self.loop is not None  # see `zoac.specs.judge.check`
        try:
            return self._number(self.figure(self.loop(parameters), **self.options))
        except ZoacError:
            raise
        except Exception as error:  # whatever a user's function raises
            why = f"loop({dict(parameters)}) raised {as_text(error)}"
            if isinstance(error, KeyError):
                why = f"loop(parameters) asked for {error}; known: {', '.join(parameters)}"
            elif isinstance(error, ModuleNotFoundError) and error.name == "control":
                why = "figures of a loop need python-control: pip install 'zoac[control]'"
            raise ConfigError(f"{self}: {why}") from error

    def _number(self, value: float) -> float:
        return self.worst if math.isnan(value) else float(value)

    def _most_binding(self, values: Sequence[float]) -> float:
        """Return the value that breaks the limits by most, or comes nearest to doing so."""
        low, high = np.min(values), np.max(values)
        if self.max is None or self.min is None:
            return float(low if self.worst < 0 else high)
        return float(low if self.min - low > high - self.max else high)

    def over_episodes(self, values: Sequence[float]) -> float:
        """Return one value, by `over`, from those of the episodes (E,)."""
        array = np.asarray(values, dtype=np.float64)
        over = self._over
        if over == "mean":
            with np.errstate(invalid="ignore"):  # plus and minus infinity
                return self._number(array.mean())
        if over == "worst":
            return self._most_binding(array.tolist())
        ordered = np.sort(array) if self.worst < 0 else np.sort(array)[::-1]
        count = max(1, math.ceil((1.0 - float(over[1])) * len(ordered) - 1e-9))
        return float(ordered[:count].mean())

    def excess(self, value: float) -> float:
        """Return by how much `value` breaks the limit, as a fraction of the limit; 0 if it holds.

        A limit of 0 counts as 1; a value without bound breaks a limit by `NEVER`.
        """
        return min(NEVER, max(0.0, self.beyond_limit(value)))

    def beyond_limit(self, value: float) -> float:
        """Return `excess` with its sign: below 0 as far as `value` is from the limit."""
        return max(
            -math.inf if self.max is None else (value - self.max) / (abs(self.max) or 1.0),
            -math.inf if self.min is None else (self.min - value) / (abs(self.min) or 1.0),
        )

    def met(self, value: float) -> bool | None:
        """Return whether a value keeps the limit; None without one."""
        return self.excess(value) == 0.0 if self.hard else None

    def told(self) -> str:
        """Return all that tells this spec from others beside its functions, in one line."""
        over = self._over
        counted = over if isinstance(over, str) else f"cvar({over[1]:g})"
        weight = "" if self.hard else f", weight {self.weight!r}"
        limits = f"min={self.min!r}, max={self.max!r}" if self.hard else "objective"
        return f"{self}: {limits}, {counted}{weight}"


def graded(excess: float) -> float:
    """Return 1 + v / (1 + v) for an excess v above 0, NaN being one without bound; else 0."""
    if excess <= 0.0:
        return 0.0
    return 1.0 + excess / (1.0 + excess) if excess < math.inf else 2.0


def _is_cvar(over: Any) -> bool:
    return isinstance(over, tuple) and len(over) == 2 and over == cvar(over[1])


def _is_window(window: Any) -> bool:
    return (
        isinstance(window, tuple)
        and len(window) == 2
        and all(is_number(t) and math.isfinite(t) for t in window)
        and 0 <= window[0] < window[1]
    )
