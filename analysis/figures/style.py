"""How figures look: sizes of a two-column paper, readable in grey, the same bytes every time."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from io import BytesIO
from typing import TYPE_CHECKING, Any, NamedTuple
from zlib import crc32

from zoac.analysis.data import cli
from zoac.analysis.data.runs import Method
from zoac.analysis.figures.labels import stands_apart
from zoac.runs import responses

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMN, PAGE = 3.5, 7.16
"""Widths of one and of two columns [in]."""

INK, GREY, LIGHT, BAD = "#222222", "#8a8a8a", "#e4e4e4", "#b3261e"


class Look(NamedTuple):
    """Colour, dashes and marker of one line."""

    colour: str
    dashes: Any
    marker: str
    filled: bool = False

    @property
    def line(self) -> dict[str, Any]:
        """Keyword arguments for `Axes.plot`."""
        return {
            "color": self.colour,
            "linestyle": self.dashes,
            "marker": self.marker,
            "markerfacecolor": self.colour if self.filled else "white",
            "markeredgewidth": 0.8,
        }


def _dashes(*lengths: float) -> tuple[int, tuple[float, ...]]:
    return 0, lengths


# Colours of Okabe and Ito, then of Tol: told apart by people who see few colours. Dashes and
# markers differ as well, for those who see none and for print in grey.
NOMINAL = Look(INK, _dashes(1, 1.5), "x")
LOOKS = {
    "zoac": Look("#0072B2", "-", "o"),
    "zoac_reg": Look("#56B4E9", _dashes(5, 1, 1, 1, 1, 1), "s"),
    "zoac_plus": Look("#CC79A7", _dashes(8, 1.5), "v"),
    "bo": Look("#D55E00", _dashes(4, 1.5), "^"),
    "cmaes": Look("#009E73", _dashes(6, 1.5, 1, 1.5), "D"),
    "cmaes_full": Look("#E69F00", _dashes(1, 0.7), "P"),
    "cmaes_plus": Look("#117733", _dashes(6, 1, 2, 1), "h"),
    "es": Look("#332288", _dashes(2, 2), "X"),
    "random": Look("#999933", _dashes(3, 3, 1, 3), "<"),
    "nevergrad": Look("#882255", _dashes(2, 1), ">"),
    "optuna": Look("#7F4F24", _dashes(3, 1, 3, 1, 1, 1), "p"),
    "botorch": Look("#44AA99", _dashes(8, 2, 1, 2, 1, 2), "+"),
    "smac": Look("#CC6677", _dashes(4, 1, 4, 3), "1"),
    "halving": Look("#6A3D9A", _dashes(5, 2, 2, 2), "8"),
    "nominal": NOMINAL,
}
"""The look of each tuner, the same in every figure; `_reg`: with the regularised cost."""

BEFORE, AFTER = (Look(c, dashes, "") for c, dashes in (responses.BEFORE, responses.AFTER))
"""One controller before and after tuning, in figures that compare no tuners."""

_SPARE = (
    ("#117733", "#AA4499", "#661100"),
    ("h", "*", "d", "H"),
    (_dashes(9, 2, 2, 2), _dashes(3, 0.8), _dashes(1, 3), _dashes(7, 3), _dashes(4, 1, 1, 3)),
)
"""Colours, markers and dashes of tuners without a look of their own."""

_OF_VARIANTS = (
    _dashes(12, 1.5), _dashes(10, 1.5, 1, 1.5, 1, 1.5), _dashes(2, 1, 6, 1), _dashes(10, 4),
    _dashes(1, 1, 4, 2), _dashes(6, 1, 6, 3), _dashes(1, 2, 3, 2),
)  # fmt: skip
"""Dashes of variants of a tuner, which have its colour and its marker, filled."""

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
    "grid.color": LIGHT,
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.2,
    "legend.frameon": False,
}
PAPER = {
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
"""Settings of matplotlib for figures in print."""

SCREEN = {
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
"""Settings of matplotlib for figures on a page."""

# Nothing in a file says when, or by which version, it was made.
_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}


def drawing(settings: Any) -> AbstractContextManager[None]:
    """Draw and save figures with `PAPER` or `SCREEN`, whatever the user's matplotlib settings."""
    import matplotlib as mpl

    return mpl.rc_context({**mpl.rcParamsDefault, "backend": "agg", **settings})


def looks(methods: Iterable[Method]) -> dict[Method, Look]:
    """Return a look for each method, all different; a tuner has the same one in every figure.

    Variants that stand beside others have dashes of their own, as their labels have a name.
    """
    methods = sorted(set(methods), key=lambda m: (m.tuner, m.task, m.variant or ""))
    of_key = LOOKS | _spare({method.row for method in methods} - LOOKS.keys())
    dashes = _probed(sorted({m.variant for m in methods if m.variant}), len(_OF_VARIANTS))
    chosen = {}
    for method in methods:
        chosen[method] = look = of_key[method.row]
        if method.variant and stands_apart(method, methods):
            own = _OF_VARIANTS[dashes[method.variant] % len(_OF_VARIANTS)]
            chosen[method] = look._replace(dashes=own, filled=True)
    return chosen


def _spare(names: Iterable[str]) -> dict[str, Look]:
    """Return a look for each tuner without one, which depends on its name alone where it can."""
    colours, markers, dashes = _SPARE
    count = len(colours) * len(markers) * len(dashes)  # without a common factor: all pairs differ
    return {
        name: Look(
            colours[k % len(colours)], dashes[k % len(dashes)], markers[k % len(markers)], True
        )
        for name, k in _probed(sorted(names), count).items()
    }


def _probed(names: Sequence[str], count: int) -> dict[str, int]:
    """Return a number below `count` for each name, from the name; the next free one if taken."""
    found: dict[str, int] = {}
    for name in names:
        k = crc32(name.encode()) % count
        while k in found.values() and len(found) < count:
            k = (k + 1) % count
        found[name] = k
    return found


def blank(width: float, height: float) -> Figure:
    """Return an empty figure of this size [in]."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def panels(
    count: int, columns: int, height: float, more: float, **options: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure with `count` panels, `columns` in a row, one or two columns of text wide.

    Its height is that of the rows, `height` each, and `more` [in].
    """
    rows = -(-count // columns)
    figure = blank(PAGE if columns > 1 else COLUMN, height * rows + more)
    grid = figure.subplots(rows, columns, squeeze=False, **options).ravel().tolist()
    for spare in grid[count:]:
        spare.remove()
    return figure, grid[:count]


def band(axes: Axes, x: Any, low: Any, high: Any, look: Look) -> None:
    """Shade the range around a line; its edges have the line's dashes, to be told in grey."""
    for edge in (low, high):
        axes.plot(x, edge, color=look.colour, linestyle=look.dashes, linewidth=0.5, alpha=0.6)
    axes.fill_between(x, low, high, color=look.colour, alpha=0.13, lw=0)


def image(figure: Figure, kind: str, salt: str = "zoac") -> bytes:
    """Return `figure` as the bytes of a file of `kind` ("svg", "pdf" or "png").

    The salt is part of the ids in an SVG; it must differ between the pictures of one page.
    """
    import matplotlib as mpl

    buffer = BytesIO()
    with mpl.rc_context({"svg.hashsalt": salt}):
        figure.savefig(buffer, format=kind, dpi=300, metadata=_METADATA[kind])
    return buffer.getvalue()


def save(draw: Callable[[], Figure], options: argparse.Namespace, name: str) -> None:
    """Draw a figure for print; write it into `options.out` in each format of `options.format`."""
    with drawing(PAPER):
        figure = draw()
        for kind in options.format:
            cli.write(options.out / f"{name}.{kind}", image(figure, kind))


def entries(figure: Figure) -> dict[str, Artist]:
    """Return what a legend of all panels shows, label -> line."""
    found: dict[str, Artist] = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        found |= zip(labels, handles, strict=True)
    return found


def legend_above(figure: Figure, entries: Mapping[str, Artist], columns: int = 6) -> None:
    """Put one legend, label -> line, for the whole figure above its panels.

    It has as few rows as fit the figure's width, of `columns` entries at most, and about as many
    entries in each; the figure grows by its height.
    """
    if len(entries) < 2:
        return
    width = figure.get_figwidth() * figure.dpi
    for rows in range(-(-len(entries) // columns), len(entries) + 1):
        count = -(-len(entries) // rows)
        legend = figure.legend(
            list(entries.values()),
            list(entries),
            loc="outside upper center",
            ncols=count,
            handlelength=2.8,
            columnspacing=1.4,
        )
        box = legend.get_window_extent()
        if count == 1 or box.width <= 0.98 * width:
            figure.set_figheight(figure.get_figheight() + box.height / figure.dpi)
            return
        legend.remove()
