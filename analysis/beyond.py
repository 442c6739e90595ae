"""Tuners at several budgets, as ratios: `python -m zoac.analysis.beyond runs --out tables`.

A run's cost is divided by a reference cost on the same evaluation episodes: that of the nominal
controller or, with `--reference best`, that of the best run there is. One row per tuner and
variant, one column per budget: mean ratio, worst ratio, number of seeds. Writes beyond.md and
beyond.csv; an ablation is a table whose variants leave one thing out each. A second table has the
terminations per 100,000 steps of tuning: what the search did to the plant.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
import pandas as pd

from zoac.analysis import cli
from zoac.analysis.data.fairness import refuse_mixed, refuse_unequal
from zoac.analysis.data.runs import Run
from zoac.analysis.figures.labels import TASKS, TUNERS
from zoac.analysis.pages.formatting import NOTHING, pipes
from zoac.core.errors import RunFolderError

REFERENCES = ("nominal", "best")
ASIDE = ("budget", "mpc_solver", "executor")
"""Keys of a variant that name no method: the columns, and what moves no plan."""


class Row(NamedTuple):
    """A method, and what its seeds reached at each budget."""

    tuner: str
    variant: str
    outcomes: Mapping[int, Mapping[int, Outcome]]  # budget -> seed


class Outcome(NamedTuple):
    """Of one run: its ratio, and terminations per 100,000 steps (None: not recorded)."""

    ratio: float
    terminations: float | None


def main(argv: Sequence[str] | None = None) -> int:
    """Write one table per task; return the exit code."""
    parser = cli.parser("beyond", "Tuners at several budgets, as ratios.", out="tables")
    parser.add_argument("--task", help="default: every task there is")
    parser.add_argument(
        "--reference", choices=REFERENCES, default="nominal", help="default: nominal"
    )
    parser.add_argument("--seeds", metavar="0-9", type=cli.seeds, help="default: all")
    return cli.guarded(_command, parser, argv)


def _command(options: argparse.Namespace) -> None:
    collection = cli.load_aloud(options.runs, episodes=False)
    if options.task:
        collection = collection.of_task(options.task)
    finished = collection.some_finished()
    texts, frames = [], []
    for task in sorted({run.method.task for run in finished}):
        runs = [run for run in finished if run.method.task == task]
        base = reference_run(runs, options.reference)
        rows = table(runs, base, options.seeds)
        texts.append(markdown(task, rows, options.reference, base.cost_mean))
        frames.append(frame(task, rows))
    text = "\n".join(texts)
    print(text)
    folder = cli.output_folder(options.out)
    cli.write(folder / "beyond.md", text)
    records = pd.concat(frames, ignore_index=True)
    cli.write(folder / "beyond.csv", records.to_csv(index=False, lineterminator="\n"))


def reference_run(runs: Sequence[Run], reference: str) -> Run:
    """Return the run by whose cost others are divided.

    Raises:
        RunFolderError: If there is no run with the nominal controller.
    """
    if reference == "best":
        return min(runs, key=lambda run: run.cost_mean)
    nominal = [run for run in runs if not run.tuned]
    if not nominal:
        raise RunFolderError(
            f"no run of the nominal controller on {runs[0].method.task}; make one with "
            "tuner=nominal, or give --reference best, or another --task"
        )
    return nominal[0]


def table(runs: Sequence[Run], reference: Run, seeds: Collection[int] | None = None) -> list[Row]:
    """Return the rows, best at the largest budget first.

    Args:
        runs: Finished runs of one task.
        reference: The run by whose cost theirs are divided.
        seeds: Those to count; all by default.

    Raises:
        RunFolderError: If there is none, two are of the same row, budget and seed, or seeds,
            methods or the reference differ in what they must share.
    """
    cells: dict[tuple[str, str, int], dict[int, Run]] = {}
    for run in runs:
        if not run.tuned or (seeds is not None and run.seed not in seeds):
            continue
        budget = int(run.config["budget"])
        cell = cells.setdefault((run.method.tuner, _variant(run), budget), {})
        other = cell.setdefault(run.seed, run)
        if other is not run:
            raise RunFolderError(
                f"two runs of the same row, budget {budget} and seed {run.seed}: {other.folder} "
                f"and {run.folder}; {', '.join(ASIDE)} tell no rows apart, so move one away"
            )
    if not cells:
        known = ", ".join(map(str, sorted({run.seed for run in runs if run.tuned})))
        raise RunFolderError(
            f"no tuned run on {reference.method.task} with these seeds; "
            + (f"there are {known}" if known else "there is none at all")
        )
    _refuse_unfair([list(cell.values()) for cell in cells.values()], reference)
    found: dict[tuple[str, str], dict[int, dict[int, Outcome]]] = {}
    for (tuner, variant, budget), cell in cells.items():
        found.setdefault((tuner, variant), {})[budget] = {
            seed: _outcome(run, reference) for seed, run in cell.items()
        }
    rows = [Row(tuner, variant, outcomes) for (tuner, variant), outcomes in found.items()]
    return sorted(rows, key=lambda row: _ratios(row.outcomes[max(row.outcomes)]).mean())


def _refuse_unfair(cells: Sequence[Sequence[Run]], reference: Run) -> None:
    compared: dict[int, list[Run]] = {}
    for cell in cells:
        refuse_mixed(cell)
        compared.setdefault(int(cell[0].config["budget"]), []).extend(cell)
    for same_budget in compared.values():
        refuse_unequal(same_budget)
    refuse_unequal([reference, *chain.from_iterable(cells)], any_budget=True)


def markdown(task: str, rows: Sequence[Row], reference: str, cost: float) -> str:
    """Return a Markdown table of ratios under a title, and one of terminations if recorded."""
    against = "the nominal controller" if reference == "nominal" else "the best run"
    text = (
        f"## {TASKS.get(task, task)}\n\n"
        f"Cost over that of {against} ({cost:.4g}) on the same episodes: mean, worst seed, (number "
        f"of seeds).\n\n{_lines(rows, _ratio_cell)}\n"
    )
    if all(_terminated(o) is None for row in rows for o in row.outcomes.values()):
        return text
    return (
        f"{text}\nTerminations per 100,000 steps of tuning: mean of the seeds.\n\n"
        f"{_lines(rows, _termination_cell)}\n"
    )


def _lines(rows: Sequence[Row], cell: Callable[[Mapping[int, Outcome]], str]) -> str:
    budgets = sorted({budget for row in rows for budget in row.outcomes})
    lines = [["Tuner", *(f"{budget:,} steps" for budget in budgets)]]
    for row in rows:
        label = TUNERS.get(row.tuner, row.tuner) + (f" [{row.variant}]" if row.variant else "")
        lines.append([label, *(cell(row.outcomes.get(budget, {})) for budget in budgets)])
    return pipes(lines)


def frame(task: str, rows: Sequence[Row]) -> pd.DataFrame:
    """Return one row per run: task, tuner, variant, budget, seed, ratio, terminations."""
    return pd.DataFrame(
        [
            {
                "task": task,
                "tuner": row.tuner,
                "variant": row.variant,
                "budget": budget,
                "seed": seed,
                **outcome._asdict(),
            }
            for row in rows
            for budget, outcomes in sorted(row.outcomes.items())
            for seed, outcome in sorted(outcomes.items())
        ]
    )


def _outcome(run: Run, reference: Run) -> Outcome:
    count = run.outcome.get("tuning_terminations")
    terminations = None if count is None else count / run.outcome["env_steps"] * 1e5
    return Outcome(run.cost_mean / reference.cost_mean, terminations)


def _ratios(outcomes: Mapping[int, Outcome]) -> np.ndarray:
    return np.array([outcome.ratio for outcome in outcomes.values()])


def _ratio_cell(outcomes: Mapping[int, Outcome]) -> str:
    if not outcomes:
        return NOTHING
    ratios = _ratios(outcomes)
    return f"{_ratio(ratios.mean())}, {_ratio(ratios.max())} ({len(ratios)})"


def _terminated(outcomes: Mapping[int, Outcome]) -> float | None:
    known = [o.terminations for o in outcomes.values() if o.terminations is not None]
    return float(np.mean(known)) if known else None


def _termination_cell(outcomes: Mapping[int, Outcome]) -> str:
    mean = _terminated(outcomes)
    return NOTHING if mean is None else f"{mean:.3g}"


def _ratio(value: float) -> str:
    return f"{value:.3f}" if value < 10 else f"{value:.3g}"


def _variant(run: Run) -> str:
    parts = (run.method.variant or "").split(",")
    return ",".join(part for part in parts if part.partition("=")[0] not in ASIDE)


if __name__ == "__main__":
    raise SystemExit(main())
