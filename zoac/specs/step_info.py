"""What a sampled response shows: overshoot, settling time and the like, one number each.

All functions take samples `y` (K,) at times `t` (K,) in seconds, and a reference `r`, a number or
samples (K,). The step is from `y[0]` to the last sample of `r`, up or down. A response with a
sample that is not finite has no value: the functions return infinity, which breaks every limit.
"""

import numpy as np

Samples = np.ndarray | float


def overshoot(t: np.ndarray, y: np.ndarray, r: Samples) -> float:
    """Return how far `y` goes beyond the reference, as a fraction of the step.

    0 without an overshoot. A step of height 0 has no fraction: 0 if `y` stays on the reference,
    else infinity.
    """
    if not _finite(y, r):
        return np.inf
    step = _last(r) - y[0]
    if step == 0:
        return np.inf if (y != y[0]).any() else 0.0
    return max(0.0, float(np.max((y - _last(r)) * np.sign(step)))) / abs(step)


def settling_time(t: np.ndarray, y: np.ndarray, r: Samples, band: float = 0.02) -> float:
    """Return the time [s] from which `y` stays within `band` of the step around the reference.

    Infinity if the last sample lies outside. The band of a step of height 0 is `band` itself, in
    the unit of `y`.
    """
    if not _finite(y, r):
        return np.inf
    step = _last(r) - y[0]
    # A sample that rounding puts just outside is inside.
    width = (1.0 + 1e-9) * band * (abs(step) or 1.0)
    outside = np.flatnonzero(np.abs(y - _last(r)) > width)
    if not len(outside):
        return 0.0
    after = outside[-1] + 1
    return float(t[after] - t[0]) if after < len(y) else np.inf


def rise_time(
    t: np.ndarray, y: np.ndarray, r: Samples, low: float = 0.1, high: float = 0.9
) -> float:
    """Return the time [s] that `y` takes from `low` to `high` of the step.

    Infinity if it never gets there; 0 for a step of height 0.
    """
    if not _finite(y, r):
        return np.inf
    step = _last(r) - y[0]
    if step == 0:
        return 0.0
    done = (y - y[0]) / step
    begun, reached = np.flatnonzero(done >= low), np.flatnonzero(done >= high)
    return float(t[reached[0]] - t[begun[0]]) if len(reached) else np.inf


def never_settled(t: np.ndarray, y: np.ndarray, r: Samples, band: float = 0.02) -> float:
    """Return by what factor a response that never settles counts as later than its last sample.

    It grows with the error over the last tenth of the time, in bands: of two responses that
    never settle, the one that is farther off counts as the later one.
    """
    width = band * (abs(_last(r) - y[0]) or 1.0)
    off = steady_state_error(t, y, _last(r)) / width if width else np.inf
    return 1.0 + off


def never_rose(
    t: np.ndarray, y: np.ndarray, r: Samples, low: float = 0.1, high: float = 0.9
) -> float:
    """Return by what factor a response that never rises counts as later than its last sample.

    It grows with what is missing of the step.
    """
    step = _last(r) - y[0]
    return 1.0 + high - float(np.max((y - y[0]) / step))


def steady_state_error(t: np.ndarray, y: np.ndarray, r: Samples, last: float = 0.1) -> float:
    """Return the mean absolute error over the last part `last` of the time."""
    if not _finite(y, r):
        return np.inf
    if _is_even(t):
        count = max(1, round(last * len(y)))
    else:
        count = int(np.sum(t >= t[-1] - last * (t[-1] - t[0])))
    return _mean(t[-count:], np.abs(_error(y, r)[-count:]))


def peak(t: np.ndarray, y: np.ndarray) -> float:
    """Return the largest magnitude of `y`."""
    return float(np.max(np.abs(y))) if _finite(y) else np.inf


def iae(t: np.ndarray, y: np.ndarray, r: Samples) -> float:
    """Return the integral of the absolute error."""
    return _integral(t, np.abs(_error(y, r)))


def ise(t: np.ndarray, y: np.ndarray, r: Samples) -> float:
    """Return the integral of the squared error."""
    return _integral(t, _error(y, r) ** 2)


def itae(t: np.ndarray, y: np.ndarray, r: Samples) -> float:
    """Return the integral of time times the absolute error."""
    return _integral(t, (t - t[0]) * np.abs(_error(y, r)))


def rms(t: np.ndarray, y: np.ndarray) -> float:
    """Return the root of the mean square of `y` over time."""
    return float(np.sqrt(_mean(t, np.square(y)))) if _finite(y) else np.inf


def total_variation(t: np.ndarray, y: np.ndarray) -> float:
    """Return the sum of the changes of `y` from sample to sample, each without its sign.

    The jump from rest to the first sample does not count: what came before it is not known.
    """
    return float(np.sum(np.abs(np.diff(y)))) if _finite(y) else np.inf


def rate(t: np.ndarray, y: np.ndarray) -> float:
    """Return the largest change of `y` per second, from sample to sample.

    The jump from rest to the first sample does not count: what came before it is not known.
    """
    if not _finite(y):
        return np.inf
    return float(np.max(np.abs(np.diff(y)) / np.diff(t), initial=0.0))


def _error(y: np.ndarray, r: Samples) -> np.ndarray:
    return np.asarray(r, dtype=np.float64) - y


def _last(r: Samples) -> float:
    return float(np.asarray(r, dtype=np.float64).reshape(-1)[-1])


def _integral(t: np.ndarray, values: np.ndarray) -> float:
    """Return the integral by the trapezoidal rule; infinity where a value is not finite."""
    return float(np.trapezoid(values, t)) if np.isfinite(values).all() else np.inf


def _mean(t: np.ndarray, values: np.ndarray) -> float:
    """Return the mean over time; each sample stands for half the way to its neighbours."""
    return float(np.mean(values) if _is_even(t) else np.average(values, weights=np.gradient(t)))


def _is_even(t: np.ndarray) -> bool:
    """Tell whether samples are evenly spaced, but for the rounding of a written clock."""
    steps = np.diff(t)
    return len(steps) < 2 or bool(np.ptp(steps) <= 0.01 * steps.mean())


def _finite(*samples: Samples) -> bool:
    return all(np.isfinite(s).all() for s in samples)
