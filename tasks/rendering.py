"""What pictures of the built-in environments have in common."""

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

SIZE, DPI = (6.4, 2.4), 100  # [in]
EGO, OTHER, INK, MUTED = "#0072B2", "#5f6b76", "#222222", "#8a8a8a"
ROAD, ALLOWED, WANTED = "#eef0f2", "#dfe9f1", "#D55E00"
CAR_LENGTH, CAR_WIDTH = 4.5, 1.8  # [m]


def frame(draw: Callable[[Axes], None]) -> np.ndarray:
    """Return a picture, (height, width, 3) uint8; `draw` draws into axes that fill it."""
    figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    draw(figure.add_axes((0.0, 0.0, 1.0, 1.0)))
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def bare(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Show a part of the plane, to scale and without axes."""
    axes.set_axis_off()
    axes.set_xlim(*x)
    axes.set_ylim(*y)
    axes.set_aspect("equal", adjustable="box")
