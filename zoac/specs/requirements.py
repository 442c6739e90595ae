"""Requirements in the terms of the trade.

    zoac.specs.overshoot("y", "r", max=0.05)
    zoac.specs.settling_time("y", "r", band=0.02, max=2.0, over="mean")

All take the names of signals first, which are `y`, `r` and `u` unless others are given, and by
keyword `max`, `min`, `over`, `weight` and `window`: see `zoac.specs.Spec`.
"""

from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from typing import Any

from zoac.core.errors import ConfigError, suggest
from zoac.core.types import is_number
from zoac.specs import loops, step_info
from zoac.specs.spec import Loop, Spec

LIMITS = ("max", "min", "over", "weight", "window")
"""What every requirement takes beside its own arguments."""


def own_arguments(make: Callable[..., Spec]) -> list[str]:
    """Return the names of a requirement's own arguments."""
    return [p.name for p in signature(make).parameters.values() if p.kind != p.VAR_KEYWORD]


def _refuse_unknown(name: str, limits: Mapping[str, Any], takes: Sequence[str] = LIMITS) -> None:
    for key in limits:
        if key not in takes:
            known = [*own_arguments(globals()[name]), *takes]
            raise ConfigError(f"{name}: no argument {key!r}; {suggest(key, known)}")


def _of(name: str, *signals: str, limits: dict[str, Any], **others: Any) -> Spec:
    _refuse_unknown(name, limits)
    for signal in signals:
        if not isinstance(signal, str):
            raise ConfigError(
                f"{name}({signal!r}): expected the name of a signal; a limit has a name, such as "
                f"max={signal!r}"
            )
    if isinstance(window := limits.get("window"), list):  # from a YAML file
        limits["window"] = tuple(window)
    return Spec(name, signals, getattr(step_info, name), **{**others, **limits})


PERCENT = 2.0
"""An overshoot from which on a percentage is meant."""


def overshoot(y: str = "y", r: str = "r", **limits: Any) -> Spec:
    """Require how far `y` goes beyond the last value of `r`, as a fraction of the step.

    Args:
        y: Name of the output.
        r: Name of the reference.
        limits: `max`, `min` and other arguments of `Spec`, as in all requirements.

    Raises:
        ConfigError: If the limit looks like a percentage.
    """
    most: Any = limits.get("max")
    if is_number(most) and most >= PERCENT:
        raise ConfigError(
            f"overshoot: max={most!r} is {100 * most:g}% of the step; write 5% as max=0.05"
        )
    return _of("overshoot", y, r, limits=limits)


def settling_time(y: str = "y", r: str = "r", band: float = 0.02, **limits: Any) -> Spec:
    """Require the time [s] from which `y` stays within `band` of the step around `r`.

    Raises:
        ConfigError: If the band is no fraction of the step.
    """
    if not (is_number(band) and 0 < band < 1):
        raise ConfigError(
            f"settling_time: band={band!r}, expected a fraction of the step, such as 0.02; the "
            "limit in seconds is max="
        )
    return _of("settling_time", y, r, limits=limits, options={"band": band}, unit="s", timed=True,
               beyond=step_info.never_settled)  # fmt: skip


def rise_time(
    y: str = "y", r: str = "r", low: float = 0.1, high: float = 0.9, **limits: Any
) -> Spec:
    """Require the time [s] that `y` takes from `low` to `high` of the step.

    Raises:
        ConfigError: If these are no fractions of the step, the lower one first.
    """
    if not (is_number(low) and is_number(high) and 0 <= low < high <= 1):
        raise ConfigError(
            f"rise_time: low={low!r}, high={high!r}, expected fractions of the step, "
            "0 <= low < high <= 1, such as low=0.1, high=0.9"
        )
    options = {"low": low, "high": high}
    return _of("rise_time", y, r, limits=limits, options=options, unit="s", timed=True,
               beyond=step_info.never_rose)  # fmt: skip


def steady_state_error(y: str = "y", r: str = "r", last: float = 0.1, **limits: Any) -> Spec:
    """Require the mean absolute error over the last part `last` of the episode.

    Raises:
        ConfigError: If that is no part of the episode.
    """
    if not (is_number(last) and 0 < last <= 1):
        raise ConfigError(
            f"steady_state_error: last={last!r}, expected a part of the episode, above 0 and up to "
            "1, such as 0.1"
        )
    return _of("steady_state_error", y, r, limits=limits, options={"last": last})


def peak(y: str = "y", **limits: Any) -> Spec:
    """Require the largest magnitude of `y`."""
    return _of("peak", y, limits=limits)


def iae(y: str = "y", r: str = "r", **limits: Any) -> Spec:
    """Require the integral over time [s] of the absolute error."""
    return _of("iae", y, r, limits=limits, timed=True)


def ise(y: str = "y", r: str = "r", **limits: Any) -> Spec:
    """Require the integral over time [s] of the squared error."""
    return _of("ise", y, r, limits=limits, timed=True)


def itae(y: str = "y", r: str = "r", **limits: Any) -> Spec:
    """Require the integral over time [s] of time times the absolute error."""
    return _of("itae", y, r, limits=limits, timed=True)


def rms(y: str = "y", **limits: Any) -> Spec:
    """Require the root of the mean square of `y` over time."""
    return _of("rms", y, limits=limits)


def total_variation(u: str = "u", **limits: Any) -> Spec:
    """Require the sum of the absolute changes of `u` from sample to sample.

    The jump from rest to the first sample does not count; see `rate`.
    """
    return _of("total_variation", u, limits=limits)


def rate(u: str = "u", **limits: Any) -> Spec:
    """Require the largest change of `u` per second, from sample to sample.

    The jump from rest to the first sample does not count, although it is often the largest: what
    came before is not known. For the slew limit of an actuator that is at rest at 0, add
    `peak(u, max=..., window=(0, half a step))`, with the largest change of one step as its limit.
    """
    return _of("rate", u, limits=limits, unit="1/s", timed=True)


def _of_loop(name: str, loop: Loop | None, limits: Mapping[str, Any], unit: str = "") -> Spec:
    _refuse_unknown(name, limits, ("max", "min"))
    if is_number(loop):
        raise ConfigError(f"{name}({loop!r}): a limit has a name, such as min={loop!r}")
    return Spec(name, (), getattr(loops, name), loop=loop, unit=unit, **limits)


def gain_margin(loop: Loop | None = None, **limits: Any) -> Spec:
    """Require the factor by which the loop's gain may grow until it is unstable.

    Args:
        loop: Function of the parameters, {name: number}, that returns the open loop as a system
            of python-control. It costs no simulation.
        limits: `max`, `min` and other arguments of `Spec`, as in all requirements of a loop.
    """
    return _of_loop("gain_margin", loop, limits)


def phase_margin(loop: Loop | None = None, **limits: Any) -> Spec:
    """Require the phase [deg] that the loop may lose until it is unstable."""
    return _of_loop("phase_margin", loop, limits, "deg")


def disk_margin(loop: Loop | None = None, **limits: Any) -> Spec:
    """Require the symmetric disk margin; see `zoac.specs.loops.disk_margin`."""
    return _of_loop("disk_margin", loop, limits)


def max_sensitivity(loop: Loop | None = None, **limits: Any) -> Spec:
    """Require Ms, the largest magnitude of the sensitivity 1 / (1 + L)."""
    return _of_loop("max_sensitivity", loop, limits)


def bandwidth(loop: Loop | None = None, **limits: Any) -> Spec:
    """Require the closed loop's bandwidth [rad/s]."""
    return _of_loop("bandwidth", loop, limits, "rad/s")
