"""Figures of the documentation: the same numbers give the same file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
from cycler import Cycler, cycler

from zoac.analysis.figures import style

FIGURES = Path(__file__).parents[1] / "docs" / "images"


def cycle() -> Cycler:
    """Return colours, dashes and markers for the lines of figures that compare no tuners."""
    lines = [look.line for look in style.LOOKS.values() if look is not style.NOMINAL]
    return cycler(**{key: [line[key] for line in lines] for key in lines[0]})


def pyplot() -> Any:
    """Return matplotlib's pyplot, set to the style of the project's figures."""
    mpl.use("svg")
    mpl.rcParams.update({**style.SCREEN, "axes.prop_cycle": cycle()})
    return plt


def save(figure: Any, path: Path) -> None:
    """Write a figure, and print where."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})
    print(path)
