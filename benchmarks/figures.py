"""Figures of the documentation: the same numbers give the same file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt

from zoac.analysis.figures import style

FIGURES = Path(__file__).parents[1] / "docs" / "images"


def pyplot() -> Any:
    """Return matplotlib's pyplot, set to the style of the project's figures."""
    mpl.use("svg")
    mpl.rcParams.update({**style.SCREEN, "axes.prop_cycle": style.cycle()})
    return plt


def save(figure: Any, path: Path) -> None:
    """Write a figure, and print where."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})
    print(path)
