"""Runs in three small files: `python -m zoac.analysis.compact runs --out results`.

Every other command reads such a folder like the runs themselves. What is kept: of each finished run
its whole result; of its evaluations while tuning the metrics and each episode's cost; of its
configuration one copy for all seeds of a method. What is not: parameters while tuning, training
rows, commands, dates. `--summary` keeps less: of each run one row with means over the episodes,
which is what `zoac.analysis.beyond` needs.

    runs.csv         one row per run: task, tuner, variant, seed, and its result
    evaluations.csv  one row per evaluation while tuning
    methods.json     what run.json says, one record per method
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import groupby
from typing import Any

from zoac.analysis import cli
from zoac.analysis.data.compact_format import (
    EVALUATIONS,
    KEY,
    LISTS,
    METHODS,
    RUNS,
    SHARED,
    TEXTS,
    TIMES,
)
from zoac.analysis.data.fairness import refuse_mixed
from zoac.analysis.data.runs import Run, by_method

OF_ONE_RUN = ("seed", "config_hash", "command", "started")
"""Keys of run.json that belong to a single run."""

LEFT_OUT = ("x", "config_hash", "format")
"""Of a result: what follows from parameters and run.json."""

OF_ONE_EVALUATION = ("kind", "final", "parameters", "episode_lengths")
"""Of an evaluation while tuning: what is not kept."""

WORTH_SHARING = 30
"""Characters from which a value that several methods have is written only once."""


def main(argv: Sequence[str] | None = None) -> int:
    """Write the three files; return the exit code."""
    parser = cli.parser("compact", "Runs in three small files.", out="compact")
    parser.add_argument(
        "--every",
        type=cli.count,
        default=1,
        metavar="STEPS",
        help="evaluations while tuning at least so far apart; default: all",
    )
    parser.add_argument(
        "--summary",
        action="store_true",
        help="no evaluations while tuning, and of results no single episodes",
    )
    parser.add_argument(
        "--digits",
        type=cli.count,
        metavar="N",
        help="significant digits; default: of evaluations while tuning six, of results all, so "
        "that they come back exactly",
    )
    return cli.guarded(_command, parser, argv)


def _command(options: argparse.Namespace) -> None:
    runs = cli.load_aloud(options.runs, episodes=not options.summary).some_finished()
    left_out = (*LISTS, "baseline") if options.summary else ()
    evaluated = () if options.summary else runs
    files = {
        RUNS: runs_csv(runs, options.digits, left_out),
        EVALUATIONS: evaluations_csv(evaluated, options.every, options.digits),
        METHODS: methods_json(runs),
    }
    folder = cli.output_folder(options.out)
    for name, content in files.items():
        cli.write(folder / name, content)


def runs_csv(runs: Iterable[Run], digits: int | None = None, left_out: Sequence[str] = ()) -> str:
    """Return one row per run, without some of its result's keys.

    Numbers have so many significant digits, or all.
    """
    rows = []
    for run in runs:
        result = {k: v for k, v in run.outcome.items() if k not in (*KEY, *LEFT_OUT, *left_out)}
        parameters = result.pop("parameters")
        rows.append(
            {
                **{key: run.identity[key] for key in KEY},
                **result,
                **{f"parameters.{name}": value for name, value in parameters.items()},
            }
        )
    return _csv(rows, exact if digits is None else partial(rounded, digits=digits))


def evaluations_csv(runs: Iterable[Run], every: int = 1, digits: int | None = None) -> str:
    """Return one row per evaluation while tuning, at least `every` steps apart."""
    rows = [
        {
            **{key: run.identity[key] for key in KEY},
            **{k: v for k, v in row.items() if k not in (*OF_ONE_EVALUATION, *LEFT_OUT)},
        }
        for run in runs
        if run.tuned
        for row in _apart(run.evaluations, every)
    ]
    return _csv(rows, partial(rounded, digits=digits or 6))


def _apart(rows: Iterable[Mapping[str, Any]], every: int) -> Iterator[Mapping[str, Any]]:
    due = 0
    for row in rows:
        if row["env_steps"] >= due:
            due = row["env_steps"] // every * every + every
            yield row


def methods_json(runs: Iterable[Run]) -> str:
    """Return what run.json says of each method; what several say stands there once.

    Raises:
        RunFolderError: If seeds of a method differ in their configuration.
    """
    records = []
    for group in by_method(runs).values():
        refuse_mixed(group)
        record = {k: v for k, v in group[0].identity.items() if k not in OF_ONE_RUN}
        record["config"] = {k: v for k, v in record["config"].items() if k != "seed"}
        records.append(record)
    times = Counter(map(json.dumps, (v for r in records for v in (r | r["config"]).values())))
    shared = [text for text, count in times.items() if count > 1 and len(text) > WORTH_SHARING]

    def once(values: Mapping[str, Any]) -> dict[str, Any]:
        texts = {key: json.dumps(value) for key, value in values.items()}
        return {
            key: {SHARED: shared.index(texts[key])} if texts[key] in shared else value
            for key, value in values.items()
        }

    lines = [json.dumps(once(record | {"config": once(record["config"])})) for record in records]
    return f'{{"{SHARED}": {_lines(shared)},\n"methods": {_lines(lines)}}}\n'


def _lines(items: Iterable[str]) -> str:
    return "[\n" + ",\n".join(items) + "\n]"


def exact(value: Any) -> str:
    """Return a cell that reads back to the same bits."""
    return json.dumps(value)


def rounded(value: Any, digits: int = 6) -> str:
    """Return a cell of so many significant digits."""
    # JSON has its own words for what is not finite.
    short = isinstance(value, float) and math.isfinite(value)
    return f"{value:.{digits}g}" if short else json.dumps(value)


def _csv(rows: Sequence[Mapping[str, Any]], number: Callable[[Any], str]) -> str:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    for row in rows:
        writer.writerow([_cell(c, row[c], number) if c in row else "" for c in columns])
    return out.getvalue()


def _cell(column: str, value: Any, number: Callable[[Any], str]) -> str:
    if column in TEXTS:
        return value or ""
    if column in LISTS:
        parts = ((part, len(list(same))) for part, same in groupby(map(number, value)))
        return " ".join(part if times == 1 else f"{part}{TIMES}{times}" for part, times in parts)
    return number(value)


if __name__ == "__main__":
    raise SystemExit(main())
