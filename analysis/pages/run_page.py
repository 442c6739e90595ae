"""The part of a report that shows one run: before and after, gains, closed loop, health."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from zoac.analysis.data import replay
from zoac.analysis.data.runs import Run
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import METRICS, unit_label
from zoac.analysis.pages import html
from zoac.analysis.pages.formatting import NOTHING, estimate, number, without_empty_columns
from zoac.analysis.pages.requirements import requirements
from zoac.analysis.statistics.stats import Scores, paired_difference
from zoac.analysis.trajectories import Loop, draw_panel
from zoac.core.errors import RunFolderError
from zoac.core.measures import Trace
from zoac.core.parameters import Parameter, ParameterSpace
from zoac.core.seeding import stream

MAX_VIEW = 3.0
"""Largest range of an axis, as a multiple of what the tuned controller needs."""

NEAR_BOUND = 0.01
"""Fraction of the range within which a parameter counts as being at its bound."""


def details(
    run: Run, label: str, siblings: int, reference: Run | None, replays: bool, opened: bool
) -> str:
    """Return a folded part about one run.

    Args:
        run: The run.
        label: Of its method.
        siblings: Number of seeds of this method that are there; the run shown is their median.
        reference: A run that was not tuned, to compare with.
        replays: Whether to drive the controllers for closed-loop plots.
        opened: Whether the part is open at first.
    """
    which = f", the median of {siblings} by cost" if siblings > 1 else ""
    title = f"{escape(label)}, seed {run.seed}{which}"
    parts = [
        html.paragraph(_verdict(run, reference)),
        html.bullets([escape(told) for told in run.outcome.get("warnings", [])], css="warning"),
        _tiles(run),
        requirements(run),
        html.subtitle("Parameters"),
        _parameters(run),
        html.subtitle("Learning curve"),
        html.gallery(_learning_curves(run)),
        html.subtitle("Closed loop"),
        _closed_loop(run, reference) if replays else html.paragraph("Not replayed.", "muted"),
        html.subtitle("Health"),
        _health(run),
        html.subtitle("How to reproduce"),
        _reproduce(run),
    ]
    return html.folded(title, "".join(parts), opened)


def _verdict(run: Run, reference: Run | None) -> str:
    costs = run.costs
    if not np.isfinite(costs).all():
        return "The final cost is not finite."
    text = f"Final cost <b>{number(float(costs.mean()))}</b> over {len(costs)} evaluation episodes"
    first = run.evaluations[0] if replay.before(run) else None
    if first is not None:
        shared = len(first["cost_per_episode"])
        start = float(np.mean(first["cost_per_episode"]))
        end = float(costs[:shared].mean())
        text += (
            f"; on the {shared} of them that were run before tuning as well, "
            f"<b>{number(start)}</b> before and <b>{number(end)}</b> after"
        )
    if reference is not None and reference is not run and len(reference.costs) == len(costs):
        difference = paired_difference(
            Scores(costs[None], tuned=False),
            Scores(reference.costs[None], tuned=False),
            stream(0, f"report {run.folder.name}"),
        )
        text += (
            f". Against the controller that was not tuned: "
            f"{estimate(difference, sign=True)}, paired, "
            "95% over episodes, for this one run"
        )
    if (baseline := run.outcome.get("baseline_cost_mean")) is not None:
        text += f". The baseline costs <b>{number(baseline)}</b> on the same episodes"
    return text + "."


def _tiles(run: Run) -> str:
    result = run.outcome
    values = [
        ("environment steps", f"{result['env_steps']:,}"),
        ("final cost", number(float(run.costs.mean()))),
        ("its standard deviation", number(float(np.std(run.costs, ddof=1)))),
        ("episodes ended early", f"{result.get('terminations', 0)} of {len(run.costs)}"),
        ("wall time", _duration(result["wall_seconds"])),
    ]
    if result.get("prediction_error") is not None:
        values.append(("prediction error", number(float(result["prediction_error"]))))
    return html.tiles(values)


def _parameters(run: Run) -> str:
    first, nominal = replay.before(run) or {}, run.identity["nominal"] or {}
    lines = [["Name", "Before", "Nominal", "After", "Low", "", "High"]]
    at_bound = []
    for record in run.identity["parameters"]:
        parameter = Parameter(**record)
        name, scale = parameter.name, " (log)" if parameter.scale == "log" else ""
        after = run.outcome["parameters"][name]
        values = {"before": first.get(name), "nominal": nominal.get(name), "after": after}
        places = {}
        if parameter.kind != "choice":
            places = {k: _place(parameter, v) for k, v in values.items() if v is not None}
            for bound, distance in (("low", places["after"]), ("high", 1 - places["after"])):
                if distance < NEAR_BOUND:
                    at_bound.append(f"{escape(name)} ({bound})")
        lines.append(
            [
                escape(unit_label(name, parameter.unit)) + scale,
                *(_value(v) for v in values.values()),
                f"{parameter.low:g}" if places else NOTHING,
                html.placed(places) if places else escape(", ".join(map(str, parameter.options))),
                f"{parameter.high:g}" if places else NOTHING,
            ]
        )
    text = html.keys(["before", "nominal", "after"]) + html.table(without_empty_columns(lines))
    if at_bound:
        text += html.paragraph(
            f"At a bound: {', '.join(at_bound)}. Where the bound is not physical, a wider range "
            "may do better.",
            "warning",
        )
    return text


def _value(value: float | str | None) -> str:
    if isinstance(value, str):
        return escape(value)
    return NOTHING if value is None else f"{value:.6g}"


def _place(parameter: Parameter, value: float) -> float:
    """Return where in its range, 0 to 1, `value` lies."""
    inside = float(np.clip(value, parameter.low, parameter.high))
    return (float(ParameterSpace([parameter]).normalise({parameter.name: inside})[0]) + 1) / 2


def _learning_curves(run: Run) -> list[str]:
    rows = run.evaluations
    if len(rows) < 2:
        return []
    pictures = []
    steps = [row["env_steps"] for row in rows]
    for metric, caption in (
        ("cost_mean", "Recommended parameters; band: 10% to 90% of the episodes"),
        ("prediction_error", ""),
    ):
        if metric not in rows[0]:
            continue
        values = np.array([row[metric] for row in rows], dtype=float)
        figure, axes = html.figure()
        axes.plot(steps, values, color=style.COLOURS[0], marker="o", markersize=3)
        if metric == "cost_mean":
            episodes = np.array([row["cost_per_episode"] for row in rows], dtype=float)
            low, high = np.nanquantile(episodes, [0.1, 0.9], axis=1)
            axes.fill_between(steps, low, high, color=style.COLOURS[0], alpha=0.15, lw=0)
        if np.nanmin(values) > 0 and np.nanmax(values) > 20 * np.nanmin(values):
            axes.set_yscale("log")
        style.big_axis(axes, "Environment steps")
        axes.set_ylabel(METRICS[metric])
        pictures.append(html.picture(figure, f"{run.folder} {metric}", METRICS[metric], caption))
    return pictures


def _closed_loop(run: Run, reference: Run | None) -> str:
    try:
        task = replay.rebuild(run)
    except RunFolderError as error:
        return html.paragraph(escape(str(error)), "muted")
    controllers = {"After": run.outcome["parameters"]}
    if first := replay.before(run):
        controllers = {"Before": first, **controllers}
    if reference is not None and reference is not run:
        controllers["Nominal"] = reference.outcome["parameters"]
    looks = {
        "Before": style.Look("#d9a07c", "-", ""),
        "After": style.Look(style.COLOURS[0], "-", ""),
        "Nominal": style.Look(style.INK, (0, (1, 1.5)), ""),
    }
    segments = replay.demonstrate(task, list(controllers.values()))
    loops = [
        Loop(name, looks[name], segment)
        for name, segment in zip(controllers, segments, strict=True)
    ]
    pictures = []
    tuned = [loop.segment for loop in loops if loop.label != "Before"]
    last = replay.settled(task, tuned)
    for k, trace in enumerate(task.traces(segments[0])):
        figure, axes = html.figure()
        entries = draw_panel(axes, task, loops, k, last)
        _keep_in_view(axes, [task.traces(segment)[k] for segment in tuned])
        style.legend_above(figure, entries, columns=4)
        pictures.append(html.picture(figure, f"{run.folder} trace {k}", trace.title))
    totals = ", ".join(f"{loop.label.lower()} {number(loop.segment.costs.sum())}" for loop in loops)
    return html.gallery(pictures) + html.paragraph(
        f"Cost of this episode: {totals}. Axes fit the tuned controller; what was before tuning "
        "may leave them.",
        "muted",
    )


def _keep_in_view(axes: Axes, traces: Sequence[Trace]) -> None:
    """Narrow the y axis if the other lines would squeeze `traces` into a fraction of it."""
    low = min(float(trace.y.min()) for trace in traces)
    high = max(float(trace.y.max()) for trace in traces)
    bottom, top = axes.get_ylim()
    if top - bottom > MAX_VIEW * (high - low) > 0:
        room = (MAX_VIEW - 1) / 2 * (high - low)
        axes.set_ylim(max(bottom, low - room), min(top, high + room))


def _health(run: Run) -> str:
    result = run.outcome
    wall = float(result["wall_seconds"])
    named = [
        (name, float(result.get(f"{name}_seconds", 0.0)))
        for name in ("tuner", "evaluation", "checkpoint")
    ]
    rest = max(0.0, wall - sum(value for _, value in named))
    text = html.fractions([("rollouts and the rest", rest), *named])
    items = [f"wall time {_duration(wall)}"]
    if result.get("compute_seconds") is not None:
        items.append(f"compute time over all processes {_duration(result['compute_seconds'])}")
    if result.get("solver_seconds"):
        items.append(
            f"time in the solver {_duration(result['solver_seconds'])}, summed over environments"
        )
    if "solver_failures" in result:
        items.append(f"solver failures {result['solver_failures']}, tuning and evaluation together")
    if "tuning_terminations" in result:
        items.append(f"episodes that ended early while tuning: {result['tuning_terminations']}")
    return text + html.bullets(items)


def _reproduce(run: Run) -> str:
    identity = run.identity
    module, *arguments = identity.get("command") or [""]
    start = "python -m zoac.run" if module.endswith("run.py") else module
    command = f"{start} {shlex.join(arguments)}".strip()
    facts = {
        key: identity.get(key)
        for key in ("started", "commit", "machine", "versions", "config_hash", "tuner_choices")
    }
    return (
        (html.code(command) if command else "")
        + html.folded("Versions and machine", html.code(_yaml(facts)))
        + html.folded("Configuration", html.code(_yaml(run.config)))
    )


def _yaml(node: Any, indent: int = 0) -> str:
    """Return plain data as YAML, for reading."""
    lines = []
    for key, value in node.items():
        if isinstance(value, Mapping) and value:
            lines.append(f"{' ' * indent}{key}:\n{_yaml(value, indent + 2)}")
        else:
            shown = value if isinstance(value, str) else json.dumps(value)
            lines.append(f"{' ' * indent}{key}: {shown}")
    return "\n".join(lines)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.1f} s"
    minutes = seconds / 60
    return f"{minutes:.1f} min" if minutes < 90 else f"{minutes / 60:.1f} h"
