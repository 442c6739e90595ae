"""How figures look: sizes of a two-column paper, readable in grey, the same bytes every time."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from io import BytesIO
from typing import Any, NamedTuple

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zoac.analysis import cli
from zoac.analysis.data.runs import Method
from zoac.analysis.figures.labels import REGULARISED

COLUMN, PAGE = 3.5, 7.16
"""Widths of one and of two columns [in]."""

# Colours of Okabe and Ito: told apart by people who see few colours. Lines and markers differ as
# well, for those who see none.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LINES: tuple[Any, ...] = (
    "-", (0, (4, 1.5)), (0, (6, 1.5, 1, 1.5)), (0, (1, 1.2)), (0, (3, 1.2, 1, 1.2, 1, 1.2)),
)  # fmt: skip
MARKERS = ("o", "^", "D", "v", "P", "X")
INK, GREY = "#222222", "#8a8a8a"

_SHARED: dict[str, Any] = {
    "svg.hashsalt": "zoac",
    "pdf.fonttype": 42,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.2,
    "legend.frameon": False,
}
_PAPER = {
    **_SHARED,
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
}
_SCREEN = {
    **_SHARED,
    # Text stays text: small files, and the reader's own fonts.
    "svg.fonttype": "none",
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.labelsize": 8.5,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
}
# Nothing in a file says when, or by which version, it was made.
_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}


class Look(NamedTuple):
    """Colour, dashes and marker of one line."""

    colour: str
    dashes: Any
    marker: str

    @property
    def line(self) -> dict[str, Any]:
        """Keyword arguments for `Axes.plot`."""
        return {
            "color": self.colour,
            "linestyle": self.dashes,
            "marker": self.marker,
            "markerfacecolor": "white",
            "markeredgewidth": 0.8,
        }


def paper() -> AbstractContextManager[None]:
    """Draw and save figures for print, whatever the user's own matplotlib settings."""
    return mpl.rc_context(_complete(_PAPER))


def screen() -> AbstractContextManager[None]:
    """Draw and save figures for the report, likewise."""
    return mpl.rc_context(_complete(_SCREEN))


def _complete(settings: Any) -> Any:
    return {**mpl.rcParamsDefault, "backend": "agg", **settings}


def looks(methods: Sequence[Method]) -> dict[Method, Look]:
    """Return a look for each method; the same tuner looks the same in every figure of a set.

    Variants of a tuner have its colour and marker, and lines of their own.
    """
    known = ["zoac", "bo", "cmaes"]
    tuners = known + sorted({m.tuner for m in methods} - {*known, "nominal"})
    chosen = {}
    for method in methods:
        if method.tuner == "nominal":
            chosen[method] = Look(INK, (0, (1, 1.5)), "")
            continue
        slot = tuners.index(method.tuner)
        if method.task.endswith(REGULARISED) and method.tuner == "zoac":
            chosen[method] = Look(COLOURS[5], LINES[4], "s")
        else:
            chosen[method] = look(slot)
        twins = sorted({m.variant or "" for m in methods if m.tuner == method.tuner})
        if place := twins.index(method.variant or ""):
            chosen[method] = chosen[method]._replace(dashes=LINES[(slot + 2 + place) % len(LINES)])
    return chosen


def look(slot: int) -> Look:
    """Return the look of the `slot`-th line of a figure."""
    return Look(
        COLOURS[slot % len(COLOURS)], LINES[slot % len(LINES)], MARKERS[slot % len(MARKERS)]
    )


def image(figure: Figure, kind: str, salt: str = "zoac") -> bytes:
    """Return `figure` as the bytes of a file of `kind` ("svg", "pdf" or "png").

    Args:
        figure: The figure.
        kind: File format.
        salt: Part of the ids in an SVG; must differ between the pictures of one page.
    """
    buffer = BytesIO()
    with mpl.rc_context({"svg.hashsalt": salt}):
        figure.savefig(buffer, format=kind, dpi=300, metadata=_METADATA[kind])
    return buffer.getvalue()


def save(draw: Callable[[], Figure], options: argparse.Namespace, name: str) -> None:
    """Draw a figure for print; write it into `options.out` in each format of `options.format`."""
    with paper():
        figure = draw()
        for kind in options.format:
            cli.write(options.out / f"{name}.{kind}", image(figure, kind))


def legend_above(figure: Figure, entries: Mapping[str, Artist], columns: int = 6) -> None:
    """Put one legend, label -> line, for the whole figure above its panels."""
    if len(entries) < 2:
        return
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="outside upper center",
        ncols=min(columns, len(entries)),
        handlelength=2.6,
        columnspacing=1.4,
    )


def big_axis(axes: Axes, label: str) -> None:
    """Label the x axis; large numbers are shown in powers of ten, which the label names."""
    largest = max(abs(limit) for limit in axes.get_xlim())
    exponent = math.floor(math.log10(largest)) if largest > 0 else 0
    if exponent < 4:
        axes.set_xlabel(label)
        return
    axes.xaxis.set_major_formatter(lambda value, _: f"{value / 10.0**exponent:g}")
    factor = f"$10^{exponent}$"
    unit = f"[{factor} s]" if label.endswith("[s]") else f"[{factor}]"
    axes.set_xlabel(f"{label.removesuffix('[s]').rstrip()} {unit}")
