"""Tuners at several budgets, as ratios: `python -m zoac.analysis.beyond runs --out tables`.

A run's cost is divided by a reference cost on the same evaluation episodes: that of the nominal
controller or, with `--reference best`, that of the best run. The table has one row per tuner and
variant and one column per budget, with mean ratio, worst ratio and number of seeds. A second table
has the terminations per 100,000 steps of tuning. The files are beyond.md and beyond.csv. In an
ablation each variant leaves one thing out.
"""

import argparse
from collections.abc import Callable, Collection, Sequence

import numpy as np
import pandas as pd

from zoac.analysis.data import cli
from zoac.analysis.data.fairness import refuse_mixed, refuse_unequal
from zoac.analysis.data.runs import Run
from zoac.analysis.figures.labels import TASKS, TUNERS
from zoac.analysis.pages.formatting import NOTHING, pipes
from zoac.core.errors import RunFolderError
from zoac.core.types import bad_is_infinite

REFERENCES = ("nominal", "best")
ASIDE = ("budget", "mpc_solver", "executor")
"""Keys of a variant that do not make a row of their own."""

ROW = ["tuner", "variant"]


@cli.command(
    "beyond", "Tuners at several budgets, as ratios.", "tables",
    task={"help": "default: all tasks"},
    reference={"choices": REFERENCES, "default": "nominal", "help": "default: nominal"},
    seeds={"metavar": "0-9", "type": cli.seeds, "help": "default: all"},
)  # fmt: skip
def main(options: argparse.Namespace) -> None:
    """Write one table per task."""
    collection = cli.load_runs(options, episodes=False)
    if options.task:
        collection = collection.of_task(options.task)
    finished = collection.some_finished()
    texts, frames = [], []
    for task in sorted({run.method.task for run in finished}):
        runs = [run for run in finished if run.method.task == task]
        base = reference_run(runs, options.reference)
        frame = table(runs, base, options.seeds)
        texts.append(markdown(task, frame, options.reference, base.cost_mean))
        frames.append(frame.assign(task=task))
    cli.write_markdown(options.out / "beyond.md", "\n".join(texts))
    columns = ["task", *frames[0].columns.drop("task")]
    records = pd.concat(frames).to_csv(columns=columns, index=False, lineterminator="\n")
    cli.write(options.out / "beyond.csv", records)


def reference_run(runs: Sequence[Run], reference: str) -> Run:
    """Return the run by whose cost the others are divided.

    Raises:
        RunFolderError: If there is no run with the nominal controller, or no ratio to that cost.
    """
    if reference == "best":
        chosen = min(runs, key=lambda run: float(bad_is_infinite(run.cost_mean)))
    else:
        nominal = [run for run in runs if not run.tuned]
        if not nominal:
            raise RunFolderError(
                f"no run of the nominal controller on {runs[0].method.task}; make one with "
                "tuner=nominal, or give --reference best, or another --task"
            )
        chosen = nominal[0]
    if not 0.0 < chosen.cost_mean < np.inf:
        raise RunFolderError(
            f"{chosen.folder}: its cost, {chosen.cost_mean:.4g}, cannot be the reference of a "
            "ratio, which needs a finite cost above zero; zoac.analysis.table2 tells differences"
        )
    return chosen


def table(
    runs: Sequence[Run], reference: Run, seeds: Collection[int] | None = None
) -> pd.DataFrame:
    """Return tuner, variant, budget, seed, ratio, and terminations per 100,000 steps of each run.

    The runs are finished ones of one task; those of other seeds do not count. The method that is
    best at its largest budget comes first.

    Raises:
        RunFolderError: If there is no such run, or if they or the reference are not comparable.
    """
    tuned = [run for run in runs if run.tuned]
    frame = pd.DataFrame(
        {
            "run": run,
            "tuner": run.method.tuner,
            "variant": _variant(run),
            "budget": int(run.config["budget"]),
            "seed": run.seed,
            "ratio": run.cost_mean / reference.cost_mean,
            "terminations": run.outcome.get("tuning_terminations", np.nan)
            / run.outcome["env_steps"]
            * 1e5,
        }
        for run in tuned
        if seeds is None or run.seed in seeds
    )  # fmt: skip
    if frame.empty:
        known = ", ".join(map(str, sorted({run.seed for run in tuned})))
        raise RunFolderError(
            f"no tuned run on {reference.method.task} with these seeds; "
            + (f"there are {known}" if known else "there is none at all")
        )
    _refuse_unfair(frame, reference)
    largest = frame.groupby(ROW)["budget"].transform("max")
    ranked = frame.assign(rank=bad_is_infinite(frame["ratio"]))[frame["budget"] == largest]
    rank = ranked.groupby(ROW)["rank"].mean()
    ordered = frame.join(rank, on=ROW).sort_values(["rank", *ROW, "budget", "seed"])
    return ordered.drop(columns=["run", "rank"])


def _refuse_unfair(frame: pd.DataFrame, reference: Run) -> None:
    for (*_, budget, seed), same in frame.groupby([*ROW, "budget", "seed"], sort=False):
        if len(same) > 1:
            one, other, *_ = (run.folder for run in same["run"])
            raise RunFolderError(
                f"two runs of the same row, budget {budget} and seed {seed}: {one} and {other}; "
                f"{', '.join(ASIDE)} tell no rows apart, so move one away"
            )
    for _, cell in frame.groupby([*ROW, "budget"], sort=False):
        refuse_mixed(list(cell["run"]))
    for _, same_budget in frame.groupby("budget", sort=False):
        refuse_unequal(list(same_budget["run"]))
    refuse_unequal([reference, *frame["run"]], any_budget=True)


def markdown(task: str, frame: pd.DataFrame, reference: str, cost: float) -> str:
    """Return a Markdown table of ratios under a title, and one of terminations if recorded."""
    against = "the nominal controller" if reference == "nominal" else "the best run"
    text = (
        f"## {TASKS.get(task, task)}\n\n"
        f"Cost over that of {against} ({cost:.4g}) on the same episodes: mean, worst seed, (number "
        f"of seeds).\n\n{_lines(frame, 'ratio', _ratios)}\n"
    )
    if notes := _not_finite(frame):
        text += "\n" + "\n".join(f"- {note}" for note in notes) + "\n"
    if frame["terminations"].isna().all():
        return text
    return (
        f"{text}\nTerminations per 100,000 steps of tuning: mean of the seeds.\n\n"
        f"{_lines(frame, 'terminations', _mean)}\n"
    )


def _lines(frame: pd.DataFrame, column: str, cell: Callable[[pd.Series], str]) -> str:
    """Return a row per method and a column per budget, each cell of its seeds' values."""
    budgets = sorted(frame["budget"].unique())
    lines = [["Tuner", *(f"{budget:,} steps" for budget in budgets)]]
    for (tuner, variant), row in frame.groupby(ROW, sort=False):
        cells = [row.loc[row["budget"] == budget, column] for budget in budgets]
        texts = (cell(values) if len(values) else NOTHING for values in cells)
        lines.append([_label(tuner, variant), *texts])
    return pipes(lines)


def _label(tuner: object, variant: object) -> str:
    return TUNERS.get(str(tuner), str(tuner)) + (f" [{variant}]" if variant else "")


def _ratios(values: pd.Series) -> str:
    if not np.isfinite(values).all():
        return f"{NOTHING} ({len(values)})"
    mean, worst = (f"{v:.3f}" if v < 10 else f"{v:.3g}" for v in (values.mean(), values.max()))
    return f"{mean}, {worst} ({len(values)})"


def _not_finite(frame: pd.DataFrame) -> list[str]:
    """Return a note for each cell with seeds whose cost is not finite."""
    lost = frame[~np.isfinite(frame["ratio"])]
    return [
        f"{_label(tuner, variant)}, {budget:,} steps: the cost of seed "
        f"{', '.join(map(str, seeds))} is not finite; nothing is averaged"
        for (tuner, variant, budget), seeds in lost.groupby([*ROW, "budget"], sort=False)["seed"]
    ]


def _mean(values: pd.Series) -> str:
    known = values.dropna()
    return f"{known.mean():.3g}" if len(known) else NOTHING


def _variant(run: Run) -> str:
    parts = (run.method.variant or "").split(",")
    return ",".join(part for part in parts if part.partition("=")[0] not in ASIDE)


if __name__ == "__main__":
    raise SystemExit(main())
