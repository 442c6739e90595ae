"""Figures of the documentation: the same numbers give the same file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

FIGURES = Path(__file__).parents[1] / "docs" / "images"


def pyplot() -> Any:
    """Return matplotlib's pyplot, set to write SVG with its text as text."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams.update(
        {"svg.hashsalt": "zoac", "svg.fonttype": "none", "axes.titlesize": "medium"}
    )
    import matplotlib.pyplot as plt

    return plt


def save(figure: Any, path: Path) -> None:
    """Write a figure, and print where."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})
    print(path)
