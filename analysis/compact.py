"""Runs in three small files: `python -m zoac.analysis.compact runs --out results`.

Every other command reads such a folder like the runs themselves. What is kept: of each finished run
its whole result; of its evaluations while tuning the metrics and each episode's cost; of its
configuration one copy for all seeds of a method. What is not: training rows, commands, dates, and,
without `--parameters`, the parameters while tuning, which `zoac.analysis.landscape` draws.
`--summary` keeps less: of each run one row with means over the episodes, which is what
`zoac.analysis.beyond` needs.

    runs.csv         one row per run: task, tuner, variant, seed, and its result
    evaluations.csv  one row per evaluation while tuning
    methods.json     what run.json says, one record per method
"""

import argparse
import csv
import io
import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from zoac.analysis.data import cli
from zoac.analysis.data.fairness import unmixed
from zoac.analysis.data.runs import Run
from zoac.core.errors import RunFolderError, as_text
from zoac.runs.schema import config_hash

RUNS, EVALUATIONS, METHODS = "runs.csv", "evaluations.csv", "methods.json"

TEXTS = ("task", "tuner", "variant")
KEY = (*TEXTS, "seed")
"""What tells runs apart."""

LISTS = ("cost_per_episode", "episode_lengths")

PARAMETER = "parameters."
"""Begins the names of columns of parameters."""

TIMES = "*"
"""In a list, 200*3 is 200 200 200."""

OF_ONE_RUN = ("seed", "config_hash", "command", "started")
"""Keys of run.json that belong to a single run."""

OF_ONE_LAUNCH = ("seed", "runs_dir")
"""Keys of a configuration that say which run it was and where, not how."""

LEFT_OUT = ("x", "config_hash", "format")
"""Of a result: what follows from parameters and run.json."""

OF_ONE_EVALUATION = ("kind", "final", "parameters", "episode_lengths", "baseline_cost_mean")
"""Of an evaluation while tuning: what is not kept."""
_APART = "evaluations while tuning at least so far apart; default: all"
_MEANS = "no evaluations while tuning, and of results no single episodes"
_DIGITS = (
    "significant digits; default: of evaluations while tuning six, of results all, so that they "
    "come back exactly"
)


@cli.command(
    "compact", "Runs in three small files.", "compact",
    every={"type": cli.count, "default": 1, "metavar": "STEPS", "help": _APART},
    summary={"action": "store_true", "help": _MEANS},
    parameters={"action": "store_true", "help": "also the parameters of evaluations while tuning"},
    digits={"type": cli.count, "metavar": "N", "help": _DIGITS},
)  # fmt: skip
def main(options: argparse.Namespace) -> None:
    """Write the three files."""
    runs = cli.load_runs(options, episodes=not options.summary).some_finished()
    left_out = (*LEFT_OUT, *((*LISTS, "baseline") if options.summary else ()))
    evaluated = () if options.summary else runs
    files = {
        RUNS: _csv([_row(run, run.outcome, left_out) for run in runs], options.digits),
        EVALUATIONS: evaluations_csv(evaluated, options.every, options.digits, options.parameters),
        METHODS: methods_json(runs),
    }
    for name, content in files.items():
        cli.write(options.out / name, content)


def evaluations_csv(
    runs: Iterable[Run], every: int = 1, digits: int | None = None, parameters: bool = False
) -> str:
    """Return one row per evaluation while tuning, at least `every` steps apart."""
    left_out = {*OF_ONE_EVALUATION, *LEFT_OUT} - ({"parameters"} if parameters else set())
    rows = []
    for run in runs:
        due = 0
        for row in run.evaluations if run.tuned else ():
            if row["env_steps"] >= due:
                due = row["env_steps"] // every * every + every
                rows.append(_row(run, row, left_out))
    return _csv(rows, digits or 6)


def methods_json(runs: Iterable[Run]) -> str:
    """Return what run.json says of each method, one a line.

    Raises:
        RunFolderError: If seeds of a method differ in their configuration.
    """
    lines = []
    for group in unmixed(runs).values():
        record = {k: v for k, v in group[0].identity.items() if k not in OF_ONE_RUN}
        config = {k: v for k, v in record["config"].items() if k not in OF_ONE_LAUNCH}
        lines.append(json.dumps(record | {"config": config}))
    return "[\n" + ",\n".join(lines) + "\n]\n"


def _row(run: Run, record: Mapping[str, Any], left_out: Collection[str]) -> dict[str, Any]:
    """Return the key of a run and what a record says, parameters last, as `_rows` reads it."""
    row = {key: run.identity[key] for key in KEY}
    row |= {k: v for k, v in record.items() if k not in (*KEY, *left_out, "parameters")}
    named = {} if "parameters" in left_out else record.get("parameters", {})
    return row | {f"{PARAMETER}{name}": value for name, value in named.items()}


def _csv(rows: Sequence[Mapping[str, Any]], digits: int | None) -> str:
    out = io.StringIO()
    columns = dict.fromkeys(key for row in rows for key in row)
    writer = csv.DictWriter(out, list(columns), restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({c: _cell(c, value, digits) for c, value in row.items()} for row in rows)
    return out.getvalue()


def _cell(column: str, value: Any, digits: int | None) -> str:
    if column in TEXTS:
        return value or ""
    if column in LISTS:
        repeated = groupby(_cell("", entry, digits) for entry in value)
        counted = ((text, len(list(same))) for text, same in repeated)
        return " ".join(text if times == 1 else f"{text}{TIMES}{times}" for text, times in counted)
    if digits is not None and isinstance(value, float) and math.isfinite(value):
        return f"{value:.{digits}g}"
    return json.dumps(value)  # which has words for what is not finite


def read(folder: Path) -> list[Run]:
    """Return the runs of a folder.

    Raises:
        RunFolderError: If its three files cannot be read together.
    """
    try:
        return list(_read(folder))
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise RunFolderError(
            f"{folder}: its {RUNS}, {EVALUATIONS} and {METHODS} cannot be read together "
            f"({as_text(error)}); write them anew with python -m "
            "zoac.analysis.compact"
        ) from None


def _read(folder: Path) -> Iterator[Run]:
    records = json.loads((folder / METHODS).read_text(encoding="utf-8"))
    methods = {tuple(record[key] for key in TEXTS): record for record in records}
    evaluations: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for key, row in _rows(folder / EVALUATIONS):
        evaluations.setdefault(key, []).append({"kind": "eval", "final": False, **row})
    for key, row in _rows(folder / RUNS):
        method, seed = methods[key[:-1]], key[-1]
        config = {**method["config"], "seed": seed}
        shared = {"config": config, "config_hash": config_hash(config)}
        result = {"parameters": {}, **row, "config_hash": shared["config_hash"]}
        yield Run(
            folder / "-".join(str(part) for part in key if part is not None),
            {**method, "seed": seed, **shared},
            [*evaluations.get(key, []), {"kind": "eval", "final": True, **result}],
            result,
        )


def _rows(path: Path) -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
    """Yield the key of each row and the row, with its parameters by name if it has any."""
    text = path.read_bytes().decode("utf-8")
    if not text.endswith("\n"):
        raise ValueError(f"the end of {path.name} is lost")
    for number, cells in enumerate(csv.DictReader(io.StringIO(text, newline="")), start=2):
        if None in cells or None in cells.values():
            raise ValueError(f"{path.name}, row {number} has not the columns of the first")
        row = {n: _value(n, cell) for n, cell in cells.items() if cell != "" or n == "variant"}
        columns = [name for name in row if name.startswith(PARAMETER)]
        if named := {name.removeprefix(PARAMETER): row.pop(name) for name in columns}:
            row["parameters"] = named
        yield tuple(row[name] for name in KEY), row


def _value(name: str, cell: str) -> Any:
    if name in TEXTS:
        return cell or None
    if name in LISTS:
        parts = (part.partition(TIMES) for part in cell.split(" "))
        return [v for value, _, times in parts for v in [json.loads(value)] * int(times or 1)]
    return json.loads(cell)


if __name__ == "__main__":
    raise SystemExit(main())
