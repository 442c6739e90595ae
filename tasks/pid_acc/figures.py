"""What figures show of car following (Fig. 5)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from zoac.core.measures import Trace
from zoac.core.segments import Segment
from zoac.tasks.pid_acc.plant import (
    MAX_CLEARANCE_ERROR,
    MAX_SPEED_ERROR,
    SAMPLE_TIME,
    U_HIGH,
    U_LOW,
)
from zoac.tasks.rendering import draw_following


def traces(segment: Segment) -> list[Trace]:
    """Return clearance and speed error, acceleration beside the preceding car's, and command."""
    dd, dv, af = segment.observations[:, :3].T
    u = segment.observations[1:, 9]
    time = SAMPLE_TIME * np.arange(segment.length + 1)
    # Eq. (11) backwards: dv' = w - a_f.
    preceding = np.diff(dv) / SAMPLE_TIME + af[:-1]
    label = "Time [s]"
    return [
        Trace("Clearance error [m]", time, dd, label, limits=_both(MAX_CLEARANCE_ERROR)),
        Trace("Speed error [m/s]", time, dv, label, limits=_both(MAX_SPEED_ERROR)),
        Trace("Acceleration [m/s²]", time, af, label, reference=(time[:-1], preceding)),
        Trace("Command [m/s²]", time[:-1], u, label, limits=(U_LOW, U_HIGH)),
    ]


def draw(axes: Axes, segment: Segment, step: int) -> None:
    """Draw the two cars after `step` steps."""
    observation = segment.observations[step]
    dd, dv, af = (float(value) for value in observation[:3])
    draw_following(axes, dd, dv, af, float(observation[9]), MAX_CLEARANCE_ERROR)


def _both(limit: float) -> tuple[float, float]:
    return -limit, limit
