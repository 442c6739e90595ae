"""What `zoac.analysis.compact` wrote, read back."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from zoac.runs.schema import config_hash

RUNS, EVALUATIONS, METHODS = "runs.csv", "evaluations.csv", "methods.json"

KEY = ("task", "tuner", "variant", "seed")
"""What tells runs apart."""

TEXTS = ("task", "tuner", "variant")
LISTS = ("cost_per_episode", "episode_lengths")

TIMES = "*"
"""In a list, 200*3 is 200 200 200."""

SHARED = "shared"
"""In methods.json, {"shared": 3} is the fourth of the values that several methods have."""


class Record(NamedTuple):
    """One run: run.json without what belongs to the run alone, metrics.jsonl, result.json."""

    name: str
    identity: dict[str, Any]
    metrics: list[dict[str, Any]]
    result: dict[str, Any]


def is_compact(folder: Path) -> bool:
    """Tell whether `folder` holds runs in this form."""
    return (folder / RUNS).is_file()


def read(folder: Path) -> Iterator[Record]:
    """Yield the runs of a folder."""
    methods = {(m["task"], m["tuner"], m["variant"]): m for m in _methods(folder / METHODS)}
    evaluations: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in _rows(folder / EVALUATIONS):
        evaluations.setdefault(_key(row), []).append({"kind": "eval", "final": False, **row})
    for row in _rows(folder / RUNS):
        parameters = {
            name.removeprefix("parameters."): row.pop(name)
            for name in [name for name in row if name.startswith("parameters.")]
        }
        method, seed = methods[row["task"], row["tuner"], row["variant"]], row["seed"]
        config = {**method["config"], "seed": seed}
        hashed = config_hash(config)
        identity = {**method, "seed": seed, "config": config, "config_hash": hashed}
        result = {**row, "parameters": parameters, "config_hash": hashed}
        last = {"kind": "eval", "final": True, **result}
        name = "-".join(str(part) for part in _key(row) if part is not None)
        yield Record(name, identity, [*evaluations.get(_key(row), []), last], result)


def _methods(path: Path) -> Iterator[dict[str, Any]]:
    content = json.loads(path.read_text(encoding="utf-8"))
    shared = content[SHARED]

    def whole(values: Mapping[str, Any]) -> dict[str, Any]:
        return {
            key: shared[value[SHARED]] if isinstance(value, dict) and SHARED in value else value
            for key, value in values.items()
        }

    for method in content["methods"]:
        yield whole(method) | {"config": whole(method["config"])}


def _key(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(row[key] for key in KEY)


def _rows(path: Path) -> list[dict[str, Any]]:
    text = path.read_bytes().decode("utf-8")
    if not text.endswith("\n"):
        raise ValueError(f"the end of {path.name} is lost")
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    for number, row in enumerate(rows, start=2):
        if None in row or None in row.values():
            raise ValueError(f"{path.name}, row {number} has not the columns of the first")
    return [
        {name: _value(name, cell) for name, cell in row.items() if cell != "" or name == "variant"}
        for row in rows
    ]


def _value(name: str, cell: str) -> Any:
    if name in TEXTS:
        return cell or None
    if name in LISTS:
        parts = (part.partition(TIMES) for part in cell.split(" "))
        return [v for value, _, times in parts for v in [json.loads(value)] * int(times or 1)]
    return json.loads(cell)
