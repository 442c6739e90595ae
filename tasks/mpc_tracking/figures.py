"""What figures show of trajectory tracking (Fig. 6)."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes

from zoac.core.measures import Trace
from zoac.core.segments import Segment
from zoac.tasks.mpc_tracking import path
from zoac.tasks.mpc_tracking.plant import (
    MAX_HEADING_ERROR,
    MAX_LATERAL_ERROR,
    MAX_SPEED_ERROR,
)
from zoac.tasks.mpc_tracking.vehicle import INPUT_HIGH, INPUT_LOW
from zoac.tasks.rendering import draw_tracking

SHOWN_AHEAD, SHOWN_BEHIND = 60.0, 30.0  # [m]


def traces(segment: Segment) -> list[Trace]:
    """Return the path, the three errors that end an episode, and the two inputs."""
    x, y, phi, u = segment.observations[:, :4].T
    delta, a = segment.actions.T
    time = path.STEP * np.arange(segment.length + 1)
    lateral = y - [path.lateral(at) for at in x]
    heading = np.degrees(phi - [path.heading(at) for at in x])
    turn, label = math.degrees(MAX_HEADING_ERROR), "Time [s]"
    steering = tuple(np.degrees([INPUT_LOW[0], INPUT_HIGH[0]]).tolist())
    return [
        Trace("Path y [m]", x, y, "Path x [m]", reference=_reference(x.min(), x.max())),
        Trace("Lateral error [m]", time, lateral, label, limits=_both(MAX_LATERAL_ERROR)),
        Trace("Heading error [°]", time, heading, label, limits=_both(turn)),
        Trace("Speed error [m/s]", time, u - path.SPEED, label, limits=_both(MAX_SPEED_ERROR)),
        Trace("Steering angle [°]", time[:-1], np.degrees(delta), label, limits=steering),
        Trace("Acceleration [m/s²]", time[:-1], a, label, limits=(INPUT_LOW[1], INPUT_HIGH[1])),
    ]


def draw(axes: Axes, segment: Segment, step: int) -> None:
    """Draw the vehicle on its path after `step` steps."""
    steering = float(segment.actions[max(step - 1, 0), 0])
    draw_states(axes, segment.observations[: step + 1, :6], steering)


def draw_states(axes: Axes, states: np.ndarray, steering: float) -> None:
    """Draw the vehicle at the last of `states` (T, 6), with the trail of those before."""
    x = float(states[-1, 0])
    points = np.stack(_reference(x - SHOWN_BEHIND, x + SHOWN_AHEAD), axis=1)
    draw_tracking(axes, states[-1], steering, points, states[:, :2], MAX_LATERAL_ERROR)


def _reference(first: float, last: float) -> tuple[np.ndarray, np.ndarray]:
    x = np.linspace(first, last, 200)
    return x, np.array([path.lateral(at) for at in x])


def _both(limit: float) -> tuple[float, float]:
    return -limit, limit
