"""The part of a report that shows one run: what tuning changed, and how it went."""

from html import escape

import numpy as np

from zoac.analysis.data.baseline import Before, before
from zoac.analysis.data.runs import Run
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import METRICS, big_axis, needs_log
from zoac.analysis.pages import html, loops
from zoac.analysis.pages.formatting import estimate, signed, significant
from zoac.analysis.pages.parameters import parameters
from zoac.analysis.pages.reproduce import reproduce
from zoac.analysis.pages.requirements import requirements, verdicts
from zoac.runs.loggers.summary import ROUNDING


def details(run: Run, reference: Run | None, replays: bool, more: str = "") -> str:
    """Return what there is to say about one run, and `more` before the last parts.

    Args:
        run: The run.
        reference: A run that was not tuned, to compare with where the run has no baseline.
        replays: Whether to drive controllers once more where no signals were recorded.
    """
    compared = before(run, reference)
    response, steps = loops.recorded(run)
    return "".join(
        [
            html.paragraph(_verdict(run, compared), "verdict"),
            html.bullets([escape(told) for told in run.outcome.get("warnings", [])], "warning"),
            _tiles(run),
            html.part("Requirements", requirements(run)),
            html.part("Response", response),
            html.part("Step information", steps),
            html.part("Parameters", parameters(run, compared)),
            html.part("Learning curve", html.gallery(_learning_curves(run, compared))),
            html.part(
                "Closed loop",
                loops.closed_loop(run, compared) if replays and not response else "",
            ),
            more,
            html.part("Time and failures", _health(run)),
            html.part("How to reproduce", reproduce(run)),
        ]
    )


def _unit(run: Run, count: int) -> str:
    """Return what evaluation episodes, or experiments, are called."""
    word = "experiment" if "study" in run.identity else "evaluation episode"
    return f"{count} {word}{'' if count == 1 else 's'}"


def _verdict(run: Run, compared: Before | None) -> str:
    costs = run.costs
    found = verdicts(run)
    text = ""
    if found and not all(found):
        text = f'<b class="unmet">{sum(found)} of {len(found)} requirements are met.</b> '
    elif found:
        many = f"All {len(found)} requirements are met." if len(found) > 1 else "Requirement met."
        text = f'<b class="met">{many}</b> '
    if not np.isfinite(costs).all():
        return f"{text}The final cost is not finite."
    text += f"Cost <b>{significant(float(costs.mean()))}</b> in {_unit(run, len(costs))}"
    if compared is None:
        return f"{text}."
    shared = len(compared.costs)
    verb = "cost" if compared.what == "baseline values" else "costs"
    text += f"; the {compared.what} {verb} <b>{significant(float(compared.costs.mean()))}</b>"
    if shared < len(costs):
        now = significant(float(costs[:shared].mean()))
        text += f" in the first {shared}, where the answer costs {now}"
    difference = compared.difference(run)
    if difference is not None and difference.exists:
        if difference.high - difference.low <= ROUNDING * abs(difference.estimate):
            text += f". Difference {signed(difference.estimate)}, the same in every episode"
        else:
            text += f". Difference {estimate(difference, sign=True)}, paired, 95% over episodes"
    return f"{text}."


def _tiles(run: Run) -> str:
    result, study = run.outcome, "study" in run.identity
    costs = run.costs
    values = [
        ("experiments" if study else "environment steps", f"{result['env_steps']:,}"),
        ("final cost", significant(float(costs.mean()))),
    ]
    if len(costs) > 1:
        values.append(("std over episodes", significant(float(np.std(costs, ddof=1)))))
    if not study:
        values.append(("episodes ended early", f"{result.get('terminations', 0)} of {len(costs)}"))
    values.append(("wall time", _duration(result["wall_seconds"])))
    if result.get("prediction_error") is not None:
        values.append(("prediction error", significant(float(result["prediction_error"]))))
    return html.tiles(values)


def _learning_curves(run: Run, compared: Before | None) -> list[str]:
    """Return the cost, and the prediction error if there is one, over steps; the end included."""
    rows = [*run.evaluations, run.metrics[-1]]
    if len(rows) < 2 or not run.tuned:
        return []
    study = "study" in run.identity
    shared = min(len(row["cost_per_episode"]) for row in rows)
    steps = [row["env_steps"] for row in rows]
    pictures = []
    for metric in ("cost_mean", "prediction_error"):
        if not all(row.get(metric) is not None for row in rows):
            continue
        figure, axes = html.figure()
        values = np.array([row[metric] for row in rows], dtype=float)
        caption, level = "", np.empty(0)
        if metric == "cost_mean":
            episodes = np.array([row["cost_per_episode"][:shared] for row in rows], dtype=float)
            values = episodes.mean(axis=1)
            caption = f"Recommended parameters, {_unit(run, shared)} each"
            if shared > 1 and np.ptp(episodes, axis=1).any():
                low, high = np.quantile(episodes, [0.1, 0.9], axis=1)
                style.band(axes, steps, low, high, style.AFTER)
                caption += "; band: 10% to 90% of them"
            caption += "."
            if compared is not None and compared.what != "start of tuning":
                level = compared.costs[:shared].mean(keepdims=True)
                look, name = style.NOMINAL, compared.what.capitalize()
                axes.axhline(float(level[0]), color=look.colour, ls=look.dashes, lw=1.2, label=name)
        line = style.AFTER.line | {"marker": "o", "markersize": 3}
        axes.plot(steps, values, label="While tuning", **line)
        axes.plot(steps[-1:], values[-1:], "D", color=style.AFTER.colour, ms=5, label="Final")
        broken = [k for k, row in enumerate(rows) if row.get("violations")]
        if broken:
            axes.plot(
                np.array(steps)[broken], values[broken], "x", color=style.BAD, ms=7, mew=1.5,
                label="A requirement is broken",
            )  # fmt: skip
        if needs_log(np.concatenate([values, level])):
            axes.set_yscale("log")
        big_axis(axes, "Experiments" if study else METRICS["env_steps"])
        axes.set_ylabel("Cost" if metric == "cost_mean" else METRICS[metric])
        name = f"{run.folder} {metric}"
        pictures.append(html.picture(figure, name, METRICS[metric], caption, columns=4))
    return pictures


def _health(run: Run) -> str:
    result = run.outcome
    items = [
        f"wall time in the {part}: {_duration(result[f'{part}_seconds'])}"
        for part in ("tuner", "evaluation")
        if f"{part}_seconds" in result
    ]
    if result.get("compute_seconds") is not None:
        items.append(f"compute time over all processes {_duration(result['compute_seconds'])}")
    if seconds := result.get("solver_seconds"):
        items.append(f"time in the solver {_duration(seconds)}, summed over environments")
    if result.get("solver_failures"):
        items.append(f"solver failures: {result['solver_failures']}, evaluation included")
    if "tuning_terminations" in result:
        items.append(f"episodes that ended early while tuning: {result['tuning_terminations']}")
    if result.get("failures"):
        what = "experiments" if "study" in run.identity else "episodes"
        items.append(f"{what} that failed: {result['failures']}")
        if result.get("first_failure"):
            items.append(f"the first failure: {escape(str(result['first_failure']))}")
    return html.bullets(items)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.1f} s"
    minutes = seconds / 60
    return f"{minutes:.1f} min" if minutes < 90 else f"{minutes / 60:.1f} h"
