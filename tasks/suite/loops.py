"""Plants of the PID literature, drawn from a seed: seven classes in turn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError

CLASSES = (
    "one lag", "two lags", "integrating", "many lags", "inverse response", "lightly damped",
    "unstable",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Plant:
    """One plant of the suite.

    Args:
        kind: One of `CLASSES`.
        system: Continuous, without its dead time.
        dead_time: A multiple of a quarter of the sample time [s].
        sample_time: [s].
        noise: Standard deviation of the measurement; the reference's step is 1.
        scale: Sum of time constants and dead time [s].
    """

    index: int
    kind: str
    system: Any = field(repr=False)
    dead_time: float
    sample_time: float
    structure: str
    input_limits: tuple[float, float]
    noise: float
    scale: float


def draw(index: int, seed: int = 0) -> Plant:
    """Return one plant of the suite.

    Raises:
        ConfigError: If python-control is not installed.
    """
    try:
        import control
    except ImportError:
        raise ConfigError(
            "the suite's loops need python-control: pip install 'zoac[suite]'"
        ) from None
    rng = np.random.default_rng([seed, index])
    kind = CLASSES[index % len(CLASSES)]
    unit = 10.0 ** rng.uniform(-1.0, 1.5)  # [s]
    gain = rng.choice([1.0, 1.0, 1.0, -1.0]) * 10.0 ** rng.uniform(-0.5, 0.7)
    s = control.tf([unit, 0], [1])
    dead = 10.0 ** rng.uniform(-1.0, 0.3)
    lags, extra = 1.0, 0.0
    if kind == "one lag":
        shape = 1 / (s + 1)
    elif kind == "two lags":
        second = rng.uniform(0.2, 1.0)
        shape, lags = 1 / ((s + 1) * (second * s + 1)), 1.0 + second
    elif kind == "integrating":
        second = rng.choice([0.0, rng.uniform(0.1, 0.6)])
        shape, lags = 1 / (s * (second * s + 1)), second
        dead = rng.uniform(0.3, 1.0)
    elif kind == "many lags":
        order = int(rng.integers(3, 9))
        shape, lags, dead = 1 / (s + 1) ** order, float(order), rng.uniform(0.0, 0.5)
    elif kind == "inverse response":
        extra = rng.uniform(0.3, 1.5)
        shape, lags, dead = (1 - extra * s) / (s + 1) ** 3, 3.0, rng.uniform(0.0, 0.5)
    elif kind == "lightly damped":
        zeta = rng.uniform(0.1, 0.4)
        shape = 1 / ((s * s + 2 * zeta * s + 1) * (s + 1))
        lags, dead = 3.0, rng.uniform(0.1, 0.5)
    else:
        dead = rng.uniform(0.05, 0.2)
        shape = 1 / (s - 1)
    scale = (lags + dead + extra) * unit
    sample_time = (dead + extra + 0.2 * lags) * unit / rng.uniform(6.0, 12.0)
    quarter = sample_time / 4
    structure = str(rng.choice(["PI", "PID"])) if kind != "unstable" else "PID"
    # The input that the step needs at rest, or of an integrating plant to be done in `scale`.
    need = 1.0 / abs(gain) / (1.0 if kind != "integrating" else scale / unit)
    most = need * rng.uniform(2.0, 5.0) * (2.0 if kind == "unstable" else 1.0)
    other = most * rng.uniform(0.5, 1.0)
    return Plant(
        index,
        kind,
        gain * shape,
        round(dead * unit / quarter) * quarter,
        sample_time,
        structure,
        (-other, most) if gain > 0 else (-most, other),
        rng.uniform(0.001, 0.01),
        scale,
    )
