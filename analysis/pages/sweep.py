"""The part of a report that compares methods over their seeds."""

from collections.abc import Mapping
from dataclasses import replace
from html import escape

import numpy as np

from zoac.analysis.curves import Curve, all_panels, draw_panel
from zoac.analysis.data.baseline import Before, baseline_values
from zoac.analysis.data.runs import Collection, Method, Run, by_method
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import METRICS, method_labels
from zoac.analysis.pages import html
from zoac.analysis.pages.formatting import (
    NOTHING,
    bounds,
    estimate,
    number,
    plus_minus,
    significant,
    without_empty_columns,
)
from zoac.analysis.statistics.comparison import NOMINAL, Claim, Comparison, compare
from zoac.analysis.statistics.intervals import MIN_SEEDS, Interval, MeanStd


def sweep(collection: Collection, task: str) -> str:
    """Return the comparison of all methods of a task: table, curves, differences, notes."""
    comparison = compare(collection, task)
    known = {run: baseline_values(run) for run in collection.finished if run.tuned}
    baselines = {run: baseline for run, baseline in known.items() if baseline is not None}
    return "".join(
        [
            html.part(
                "Comparison",
                html.paragraph(_setting(comparison, baselines)),
                _table(comparison, baselines),
                html.bullets([escape(note) for note in comparison.notes], css="warning"),
            ),
            html.part("Learning curves", html.gallery(_curves(collection, task, baselines))),
            html.part("Differences", _differences(comparison.claims)),
        ]
    )


def _setting(comparison: Comparison, baselines: Mapping[Run, Before]) -> str:
    text = (
        f"Cost of the tuned controllers in {comparison.episodes} evaluation episodes, the same for "
        "all. ± is the standard deviation over seeds."
    )
    if (cost := _shared(baselines, comparison.episodes)) is not None:
        better = sum(_better(run, baseline) for run, baseline in baselines.items())
        text += (
            f" The baseline values cost {significant(cost)} in the same episodes. "
            f"{better} of {len(baselines)} runs ended with a lower cost."
        )
    if any(s.intervals["cost"].exists for s in comparison.summaries):
        text += " Intervals are 95%, over seeds and episodes."
    return text


def _shared(baselines: Mapping[Run, Before], episodes: int) -> float | None:
    """Return the cost of the baseline in so many episodes; None if runs have different ones."""
    costs = {float(baseline.costs[:episodes].mean()) for baseline in baselines.values()}
    return costs.pop() if len(costs) == 1 else None


def _better(run: Run, baseline: Before) -> bool:
    return bool(run.costs.mean() < baseline.costs.mean())


def _table(comparison: Comparison, baselines: Mapping[Run, Before]) -> str:
    lines = [["Method", "Seeds", "Cost", "95% interval", "Interquartile mean",
              "Better than baseline", "Minus nominal, 95% interval", "Prediction error",
              "Wall time [s]"]]  # fmt: skip
    groups = by_method(baselines)
    for s in comparison.summaries:
        better = [_better(run, baselines[run]) for run in groups.get(s.method, [])]
        iqm, minus_nominal = s.intervals["iqm"], s.intervals["minus_nominal"]
        lines.append(
            [
                escape(s.label),
                str(len(s.seeds)),
                plus_minus(s.means["cost"]),
                bounds(s.intervals["cost"]),
                number(iqm.estimate) if s.tuned else NOTHING,
                f"{sum(better)} of {len(better)}" if better else NOTHING,
                estimate(minus_nominal, sign=True) if minus_nominal.exists else NOTHING,
                plus_minus(s.means["prediction_error"]),
                plus_minus(s.means["wall_seconds"] if s.tuned else MeanStd()),
            ]
        )
    return html.table(without_empty_columns(lines))


def _curves(collection: Collection, task: str, baselines: Mapping[Run, Before]) -> list[str]:
    pictures = []
    for panel in all_panels(collection, task):
        tuned = [curve for curve in panel.curves if len(curve.x) > 1]
        if not tuned:
            continue
        methods = [curve.method for curve in panel.curves]
        looks, labels = style.looks(methods), method_labels(methods, panel.names)
        cost = _shared(baselines, panel.episodes)
        if panel.metric == "cost_mean" and cost is not None and len(tuned) == len(methods):
            baseline, level = Method(task, NOMINAL, None), np.array([cost])
            looks[baseline], labels[baseline] = style.NOMINAL, "Baseline values"
            line = Curve(baseline, np.zeros(1), level, level, level)
            panel = replace(panel, curves=(*panel.curves, line))
        figure, axes = html.figure()
        draw_panel(axes, panel, looks, labels, "env_steps")
        name = f"{task} {panel.metric}"
        pictures.append(html.picture(figure, name, METRICS[panel.metric], columns=3))
    return pictures


def _differences(claims: tuple[Claim, ...]) -> str:
    """Return what can be claimed, one sentence about the rest, and every difference."""
    judged = [claim for claim in claims if claim.difference.exists]
    if not claims:
        return ""
    if not judged:
        return html.paragraph(
            f"A difference needs at least {MIN_SEEDS} seeds of each method for its interval. "
            "With fewer, none is reported."
        )
    said = [_said(claim) for claim in judged]
    text = html.bullets([sentence for sentence in said if sentence])
    if silent := said.count(""):
        many = f"{silent} of {len(judged)} pairs show" if len(judged) > 1 else "The pair shows"
        text += html.paragraph(
            f"{many} no clear difference: the interval of the difference contains zero, and that "
            "of the fraction of pairs contains 50%."
        )
    lines = [["First - second", "Difference of mean cost, 95% interval", "First costs less in"]]
    for claim in judged:
        p = claim.improvement
        share = f"{p.estimate:.0%} [{p.low:.0%}, {p.high:.0%}] of pairs" if p.exists else NOTHING
        pair = escape(f"{claim.first} - {claim.second}")
        lines.append([pair, estimate(claim.difference, sign=True), share])
    table = html.table(without_empty_columns(lines))
    return text + html.folded(f"All {len(judged)} differences", table)


def _said(claim: Claim) -> str:
    """Return what the data say of a pair, the better one named first; nothing if they do not."""
    d, p = claim.difference, claim.improvement
    told = {}
    if side := d.side():
        by = Interval(abs(d.estimate), *sorted((abs(d.low), abs(d.high))))
        told[side] = [f"costs less on average, by {estimate(by)}"]
    if side := -p.side(of=0.5):
        low, middle, high = sorted((p.low, p.estimate, p.high) if side < 0 else
                                   (1 - p.low, 1 - p.estimate, 1 - p.high))  # fmt: skip
        often = f"costs less in {middle:.0%} [{low:.0%}, {high:.0%}] of the pairs of seeds"
        told.setdefault(side, []).append(often)
    sentences = []
    for side, parts in told.items():
        better, worse = (claim.first, claim.second)[::-side]
        sentences.append(
            f"<b>{escape(better)}</b> beats {escape(worse)}: it {' and '.join(parts)}."
        )
    return " ".join(sentences)
