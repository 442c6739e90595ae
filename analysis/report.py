"""One self-contained HTML page about a run or a sweep: `python -m zoac.analysis.report runs`.

Nothing is fetched: style and pictures are in the page. The same runs give the same bytes.
"""

import argparse
import sys
from collections.abc import Sequence
from html import escape
from pathlib import Path

from zoac.analysis import robustness
from zoac.analysis.data import cli
from zoac.analysis.data.runs import Collection
from zoac.analysis.data.selection import chosen
from zoac.analysis.figures import style
from zoac.analysis.figures.labels import TASKS, family, method_labels, tuner_names
from zoac.analysis.pages import html, run_page
from zoac.analysis.pages.sweep import sweep
from zoac.core.errors import ConfigError

ROBUSTNESS = "robustness"
"""Where `zoac.analysis.robustness` writes unless told otherwise."""
_WRITTEN = (
    "what zoac.analysis.robustness wrote about a run that is shown; default: "
    f"{ROBUSTNESS}, if it is there"
)


@cli.command(
    "report", "One HTML page about a run or a sweep.", "reports", "variant", "trust_code",
    task={"help": "default: all tasks"},
    no_replay={"action": "store_true", "help": "do not drive controllers for closed-loop plots"},
    robustness={"type": cli.folder, "metavar": "FOLDER", "help": _WRITTEN},
)  # fmt: skip
def main(options: argparse.Namespace) -> None:
    """Write the report."""
    collection = cli.load_runs(options).of_variant(options.variant)
    if options.task is not None:
        collection = collection.of_task(*family(options.task))
    found = {family(run.method.task)[0] for run in collection.some_finished()}
    tasks = [options.task] if options.task is not None else sorted(found, reverse=True)
    folder = options.robustness or Path(ROBUSTNESS)
    if options.robustness is not None and not (folder / robustness.FILE).is_file():
        raise ConfigError(
            f"no {robustness.FILE} in {str(folder)!r}; expected the folder that "
            "python -m zoac.analysis.robustness wrote"
        )
    page = report(collection, tasks, not options.no_replay, folder)
    cli.write(options.out / "report.html", page)


def report(
    collection: Collection,
    tasks: Sequence[str],
    replay: bool = True,
    robustness_folder: Path = Path(ROBUSTNESS),
) -> str:
    """Return the page: for each task a comparison, if there are several runs, and runs in detail.

    The tasks are those to show, without their regularised twins. With `replay`, controllers are
    driven once more, for closed-loop plots.

    Raises:
        RunFolderError: If what `zoac.analysis.robustness` wrote into its folder is damaged.
    """
    with style.drawing(style.SCREEN):
        bodies = [_of_task(collection, task, replay, robustness_folder) for task in tasks]
    names = [TASKS.get(task, task) for task in tasks]
    if len(names) > 1:
        bodies = [html.part(name, body, level=2) for name, body in zip(names, bodies, strict=True)]
    left_out = html.bullets([escape(item) for item in collection.left_out])
    return html.page(", ".join(names), [*bodies, html.part("Left out", left_out, level=2)])


def _of_task(collection: Collection, task: str, replay: bool, robustness_folder: Path) -> str:
    runs = [run for run in collection.finished if run.method.task in family(task)]
    part = Collection(tuple(runs), ())
    shown = chosen(part)
    labels = method_labels((run.method for run in shown), tuner_names(runs))
    reference = next((run for run in shown if not run.tuned), None)
    tuned = [run for run in shown if run.tuned] or shown
    body = [sweep(part, task)] if len(runs) > 1 else []
    if replay and len(tuned) > 3:
        print(
            f"{task}: driving {len(tuned)} controllers once more; --no-replay leaves this out",
            file=sys.stderr,
        )
    for k, run in enumerate(tuned):
        siblings = sum(other.method == run.method for other in runs)
        median = f", the median of {siblings} by cost" if siblings > 1 else ""
        title = escape(f"{labels[run.method]}, seed {run.seed}{median}")
        text = run_page.details(run, reference, replay, robustness.part(run, robustness_folder))
        if len(runs) == 1:
            return html.paragraph(title, "muted") + text
        body.append(html.folded(title, text, k == 0))
    return "".join(body)


if __name__ == "__main__":
    raise SystemExit(main())
