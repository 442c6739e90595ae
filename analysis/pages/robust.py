"""The part of a report on robustness and sensitivity, where `robustness` was run."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from zoac.analysis import robustness
from zoac.analysis.data import plants
from zoac.analysis.data.plants import STEP, Sensitivity, Variation
from zoac.analysis.data.runs import Run
from zoac.analysis.pages import html


def robust(run: Run, folder: Path) -> str:
    """Return what `zoac.analysis.robustness` wrote into a folder, if it is of this run.

    Raises:
        RunFolderError: If its file is damaged.
    """
    found = plants.read(folder / robustness.FILE, run)
    if found is None:
        return ""
    varied, around = found
    return (_plants(run, varied) if varied is not None else "") + _sensitivity(run, around)


def _plants(run: Run, varied: Variation) -> str:
    count, episodes = varied.size
    pictures = []
    for name in varied.plants:
        figure, axes = html.figure()
        robustness.draw_costs(axes, varied, name)
        label = f"Cost over {name}"
        pictures.append(html.picture(figure, f"{run.folder} plant {name}", label, columns=2))
    lines = [[escape(cell) for cell in line] for line in robustness.summary(varied)]
    return html.part(
        "Robustness",
        html.paragraph(
            f"Cost on {count} other plants, {episodes} episodes each: {escape(str(varied))}."
        ),
        html.table(lines),
        html.gallery(pictures),
    )


def _sensitivity(run: Run, around: Sequence[Sensitivity]) -> str:
    figure, axes = html.figure(height=max(1.6, 0.9 + 0.2 * len(around)))
    robustness.draw_sensitivity(axes, around)
    label = "Change of the mean cost"
    picture = html.picture(figure, f"{run.folder} sensitivity", label, columns=2)
    lines = [[escape(cell) for cell in line] for line in robustness.changes(around)]
    return html.part(
        "Sensitivity",
        html.paragraph(
            f"Change of the mean cost with one parameter moved by {STEP / 2:.0%} of its range."
        ),
        html.gallery([picture]),
        html.aside("As a table", html.table(lines)),
    )
