"""What figures show of trajectory tracking (Fig. 6)."""

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle

from zoac.core.measures import Trace
from zoac.core.segments import Segment
from zoac.tasks.mpc_tracking import path
from zoac.tasks.mpc_tracking.plant import MAX_HEADING_ERROR, MAX_LATERAL_ERROR, MAX_SPEED_ERROR
from zoac.tasks.mpc_tracking.vehicle import INPUT_HIGH, INPUT_LOW
from zoac.tasks.rendering import CAR_LENGTH, CAR_WIDTH, EGO, INK, MUTED, ROAD, WANTED, bare

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


def draw(axes: Axes, states: np.ndarray, steering: float) -> None:
    """Draw the vehicle from above, at the last of its states on the path.

    Args:
        axes: Where to draw.
        states: (T, 6); those before are its trail.
        steering: Front wheel angle delta [rad].
    """
    x, y, phi, speed = (float(value) for value in states[-1, :4])
    reference = _reference(x - SHOWN_BEHIND, x + SHOWN_AHEAD)
    bare(axes, (x - 14.0, x + 42.0), (y - 10.5, y + 10.5))
    axes.set_facecolor("white")
    low, high = reference[1] - MAX_LATERAL_ERROR, reference[1] + MAX_LATERAL_ERROR
    axes.fill_between(reference[0], low, high, color=ROAD, lw=0)
    axes.plot(*reference, color=WANTED, linewidth=1.2, dashes=(5, 3))
    axes.plot(states[:, 0], states[:, 1], color=EGO, linewidth=1.6)
    _car_from_above(axes, x, y, phi, steering)
    # Over the rim too, where clipping would leave a faint edge.
    strip = Rectangle((-0.01, -0.02), 1.02, 0.28, transform=axes.transAxes, color="white", lw=0)
    strip.set(zorder=7, clip_on=False)
    axes.add_patch(strip)
    off = y - path.lateral(x)
    for place, name, value, unit in (
        (0.02, "lateral error", f"{off:+.2f}", "m"),
        (0.30, "speed", f"{speed:.1f}", "m/s"),
        (0.52, "steering", f"{math.degrees(steering):+.1f}", "°"),
    ):
        where: dict[str, Any] = {"transform": axes.transAxes, "va": "bottom", "zorder": 8}
        axes.text(place, 0.12, name, color=MUTED, fontsize=8, **where)
        axes.text(place, 0.03, f"{value} {unit}", color=INK, fontsize=10, **where)


def _car_from_above(axes: Axes, x: float, y: float, phi: float, steering: float) -> None:
    front, rear, half = CAR_LENGTH * 0.45, -CAR_LENGTH * 0.55, CAR_WIDTH / 2
    outline = [[front, half], [front, -half], [rear, -half], [rear, half]]
    axes.add_patch(Polygon(_placed(outline, x, y, phi), facecolor=EGO, edgecolor="none", zorder=4))
    window = [[0.9, half * 0.8], [0.9, -half * 0.8], [0.1, -half * 0.8], [0.1, half * 0.8]]
    axes.add_patch(Polygon(_placed(window, x, y, phi), facecolor="white", alpha=0.7, zorder=5))
    for along, angle in ((1.06, steering), (-1.85, 0.0)):
        for side in (-half, half):
            wheel = _placed([[-0.4, 0.0], [0.4, 0.0]], along, side, angle)
            ends = _placed(wheel, x, y, phi)
            axes.plot(ends[:, 0], ends[:, 1], color=INK, linewidth=2.6, zorder=6)


def _placed(points: list[list[float]] | np.ndarray, x: float, y: float, phi: float) -> np.ndarray:
    """Return points (K, 2) of a body turned by `phi` [rad] and moved to (x, y) [m]."""
    c, s = math.cos(phi), math.sin(phi)
    return np.asarray(points) @ np.array([[c, s], [-s, c]]) + np.array([x, y])


def _reference(first: float, last: float) -> tuple[np.ndarray, np.ndarray]:
    x = np.linspace(first, last, 200)
    return x, np.array([path.lateral(at) for at in x])


def _both(limit: float) -> tuple[float, float]:
    return -limit, limit
