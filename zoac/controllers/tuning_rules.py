"""Gains of a PID by rules of the trade: where tuning starts, and what it is compared with.

Ziegler and Nichols (1942) and Tyreus and Luyben (1992) need the gain and period at which a
proportional loop oscillates; Skogestad's SIMC (2003) needs a first-order plant with dead time,
which is read off the step response here.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from zoac.core.errors import ConfigError, suggest
from zoac.envs.linear_loop import refuse_not_finite

FILTER = 0.1
"""Tf over the derivative time."""


@dataclass(frozen=True)
class FirstOrder:
    """K exp(-theta s) / (tau s + 1), or for an integrating plant slope exp(-theta s) / s.

    Args:
        tau: Time constant [s]; infinite for an integrating plant.
        theta: Dead time [s].
        slope: K / tau [1/s].
    """

    tau: float
    theta: float
    slope: float


def gains(
    rule: str, plant: Any, structure: str = "PI", dead_time: float = 0.0, sample_time: float = 0.0
) -> dict[str, float]:
    """Return Kp, Ki, Kd and Tf by a rule.

    Args:
        rule: "ziegler_nichols", "tyreus_luyben" or "simc".
        plant: A continuous python-control system.
        structure: "P", "PI", "PD" or "PID".
        dead_time: Of the plant [s].
        sample_time: T_s [s], half of which counts as dead time.

    Raises:
        ConfigError: If the rule is unknown, or the plant is not one for the rule: its static gain
            is 0, it integrates twice, it has complex poles without damping, or a number of it is
            not finite.
    """
    _refuse_without_answer(plant)
    delay = dead_time + sample_time / 2
    if rule == "simc":
        k, ti, td = _simc(first_order(plant, delay), structure)
    elif rule in _ULTIMATE:
        ku, tu = ultimate(plant, delay)
        factors = _ULTIMATE[rule][structure]
        k, ti, td = factors[0] * ku, factors[1] * tu, factors[2] * tu
    else:
        raise ConfigError(f"unknown rule {rule!r}; {suggest(rule, (*_ULTIMATE, 'simc'))}")
    integral = "I" in structure and math.isfinite(ti)
    derivative = "D" in structure
    return {
        "Kp": k,
        "Ki": k / ti if integral else 0.0,
        "Kd": k * td if derivative else 0.0,
        "Tf": FILTER * td if derivative else 0.0,
    }


def _refuse_without_answer(plant: Any) -> None:
    """Refuse plants that no rule is made for: its formulas would give useless numbers.

    Raises:
        ConfigError: If `plant` is one.
    """
    refuse_not_finite(plant)
    poles, zeros = plant.poles(), plant.zeros()
    found = None
    if np.any((np.abs(poles.imag) > 1e-9) & (poles.real > -1e-9 * np.abs(poles))):
        found = "has complex poles without damping"
    elif np.sum(np.abs(poles) < 1e-9) > 1:
        found = "integrates twice"
    elif np.abs(zeros).min(initial=np.inf) < 1e-9 or plant(1j) == 0:
        found = "has a static gain of 0"
    if found:
        raise ConfigError(f"the plant {found}: no rule here has an answer for it. Give gains")


# Kp / Ku, Ti / Tu and Td / Tu.
_ULTIMATE: Mapping[str, Mapping[str, tuple[float, float, float]]] = {
    "ziegler_nichols": {
        "P": (0.5, math.inf, 0.0),
        "PI": (0.45, 1 / 1.2, 0.0),
        "PD": (0.8, math.inf, 1 / 8),
        "PID": (0.6, 1 / 2, 1 / 8),
    },
    "tyreus_luyben": {
        "P": (1 / 3.2, math.inf, 0.0),
        "PI": (1 / 3.2, 2.2, 0.0),
        "PD": (1 / 2.2, math.inf, 1 / 6.3),
        "PID": (1 / 2.2, 2.2, 1 / 6.3),
    },
}


def ultimate(plant: Any, delay: float) -> tuple[float, float]:
    """Return the ultimate gain and period [s]: where a proportional loop oscillates.

    Raises:
        ConfigError: If the phase never falls to -180 degrees.
    """
    corners = np.abs(np.concatenate([plant.poles(), plant.zeros()]))
    corners = np.append(corners[corners > 1e-9], 1.0 / delay if delay > 0 else 1.0)
    omega = np.logspace(np.log10(corners.min()) - 2, np.log10(corners.max()) + 3, 5000)
    direction = sign(plant)
    phase = np.unwrap(np.angle(direction * plant(1j * omega))) - omega * delay
    # The first frequency at which the phase passes -180 degrees on its way down.
    below = np.flatnonzero((phase[:-1] > -np.pi) & (phase[1:] <= -np.pi))
    if not len(below):
        raise ConfigError(
            "the plant's phase never falls to -180 degrees: it has no ultimate gain. Use "
            "baseline='simc', or give gains"
        )

    def past(w: float) -> float:
        return float(np.imag(plant(1j * w) * np.exp(-1j * w * delay)))

    low, high = omega[below[0]], omega[below[0] + 1]
    crossing = brentq(past, low, high) if past(low) * past(high) < 0 else high
    return direction / abs(complex(plant(1j * crossing))), 2 * math.pi / crossing


def sign(plant: Any) -> float:
    """Return 1.0, or -1.0 for a plant that needs negative gains.

    An unstable pole turns the sign of the static gain, as in 1 / (s - 1).
    """
    unstable = int(np.sum(plant.poles().real > 1e-9))
    at_rest = float(np.real(complex(plant(1e-9 + 0j)))) * (-1.0) ** unstable
    return 1.0 if at_rest >= 0 else -1.0


def first_order(plant: Any, delay: float) -> FirstOrder:
    """Return a first-order plant with dead time whose step response is like the plant's.

    A stable plant's by the times at which it has done 28.3% and 63.2% of its step (Smith), an
    integrating one's by the line that its response ends on.

    Raises:
        ConfigError: If the plant is unstable.
    """
    import control

    poles = plant.poles()
    if np.any(poles.real > 1e-9):
        raise ConfigError(
            "the plant is unstable: SIMC has no rule for it. Use baseline='ziegler_nichols', or "
            "give gains"
        )
    slow = np.abs(poles[np.abs(poles) > 1e-9].real)
    slow = slow[slow > 1e-9]
    # Many equal lags add up.
    horizon = (
        max(12.0 / slow.min(), 2.0 * (1.0 / slow).sum()) if len(slow) else 10.0 * max(delay, 1.0)
    )
    time = np.linspace(0.0, horizon, 4001)
    _, response = control.step_response(plant, time)
    response = np.asarray(response).reshape(-1)
    if np.any(np.abs(poles) <= 1e-9):
        slope = float((response[-1] - response[-400]) / (time[-1] - time[-400]))
        lag = float(time[-1] - response[-1] / slope)
        return FirstOrder(math.inf, delay + max(0.0, lag), slope)
    gain = float(np.real(plant(0j)))
    done = response / gain
    early, late = (float(time[np.flatnonzero(done >= level)[0]]) for level in (0.283, 0.632))
    tau = max(1.5 * (late - early), 1e-9)
    return FirstOrder(tau, delay + max(0.0, late - tau), gain / tau)


def _simc(plant: FirstOrder, structure: str) -> tuple[float, float, float]:
    """Return Kp, Ti and Td; the closed loop is to be as fast as the dead time allows."""
    fast = max(plant.theta, 0.05 * plant.tau if math.isfinite(plant.tau) else 0.0, 1e-9)
    k = 1.0 / (plant.slope * (fast + plant.theta))
    ti = min(plant.tau, 4 * (fast + plant.theta))
    return k, ti, plant.theta / 3 if "D" in structure else 0.0
