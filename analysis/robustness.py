"""Tuned parameters on other plants, and the cost of being a little off: table, figure, page.

    python -m zoac.analysis.robustness runs --task pid_acc --vary preceding_std=0.02,0.2

What may vary is every number among the task's options in `run.json`; of a Gymnasium environment,
`plant.NAME` is an attribute of it. Without --vary only the sensitivity is shown.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from zoac.analysis.data import cli, plants
from zoac.analysis.data.plants import STEP, Sensitivity, Variation
from zoac.analysis.data.runs import Run
from zoac.analysis.data.selection import chosen
from zoac.analysis.figures import style
from zoac.analysis.pages import html
from zoac.analysis.pages.formatting import pipes, signed, significant
from zoac.core.errors import ConfigError
from zoac.core.types import bad_is_infinite

TAIL = 0.1
"""Fraction of the costliest episodes whose mean is the tail risk (CVaR)."""

FILE = "robustness.json"
"""From which `report` makes its part on robustness."""

LOOKS = {plants.TUNED: style.AFTER, plants.BASELINE: style.BEFORE}
MARKERS = {plants.TUNED: "o", plants.BASELINE: "^"}


@cli.command(
    "robustness", "Tuned parameters on varied plants.", "robustness", *cli.OPTIONS,
    tuner={"help": "default: zoac's median run, or whatever was tuned"},
    seed={"type": cli.seed, "help": "default: the median run"},
    vary={"action": "append", "metavar": "NAME=LOW,HIGH", "help": "may be repeated"},
    plants={"type": cli.count, "default": 20, "help": "plants drawn; default: 20"},
    episodes={"type": cli.count, "default": 8, "help": "per plant; default: 8"},
)  # fmt: skip
def main(options: argparse.Namespace) -> None:
    """Write table and figure of one run."""
    ranges = dict(_parsed(text) for text in options.vary or ())
    run = chosen(cli.load_one_task(options), options.tuner, options.seed)[0]
    print(f"{run.folder}: {run.method}, seed {run.seed}", file=sys.stderr)
    varied = plants.vary(run, ranges, options.plants, options.episodes)
    around = plants.sensitivity(run, options.episodes)
    cli.write_markdown(options.out / "robustness.md", markdown(run, varied, around))
    cli.write(options.out / FILE, plants.as_json(run, varied, around))
    style.save(lambda: draw(varied, around), options, "robustness")


def _parsed(text: str) -> tuple[str, tuple[float, float]]:
    name, _, bounds = text.partition("=")
    try:
        low, high = (float(part) for part in bounds.split(","))
    except ValueError:
        raise ConfigError(f"--vary {text}: expected NAME=LOW,HIGH") from None
    if not math.isfinite(high - low):  # so that a number between them can be drawn
        raise ConfigError(f"--vary {text}: expected finite bounds, a finite distance apart")
    if low > high:
        raise ConfigError(f"--vary {text}: the lower bound must not be above the upper")
    return name, (low, high)


def tail_risk(costs: np.ndarray) -> float:
    """Return the mean of the costliest `TAIL` of costs, at least one (CVaR)."""
    ordered = np.sort(np.ravel(costs))[::-1]
    return float(ordered[: max(1, round(TAIL * len(ordered)))].mean())


def summary(varied: Variation) -> list[list[str]]:
    """Return header and rows of the costs on the varied plants."""
    lines = [["Controller", "Own plant", "Mean", f"Worst {TAIL:.0%}, mean", "Worst"]]
    for name, costs in varied.costs.items():
        others = costs[1:]
        values = (costs[0].mean(), others.mean(), tail_risk(others), others.max())
        lines.append([name, *(significant(float(v)) for v in values)])
    return lines


def _size(of: Sensitivity) -> float:
    """Return the larger change of the two; one that is not finite is larger than any."""
    return float(bad_is_infinite(np.abs([of.below, of.above])).max())


def changes(around: Sequence[Sensitivity]) -> list[list[str]]:
    """Return header and rows of the changes of the cost, the largest first."""
    lines = [["Parameter", "A little less", "A little more", "Standard error"]]
    for s in sorted(around, key=_size, reverse=True):
        lines.append([s.name, signed(s.below), signed(s.above), significant(s.error)])
    return lines


def markdown(run: Run, varied: Variation, around: Sequence[Sensitivity]) -> str:
    """Return both tables as Markdown."""
    parts = [f"# Robustness of {run.method}, seed {run.seed}"]
    if varied.plants:
        count, episodes = varied.size
        parts += [
            f"Cost over {count} plants of {episodes} episodes each: {varied}.",
            pipes(summary(varied)),
        ]
    parts += [f"Change of the mean cost with one parameter moved by {STEP / 2:.0%} of its range:"]
    return "\n\n".join([*parts, pipes(changes(around))]) + "\n"


def draw(varied: Variation, around: Sequence[Sensitivity]) -> style.Figure:
    """Return a figure: cost against each varied number, and the sensitivity."""
    figure = style.blank(style.PAGE, max(2.2, 0.5 + 0.16 * len(around)))
    panels = figure.subplots(1, len(varied.plants) + 1, squeeze=False)[0]
    for axes, name in zip(panels, varied.plants, strict=False):
        draw_costs(axes, varied, name)
    draw_sensitivity(panels[-1], around)
    for axes in panels:
        axes.legend()
    return figure


def draw_costs(axes: style.Axes, varied: Variation, name: str) -> None:
    """Draw the cost of each controller on each plant against one varied number."""
    x = varied.plants[name]
    for controller, costs in varied.costs.items():
        look, marker = LOOKS[controller], MARKERS[controller]
        axes.plot(x, costs.mean(axis=1), marker, color=look.colour, label=f"{controller}, mean")
        axes.plot(x, costs.max(axis=1), marker, color=look.colour, mfc="none", mew=0.6, alpha=0.7,
                  label=f"{controller}, worst")  # fmt: skip
    axes.set_xlabel(name)
    axes.set_ylabel("Cost")


def draw_sensitivity(axes: style.Axes, around: Sequence[Sensitivity]) -> None:
    """Draw by how much the cost changes with each parameter moved a little down and up."""
    order = sorted(around, key=_size)
    rows = np.arange(len(order))
    for shift, colour, label, values in (
        (-0.2, "white", "less", [s.below for s in order]),
        (0.2, style.AFTER.colour, "more", [s.above for s in order]),
    ):
        axes.barh(rows + shift, values, height=0.4, color=colour, ec=style.AFTER.colour, lw=0.8,
                  label=f"{STEP / 2:.0%} of the range {label}")  # fmt: skip
    axes.axvline(0.0, color=style.INK, lw=0.6)
    axes.set_yticks(rows, [s.name for s in order])
    axes.set_xlabel("Change of the mean cost")


def part(run: Run, folder: Path) -> str:
    """Return a report's part on what was written into a folder, if it is of this run.

    Raises:
        RunFolderError: If its file is damaged.
    """
    found = plants.read(folder / FILE, run)
    if found is None:
        return ""
    varied, around = found
    drawn = _plants_part(run, varied) if varied.plants else ""
    return drawn + _sensitivity_part(run, around)


def _plants_part(run: Run, varied: Variation) -> str:
    count, episodes = varied.size
    pictures = []
    for name in varied.plants:
        figure, axes = html.figure()
        draw_costs(axes, varied, name)
        label = f"Cost over {name}"
        pictures.append(html.picture(figure, f"{run.folder} plant {name}", label, columns=2))
    lines = [[escape(cell) for cell in line] for line in summary(varied)]
    return html.part(
        "Robustness",
        html.paragraph(
            f"Cost on {count} other plants, {episodes} episodes each: {escape(str(varied))}."
        ),
        html.table(lines),
        html.gallery(pictures),
    )


def _sensitivity_part(run: Run, around: Sequence[Sensitivity]) -> str:
    figure, axes = html.figure(height=max(1.6, 0.9 + 0.2 * len(around)))
    draw_sensitivity(axes, around)
    label = "Change of the mean cost"
    picture = html.picture(figure, f"{run.folder} sensitivity", label, columns=2)
    lines = [[escape(cell) for cell in line] for line in changes(around)]
    return html.part(
        "Sensitivity",
        html.paragraph(
            f"Change of the mean cost with one parameter moved by {STEP / 2:.0%} of its range."
        ),
        html.gallery([picture]),
        html.folded("As a table", html.table(lines)),
    )


if __name__ == "__main__":
    raise SystemExit(main())
