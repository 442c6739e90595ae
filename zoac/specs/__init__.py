"""Requirements in the terms of the trade: overshoot, settling time, margins, ..."""

from zoac.specs.requirements import (
    bandwidth,
    disk_margin,
    gain_margin,
    iae,
    ise,
    itae,
    max_sensitivity,
    overshoot,
    peak,
    phase_margin,
    rate,
    rise_time,
    rms,
    settling_time,
    steady_state_error,
    total_variation,
)
from zoac.specs.spec import Spec, cvar

__all__ = [
    "Spec", "bandwidth", "cvar", "disk_margin", "gain_margin", "iae", "ise", "itae",
    "max_sensitivity", "overshoot", "peak", "phase_margin", "rate", "rise_time", "rms",
    "settling_time", "steady_state_error", "total_variation",
]  # fmt: skip
