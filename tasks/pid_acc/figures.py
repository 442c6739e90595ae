"""What figures show of car following (Fig. 5)."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle

from zoac.core.measures import Trace
from zoac.core.segments import Segment
from zoac.tasks.pid_acc.plant import (
    MAX_CLEARANCE_ERROR,
    MAX_SPEED_ERROR,
    SAMPLE_TIME,
    U_HIGH,
    U_LOW,
)
from zoac.tasks.rendering import ALLOWED, CAR_LENGTH, EGO, INK, MUTED, OTHER, ROAD, WANTED, bare

SHOWN_GAP = 12.0
"""Where the preceding car is drawn when it is where it should be [m]: the gap itself depends on
speed, which is no part of the state, so only its error is to scale."""


def traces(segment: Segment) -> list[Trace]:
    """Return clearance and speed error, acceleration beside the preceding car's, and command."""
    dd, dv, af = segment.observations[:, :3].T
    u = segment.observations[1:, 9]
    time = SAMPLE_TIME * np.arange(segment.length + 1)
    # Eq. (11) backwards: dv' = w - a_f.
    preceding = np.diff(dv) / SAMPLE_TIME + af[:-1]
    label, gap, speed = "Time [s]", MAX_CLEARANCE_ERROR, MAX_SPEED_ERROR
    return [
        Trace("Clearance error [m]", time, dd, label, limits=(-gap, gap)),
        Trace("Speed error [m/s]", time, dv, label, limits=(-speed, speed)),
        Trace("Acceleration [m/s²]", time, af, label, reference=(time[:-1], preceding)),
        Trace("Command [m/s²]", time[:-1], u, label, limits=(U_LOW, U_HIGH)),
    ]


def draw(axes: Axes, observation: np.ndarray) -> None:
    """Draw an observation (10,) from the side: the ego car, the other where it is and should be."""
    dd, dv, af, u = observation[[0, 1, 2, 9]]
    bare(axes, (-8.0, 26.0), (-4.2, 5.6))
    axes.add_patch(Rectangle((-20, -1.1), 60, 1.1, color=ROAD, zorder=0))
    first, width = SHOWN_GAP - MAX_CLEARANCE_ERROR, 2 * MAX_CLEARANCE_ERROR
    axes.add_patch(Rectangle((first, -1.1), width, 1.1, color=ALLOWED, zorder=1))
    axes.plot([SHOWN_GAP] * 2, [-1.1, 3.4], color=WANTED, linewidth=1.2, dashes=(4, 2), zorder=2)
    axes.text(SHOWN_GAP, 3.6, "desired gap", color=WANTED, ha="center", va="bottom", fontsize=8)
    _car_from_the_side(axes, -CAR_LENGTH, EGO)
    _car_from_the_side(axes, SHOWN_GAP + dd, OTHER)
    gap = {"arrowstyle": "<->", "color": MUTED, "linewidth": 0.8}
    axes.annotate("", (SHOWN_GAP + dd, 0.9), (0.0, 0.9), arrowprops=gap)
    if abs(af) > 0.02:  # drawn to a length of 3 for 1 m/s^2, from the middle of the car
        middle, forward = -CAR_LENGTH / 2, {"arrowstyle": "-|>", "color": EGO, "linewidth": 1.6}
        axes.annotate("", (middle + 3 * af, 2.5), (middle, 2.5), arrowprops=forward)
    for x, name, value, unit in (
        (-7.4, "clearance error", dd, "m"),
        (1.1, "speed error", dv, "m/s"),
        (9.6, "acceleration", af, "m/s²"),
        (18.1, "command", u, "m/s²"),
    ):
        axes.text(x, -1.9, name, color=MUTED, va="top", fontsize=8)
        axes.text(x, -2.9, f"{value:+.2f} {unit}", color=INK, va="top", fontsize=10)


def _car_from_the_side(axes: Axes, rear: float, colour: str) -> None:
    body = FancyBboxPatch(
        (rear + 0.15, 0.35), CAR_LENGTH - 0.3, 0.65, boxstyle="round,pad=0.12", color=colour, lw=0
    )
    cabin = np.array([[0.8, 1.1], [1.3, 1.8], [2.9, 1.8], [3.7, 1.1]]) + np.array([rear, 0.0])
    axes.add_patch(body)
    axes.add_patch(Polygon(cabin, color=colour, lw=0))
    for wheel in (0.95, CAR_LENGTH - 0.95):
        axes.plot(rear + wheel, 0.3, "o", color=INK, markersize=6, zorder=5)
