"""One self-contained HTML page about a run or a sweep: `python -m zoac.analysis.report runs`.

Nothing is fetched: style and pictures are in the page. The same runs give the same bytes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from html import escape

from zoac.analysis import cli
from zoac.analysis.curves import all_panels, draw_panel
from zoac.analysis.data.runs import Collection
from zoac.analysis.data.selection import chosen
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import METRICS, TASKS, family, method_labels
from zoac.analysis.pages import html, run_page
from zoac.analysis.pages.formatting import (
    NOTHING,
    bounds,
    number,
    plus_minus,
    without_empty_columns,
)
from zoac.analysis.statistics.comparison import Comparison, compare


def main(argv: Sequence[str] | None = None) -> int:
    """Write the report; return the exit code."""
    parser = cli.parser(
        "report", "One HTML page about a run or a sweep.", "reports", "--variant", "--trust-code"
    )
    parser.add_argument("--task", help="default: all tasks")
    parser.add_argument(
        "--no-replay", action="store_true", help="do not drive controllers for closed-loop plots"
    )
    return cli.guarded(_command, parser, argv)


def _command(options: argparse.Namespace) -> None:
    collection = cli.of_variant(cli.load_runs(options), options)
    if options.task is not None:
        collection = collection.of_task(*family(options.task))
    found = {family(run.method.task)[0] for run in collection.some_finished()}
    tasks = [options.task] if options.task is not None else sorted(found, reverse=True)
    page = report(collection, tasks, replay=not options.no_replay)
    cli.write(options.out / "report.html", page)


def report(collection: Collection, tasks: Sequence[str], replay: bool = True) -> str:
    """Return the page: for each task a comparison, if there are several runs, and runs in detail.

    Args:
        collection: The runs.
        tasks: Names of the tasks to show, without their regularised twins.
        replay: Whether to drive controllers once more, for closed-loop plots.
    """
    with style.screen():
        sections = [_task_section(collection, task, replay) for task in tasks]
    title = "Tuning report: " + ", ".join(TASKS.get(task, task) for task in tasks)
    if collection.left_out:
        items = [escape(str(item)) for item in collection.left_out]
        sections.append(html.section("Left out", html.bullets(items)))
    return html.page(title, sections)


def _task_section(collection: Collection, task: str, replay: bool) -> str:
    runs = [run for run in collection.finished if run.method.task in family(task)]
    part = Collection(tuple(runs), ())
    body = [_comparison(part, task)] if len(runs) > 1 else []
    shown = chosen(part)
    labels = method_labels(run.method for run in shown)
    reference = next((run for run in shown if not run.tuned), None)
    tuned = [run for run in shown if run.tuned] or shown
    for k, run in enumerate(tuned):
        siblings = sum(other.method == run.method for other in runs)
        body.append(
            run_page.details(run, labels[run.method], siblings, reference, replay, opened=k == 0)
        )
    return html.section(TASKS.get(task, task), *body)


def _comparison(collection: Collection, task: str) -> str:
    comparison = compare(collection, task)
    return "".join(
        [
            html.subtitle("Comparison"),
            html.paragraph(_setting(comparison)),
            _comparison_table(comparison),
            html.gallery(_curves(collection, task)),
            html.subtitle("What the data say"),
            html.bullets([escape(str(claim)) for claim in comparison.claims]),
            html.bullets([escape(note) for note in comparison.notes], css="warning"),
        ]
    )


def _setting(comparison: Comparison) -> str:
    return (
        f"Final cost over {comparison.episodes} evaluation episodes, the same for every run. "
        "Mean ± standard deviation over seeds; intervals are 95%, over seeds and episodes, and "
        "are not given for fewer than five seeds."
    )


def _comparison_table(comparison: Comparison) -> str:
    header = ["Method", "Seeds", "Cost", "95% interval", "Interquartile mean", "Minus nominal",
              "95% interval", "Prediction error", "Wall time [s]"]  # fmt: skip
    lines = [header]
    for s in comparison.summaries:
        lines.append(
            [
                escape(s.label),
                str(len(s.seeds)),
                plus_minus(s.cost_std),
                bounds(s.cost),
                number(s.iqm.estimate) if s.iqm else NOTHING,
                number(s.minus_nominal.estimate, sign=True) if s.minus_nominal else NOTHING,
                bounds(s.minus_nominal, sign=True),
                plus_minus(s.prediction_error),
                plus_minus(s.wall_seconds if s.tuned else None),
            ]
        )
    return html.table(without_empty_columns(lines))


def _curves(collection: Collection, task: str) -> list[str]:
    pictures = []
    for panel in all_panels(collection, task):
        methods = [curve.method for curve in panel.curves]
        figure, axes = html.figure()
        draw_panel(axes, panel, style.looks(methods), method_labels(methods), "env_steps")
        handles, labels = axes.get_legend_handles_labels()
        style.legend_above(figure, dict(zip(labels, handles, strict=True)), columns=3)
        pictures.append(html.picture(figure, f"{task} {panel.metric}", METRICS[panel.metric]))
    return pictures


if __name__ == "__main__":
    raise SystemExit(main())
