"""Table II of the paper, and ours beside it: `python -m zoac.analysis.table2 runs --out tables`.

Writes table2.md, table2.tex and table2.csv; the same runs give the same bytes.
"""

import argparse
from typing import Any, NamedTuple

import pandas as pd

from zoac.analysis.data import cli
from zoac.analysis.data.runs import Method
from zoac.analysis.figures.labels import TASKS, family
from zoac.analysis.pages.formatting import (
    bounds,
    number,
    pipes,
    plus_minus,
    without_empty_columns,
)
from zoac.analysis.statistics.comparison import NOMINAL, Comparison, Summary, compare
from zoac.analysis.statistics.intervals import MeanStd


class PaperRow(NamedTuple):
    """One row of Table II as printed."""

    cost: MeanStd = MeanStd()
    prediction_error: MeanStd = MeanStd()
    seconds: MeanStd = MeanStd()


PAPER = {
    ("mpc_tracking", "zoac"): PaperRow(
        MeanStd(41.7, 3.8), MeanStd(2.9e-4, 1.4e-4), MeanStd(6.5e3, 0.2e3)
    ),
    ("mpc_tracking_reg", "zoac"): PaperRow(
        MeanStd(40.5, 3.2), MeanStd(9.6e-5, 4.5e-5), MeanStd(7.1e3, 0.1e3)
    ),
    ("mpc_tracking", "bo"): PaperRow(
        MeanStd(51.3, 22.9), MeanStd(2.3e-4, 1.7e-4), MeanStd(2.7e4, 0.1e4)
    ),
    ("mpc_tracking", "cmaes"): PaperRow(
        MeanStd(185.0, 184.6), MeanStd(4.4e-4, 2.9e-4), MeanStd(2.6e4, 0.1e4)
    ),
    ("mpc_tracking", NOMINAL): PaperRow(MeanStd(37.16), MeanStd(0.0)),
}
TABLE2 = [Method(task, tuner, None) for task, tuner in PAPER]

COLUMNS = (
    "Method", "Seeds", "Cumulative cost", "Paper's", "Prediction error", "Paper's",
    "Share of episodes in violation",
    "Wall time [s]", "Compute time [s]", "Paper's tuning time [s]",
)  # fmt: skip
STATISTICS = (
    "Method", "Mean", "95% interval", "Interquartile mean", "95% interval",
    "Minus nominal, paired", "95% interval",
)  # fmt: skip
METHOD_NOTE = (
    "Mean ± sample standard deviation over seeds. Times include evaluation; compute time adds up "
    "all processes. Intervals: two-level bootstrap, seeds outer, shared episodes inner, widened "
    "for few seeds and not given for fewer than five; each stands alone, without correction for "
    "how many there are."
)
_WITHIN = "use the last evaluation of each run within so many environment steps"


@cli.command(
    "table2", "Table II beside the paper's.", "tables", "variant",
    task={"help": f"default: {TABLE2[0].task} where there is one, else the only one"},
    budget={"type": cli.count, "metavar": "STEPS", "help": _WITHIN},
    seeds={"type": cli.seeds, "metavar": "0-4", "help": "the seeds each method should have"},
)  # fmt: skip
def main(options: argparse.Namespace) -> None:
    """Write the table of one task in three formats."""
    collection = cli.load_runs(options)
    runs = collection.finished if options.task else collection.some_finished()
    found = {family(run.method.task)[0] for run in runs}
    default = TABLE2[0].task
    task = options.task or (default if default in found else cli.only_task(found))
    comparison = compare(
        collection,
        task,
        variant=options.variant,
        budget=options.budget,
        seeds=options.seeds,
        expected=TABLE2 if task == default else (),
    )
    cli.write_markdown(options.out / "table2.md", markdown(comparison))
    cli.write(options.out / "table2.tex", latex(comparison))
    cli.write(options.out / "table2.csv", csv(comparison))


def markdown(comparison: Comparison) -> str:
    """Return both tables, the claims and the notes as Markdown."""
    statistics = [list(STATISTICS), *(_statistics_cells(s) for s in comparison.summaries)]
    parts = [f"# {_title(comparison)}", _setting(comparison), pipes(main_cells(comparison))]
    parts += [pipes(statistics), METHOD_NOTE]
    choices = [
        f"{s.label}: {'; '.join(f'{k} {v}' for k, v in s.choices.items())}"
        for s in comparison.summaries
        if s.choices
    ]
    for title, lines in (
        ("What each tuner chose", choices),
        ("Claims", comparison.claims),
        ("Notes", comparison.notes),
    ):
        if lines:
            parts.append(f"## {title}\n\n" + "\n".join(f"- {line}" for line in lines))
    return "\n\n".join(parts) + "\n"


def latex(comparison: Comparison) -> str:
    """Return the table as a LaTeX `table*` without further packages."""
    header, *rows = ([_tex(cell) for cell in line] for line in main_cells(comparison))
    lines = [
        *(f"% {note}" for note in (METHOD_NOTE, *comparison.notes)),
        r"\begin{table*}[t]",
        r"\centering",
        rf"\caption{{{_tex(_title(comparison))}. {_tex(_setting(comparison))}}}",
        r"\label{tab:table2}",
        rf"\begin{{tabular}}{{l{'c' * (len(header) - 1)}}}",
        r"\hline",
        " & ".join(rf"\textbf{{{name}}}" for name in header) + r" \\",
        r"\hline",
        *(" & ".join(row) + r" \\" for row in rows),
        r"\hline",
        r"\end{tabular}",
        r"\end{table*}",
    ]
    return "\n".join(lines) + "\n"


def csv(comparison: Comparison) -> str:
    """Return one row per method, numbers to ten digits; violations are fractions of episodes.

    Beyond ten digits the order in which a processor sums is seen.
    """
    frame = pd.DataFrame([_record(s) for s in comparison.summaries])
    return frame.to_csv(index=False, lineterminator="\n", float_format="%.10g")


def main_cells(comparison: Comparison) -> list[list[str]]:
    """Return header and rows of the table proper."""
    return without_empty_columns([COLUMNS, *map(_cells, comparison.summaries)])


def _paper(s: Summary) -> PaperRow:
    return PAPER.get((s.method.task, s.method.tuner), PaperRow())


def _cells(s: Summary) -> list[str]:
    paper, means = _paper(s), s.means
    wanted = len(s.seeds) + len(s.missing)
    return [
        s.label,
        f"{len(s.seeds)} of {wanted}" if s.missing else str(len(s.seeds)),
        plus_minus(means["cost"]),
        plus_minus(paper.cost),
        plus_minus(means["prediction_error"]),
        plus_minus(paper.prediction_error),
        plus_minus(means["violations"]),
        plus_minus(means["wall_seconds"] if s.tuned else MeanStd()),
        plus_minus(means["compute_seconds"] if s.tuned else MeanStd()),
        plus_minus(paper.seconds),
    ]


def _statistics_cells(s: Summary) -> list[str]:
    cells = [s.label]
    for interval in s.intervals.values():
        cells += [number(interval.estimate), bounds(interval)]
    return cells


def _record(s: Summary) -> dict[str, Any]:
    record: dict[str, Any] = {
        "method": s.label,
        **s.method._asdict(),
        "seeds": " ".join(map(str, s.seeds)),
        "missing_seeds": " ".join(map(str, s.missing)),
    }
    for name, interval in s.intervals.items():
        keys = name, f"{name}_low", f"{name}_high"
        record |= zip(keys, interval, strict=True)
    printed = {f"paper_{name}": value for name, value in _paper(s)._asdict().items()}
    for name, value in {**s.means, **printed}.items():
        record |= zip((f"{name}_mean", f"{name}_std"), value, strict=True)
    return record


def _tex(text: str) -> str:
    for character in "&%_#":
        text = text.replace(character, rf"\{character}")
    return text.replace("±", r"$\pm$").replace(" - ", " $-$ ")


def _title(comparison: Comparison) -> str:
    table2 = any((s.method.task, s.method.tuner) in PAPER for s in comparison.summaries)
    task = TASKS.get(comparison.task, comparison.task)
    return f"{'Table II: p' if table2 else 'P'}erformance comparison on {task}"


def _setting(comparison: Comparison) -> str:
    when = "Each run at its end"
    if comparison.budget is not None:
        when = f"After {comparison.budget:,} environment steps"
    return f"{when}, {comparison.episodes} evaluation episodes shared by all runs."


if __name__ == "__main__":
    raise SystemExit(main())
