"""Pictures of the built-in environments: pure functions of what is plotted.

`draw_*` draw into axes; `frame` turns that into the array that `render_mode="rgb_array"` returns.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Polygon, Rectangle

DPI = 100
EGO, OTHER, INK, MUTED = "#0072B2", "#5f6b76", "#222222", "#8a8a8a"
ROAD, ALLOWED, WANTED = "#eef0f2", "#dfe9f1", "#D55E00"

CAR_LENGTH, CAR_WIDTH = 4.5, 1.8  # [m]
SHOWN_GAP = 12.0
"""Where the preceding car is drawn when it is where it should be [m]: the gap itself depends on
speed, which is no part of the state, so only its error is to scale."""


def frame(draw: Callable[[Axes], None], size: tuple[float, float] = (6.4, 2.4)) -> np.ndarray:
    """Return a picture, (height, width, 3) uint8.

    Args:
        draw: Draws into the axes it is given, which fill the picture.
        size: Width and height [in], at 100 dots per inch.
    """
    figure = Figure(figsize=size, dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    draw(figure.add_axes((0.0, 0.0, 1.0, 1.0)))
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def draw_following(
    axes: Axes,
    clearance_error: float,
    speed_error: float,
    acceleration: float,
    command: float,
    allowed: float = 5.0,
) -> None:
    """Draw car following from the side: the ego car, and the other where it is and should be.

    Args:
        axes: Where to draw.
        clearance_error: dd [m].
        speed_error: dv [m/s], positive when the preceding car is faster.
        acceleration: a_f of the ego car [m/s^2].
        command: Desired acceleration u [m/s^2].
        allowed: Largest clearance error before the episode ends [m].
    """
    _bare(axes, (-8.0, 26.0), (-4.2, 5.6))
    axes.add_patch(Rectangle((-20, -1.1), 60, 1.1, color=ROAD, zorder=0))
    band = Rectangle((SHOWN_GAP - allowed, -1.1), 2 * allowed, 1.1, color=ALLOWED, zorder=1)
    axes.add_patch(band)
    axes.plot([SHOWN_GAP] * 2, [-1.1, 3.4], color=WANTED, linewidth=1.2, dashes=(4, 2), zorder=2)
    axes.text(SHOWN_GAP, 3.6, "desired gap", color=WANTED, ha="center", va="bottom", fontsize=8)
    _car_from_the_side(axes, -CAR_LENGTH, EGO)
    _car_from_the_side(axes, SHOWN_GAP + clearance_error, OTHER)
    axes.annotate(
        "",
        xy=(SHOWN_GAP + clearance_error, 0.9),
        xytext=(0.0, 0.9),
        arrowprops={"arrowstyle": "<->", "color": MUTED, "linewidth": 0.8},
    )
    # Drawn to a length of 3 for 1 m/s^2, from the middle of the car.
    if abs(acceleration) > 0.02:
        axes.annotate(
            "",
            xy=(-CAR_LENGTH / 2 + 3 * acceleration, 2.5),
            xytext=(-CAR_LENGTH / 2, 2.5),
            arrowprops={"arrowstyle": "-|>", "color": EGO, "linewidth": 1.6},
        )
    for x, name, value, unit in (
        (-7.4, "clearance error", clearance_error, "m"),
        (1.1, "speed error", speed_error, "m/s"),
        (9.6, "acceleration", acceleration, "m/s²"),
        (18.1, "command", command, "m/s²"),
    ):
        axes.text(x, -1.9, name, color=MUTED, va="top", fontsize=8)
        axes.text(x, -2.9, f"{value:+.2f} {unit}", color=INK, va="top", fontsize=10)


def draw_tracking(
    axes: Axes,
    state: np.ndarray,
    steering: float,
    path: np.ndarray,
    trail: np.ndarray,
    allowed: float = 4.0,
) -> None:
    """Draw a vehicle on its path from above, the vehicle in the middle.

    Args:
        axes: Where to draw.
        state: x, y [m], phi [rad], u, v [m/s], omega [rad/s].
        steering: Front wheel angle delta [rad].
        path: Reference path, points (K, 2) [m], in order of x.
        trail: Where the vehicle was, (T, 2) [m].
        allowed: Largest lateral error before the episode ends [m].
    """
    x, y, phi, speed = (float(value) for value in state[:4])
    _bare(axes, (x - 14.0, x + 42.0), (y - 10.5, y + 10.5))
    axes.set_facecolor("white")
    axes.fill_between(path[:, 0], path[:, 1] - allowed, path[:, 1] + allowed, color=ROAD, lw=0)
    axes.plot(path[:, 0], path[:, 1], color=WANTED, linewidth=1.2, dashes=(5, 3))
    axes.plot(trail[:, 0], trail[:, 1], color=EGO, linewidth=1.6)
    _car_from_above(axes, x, y, phi, steering)
    # Over the rim too, where clipping would leave a faint edge.
    strip = Rectangle((-0.01, -0.02), 1.02, 0.28, transform=axes.transAxes, color="white", lw=0)
    strip.set(zorder=7, clip_on=False)
    axes.add_patch(strip)
    off = y - float(np.interp(x, path[:, 0], path[:, 1]))
    for place, name, value, unit in (
        (0.02, "lateral error", f"{off:+.2f}", "m"),
        (0.30, "speed", f"{speed:.1f}", "m/s"),
        (0.52, "steering", f"{math.degrees(steering):+.1f}", "°"),
    ):
        where: dict[str, Any] = {"transform": axes.transAxes, "va": "bottom", "zorder": 8}
        axes.text(place, 0.12, name, color=MUTED, fontsize=8, **where)
        axes.text(place, 0.03, f"{value} {unit}", color=INK, fontsize=10, **where)


def _bare(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    axes.set_axis_off()
    axes.set_xlim(*x)
    axes.set_ylim(*y)
    axes.set_aspect("equal", adjustable="box")


def _car_from_the_side(axes: Axes, rear: float, colour: str) -> None:
    body = FancyBboxPatch(
        (rear + 0.15, 0.35), CAR_LENGTH - 0.3, 0.65, boxstyle="round,pad=0.12", color=colour, lw=0
    )
    cabin = np.array([[0.8, 1.1], [1.3, 1.8], [2.9, 1.8], [3.7, 1.1]]) + np.array([rear, 0.0])
    axes.add_patch(body)
    axes.add_patch(Polygon(cabin, color=colour, lw=0))
    for wheel in (0.95, CAR_LENGTH - 0.95):
        axes.plot(rear + wheel, 0.3, "o", color=INK, markersize=6, zorder=5)


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
