"""`responses.csv`: the signals of a final episode, with the baseline values and the answer.

The episode is that which `zoac.specs.verdict.deciding` names; `shown` in `result.json` says which.
One row a sample: `parameters` ("baseline" or "tuned"), `time`, and a column per signal. Of m loops
side by side a signal has m columns, `y 1` to `y m`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.core.errors import ConfigError, RunFolderError, needs_matplotlib, suggest
from zoac.runs import schema
from zoac.specs import guides
from zoac.specs.signals import Episode

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

KEYS = ("parameters", "time")
BEFORE, AFTER = ("#D55E00", (0, (4, 1.5))), ("#0072B2", "-")
"""Colour and dashes."""
LOOKS = {"baseline": ("Before", *BEFORE, 1.0), "tuned": ("After", *AFTER, 1.8)}
"""Label, colour, dashes and width by what the column `parameters` says."""
INK, GREY = "#222222", "#8a8a8a"
WIDTH, HEIGHT = 6.0, 1.9
"""Of the figure, and of each signal's axes [in]."""


def content(episodes: Mapping[str, Episode]) -> bytes:
    """Return the file's content.

    Args:
        episodes: By "baseline" and "tuned", with the same signals.
    """
    text = io.StringIO(newline="")
    table = csv.writer(text, lineterminator="\n")
    for k, (which, episode) in enumerate(episodes.items()):
        columns = _columns(episode)
        if k == 0:
            table.writerow([*KEYS, *columns])
        for row in zip(episode.time.tolist(), *columns.values(), strict=True):
            table.writerow([which, *row])
    return text.getvalue().encode()


def _columns(episode: Episode) -> dict[str, list[float]]:
    columns: dict[str, list[float]] = {}
    for name, samples in episode.values.items():
        if samples.ndim == 1:
            columns[name] = samples.tolist()
        else:
            several = enumerate(np.transpose(samples), start=1)
            columns |= {f"{name} {j}": column.tolist() for j, column in several}
    return columns


def read(folder: Path) -> pd.DataFrame:
    """Return the table of a run folder.

    Raises:
        RunFolderError: If there is none, or it is damaged.
    """
    import pandas as pd

    path = folder / schema.RESPONSES
    if not path.is_file():
        raise RunFolderError(
            f"{folder}: there is no {schema.RESPONSES}, which holds the signals of an episode; "
            "give the task signals, such as signals={'y': zoac.observation(0)}"
        )
    try:
        table = pd.read_csv(path, engine="python")  # every digit counts, in any pandas
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{path}: cannot be read ({error})") from None
    if tuple(table.columns[:2]) != KEYS:
        raise RunFolderError(f"{path}: expected the columns {', '.join(KEYS)} and signals")
    return table


def one_loop(table: pd.DataFrame, record: Mapping[str, Any]) -> pd.DataFrame:
    """Return the table with one of several loops side by side only, under the plain name.

    Args:
        table: From `read`.
        record: The content of `result.json`, which says which loop decides.
    """
    columns = list(table.columns)
    several = [c[:-2] for c in columns if c.endswith(" 1") and f"{c[:-2]} 2" in columns]
    number = record["shown"]["loop"] + 1
    chosen = {f"{name} {number}": name for name in several}
    others = [c for c in columns if c.rpartition(" ")[0] in several and c not in chosen]
    return table.drop(columns=others).rename(columns=chosen)


def title(record: Mapping[str, Any]) -> str:
    """Return which episode the table holds, for people to read, by the record of `result.json`."""
    shown = record["shown"]
    decides = f", the worst for {shown['spec']}" if shown["spec"] else ""
    return f"Final episode {shown['episode'] + 1} of {shown['of']}{decides}"


@needs_matplotlib()
def plot(folder: Path, record: Mapping[str, Any]) -> Figure:
    """Return a figure with axes for each signal that is not the reference of another.

    Its title says which final episode is shown. Of loops side by side the worst is.

    Raises:
        ConfigError: If Matplotlib is not installed.
        RunFolderError: If the run has no signals.
    """
    from matplotlib.figure import Figure

    table = one_loop(read(folder), record)
    signals = schema.read_run(folder).get("signals", {})
    specs = record.get("specs", [])
    named = guides.references(specs, table.columns[2:])
    shown = [name for name in table.columns[2:] if name not in named.values()]
    height = HEIGHT * len(shown) + 0.5
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, shown, strict=True):
        draw(axes, table, name, specs)
        unit = signals.get("units", {}).get(name, "")
        axes.set_ylabel(f"{name} [{unit}]" if unit else name)
    panels[0].set_title(title(record), fontsize="medium")
    panels[-1].set_xlabel("Time [s]" if signals.get("sample_time") else "Step")
    handles: dict[str, Any] = {}
    for axes in panels:
        handles |= {line.get_label(): line for line in axes.get_legend_handles_labels()[0]}
    figure.legend(handles=list(handles.values()), loc="outside upper center", ncols=4,
                  frameon=False)  # fmt: skip
    return figure


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure in the format that the suffix names; without a suffix, as `.png`.

    Raises:
        ConfigError: If Matplotlib does not write such a file, or the file cannot be written.
    """
    formats = [f".{name}" for name in figure.canvas.get_supported_filetypes()]
    if not isinstance(path, str | Path):
        raise ConfigError(
            f"plot({path!r}): expected a file, such as 'step.png'; formats: {', '.join(formats)}"
        )
    path = Path(path).expanduser()
    if path.suffix and path.suffix.lower() not in formats:
        raise ConfigError(f"plot to {path.name!r}: {suggest(path.suffix, formats)}")
    try:
        figure.savefig(path)
    except OSError as error:
        raise ConfigError(
            f"plot to {str(path)!r}: {error.strerror}; choose a folder that is there and can be "
            "written to"
        ) from None


def draw(axes: Axes, table: pd.DataFrame, name: str, specs: Sequence[Mapping[str, Any]]) -> None:
    """Draw one signal of `responses.csv`, its reference and its limits."""
    reference = guides.references(specs, table.columns[2:]).get(name)
    parts = list(table.groupby("parameters", sort=False))
    _, last = parts[-1]
    if reference in last.columns:
        axes.plot(last["time"], last[reference], color=GREY, lw=3.2, alpha=0.5, label="Reference")
    for which, part in parts:
        label, colour, dashes, width = LOOKS[str(which)]
        axes.plot(part["time"], part[name], color=colour, ls=dashes, lw=width, label=label)
    axes.margins(x=0.01)
    values = {column: last[column].to_numpy() for column in last.columns[2:]}
    _forbid(axes, guides.limits(specs, name, last["time"].to_numpy(), values))
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e4e4e4", lw=0.5)
    axes.set_axisbelow(True)


def _forbid(axes: Axes, limits: Sequence[guides.Limit]) -> None:
    """Hatch what lies beyond the limits, as far as the axes reach."""
    low, high = axes.get_ylim()
    room = 0.1 * (high - low)
    low = min([low, *(limit.level - room for limit in limits if not limit.upper)])
    high = max([high, *(limit.level + room for limit in limits if limit.upper)])
    for limit in limits:
        axes.fill_between(
            [limit.since, limit.until], limit.level, high if limit.upper else low,
            facecolor="none", edgecolor=GREY, hatch="////", lw=0.8, alpha=0.6, zorder=0.5,
            label="Forbidden",
        )  # fmt: skip
    axes.set_ylim(low, high)
