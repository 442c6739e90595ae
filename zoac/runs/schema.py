"""The run folder's schema: one writer, one reader.

A run folder `<runs_dir>/<task>/<tuner>/seed=<s>[/variant=<name>]` holds
    run.json        identity, resolved config and its hash, versions, machine; written first
    metrics.jsonl   one JSON object a line, `kind` "train" or "eval"; append-only
    responses.csv   signals of a final episode, for tasks that name them; see `zoac.runs.responses`
    checkpoint/     see `zoac.runs.checkpoint`
    result.json     the outcome; written last, atomically: a run is done when it exists
JSON has no word for what is not finite: such a number is written as null. In rows, and for costs
in a result, null is read as NaN.
Identity is read from `run.json`, never from folder names.
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zoac.config.settings import WITHOUT_EFFECT
from zoac.core.errors import RunFolderError

FORMAT = 1
RUN, METRICS, RESULT = "run.json", "metrics.jsonl", "result.json"
RESPONSES = "responses.csv"
CHECKPOINTS = "checkpoint"
JOURNAL = "journal.jsonl"
"""Of a study."""
TASK = "task.pkl"
"""The task of a run that was not started from a YAML file."""
OF_EVERY_RUN = (
    "task", "tuner", "seed", "variant", "config", "config_hash", "parameters", "fixed", "nominal",
    "versions", "machine", "commit",
)  # fmt: skip
"""Keys that every `run.json` has."""
IDENTITY = ("task", "tuner", "seed", "variant", "config_hash")
"""Keys on which a run's files must agree."""
OF_EVERY_RESULT = ("env_steps", "wall_seconds", "cost_mean", "cost_per_episode", "parameters")
"""Keys that every `result.json` has beside those."""


def config_hash(config: Mapping[str, Any]) -> str:
    """Return the hash of all that can change a run's numbers, seed included.

    A key that is null is as good as absent.
    """
    content = json.dumps(_with_effect(config), sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def differing_keys(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the dotted keys in which two configs differ in effect, with both values."""
    left, right = _flat(_with_effect(one)), _flat(_with_effect(other))
    absent = "(absent)"
    return {
        key: (left.get(key, absent), right.get(key, absent))
        for key in sorted(left.keys() | right.keys())
        if left.get(key, absent) != right.get(key, absent)
    }


def _with_effect(config: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in config.items() if k not in WITHOUT_EFFECT and v is not None}


def _flat(node: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(node, Mapping):
        return {prefix: node}
    flat: dict[str, Any] = {}
    for key, value in node.items():
        flat.update(_flat(value, f"{prefix}.{key}" if prefix else str(key)))
    return flat


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a crash leaves the old one or the new one, never a part."""
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError:  # a full disk, say: leave it no fuller
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make renames inside `folder` last through a power cut, where the system can."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write one JSON object atomically; see `plain`."""
    text = json.dumps(plain(content), indent=2, allow_nan=False)
    write_atomically(path, (text + "\n").encode())


def json_line(row: Mapping[str, Any]) -> str:
    """Return one row of `metrics.jsonl`, newline included; see `plain`."""
    return json.dumps(plain(row), allow_nan=False) + "\n"


def plain(value: Any) -> Any:
    """Return what JSON can hold: NumPy values as plain ones, None for what is not finite."""
    if isinstance(value, Mapping):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def read_run(folder: Path) -> dict[str, Any]:
    """Return `run.json`.

    Raises:
        RunFolderError: If it is missing, damaged, incomplete or of another format.
    """
    return _read_json(Path(folder) / RUN, OF_EVERY_RUN)


def read_result(folder: Path) -> dict[str, Any]:
    """Return `result.json`.

    Raises:
        RunFolderError: If it is missing (the run is not finished), damaged, of another format or
            of another run than `run.json`.
    """
    result, run = _read_json(Path(folder) / RESULT, OF_EVERY_RESULT), read_run(folder)
    for key in IDENTITY:
        if result.get(key) != run[key]:
            raise RunFolderError(
                f"{folder}: {RUN} and {RESULT} disagree on {key}: {run[key]!r} and "
                f"{result.get(key)!r}"
            )
    return {k: _numbers(v) if k in _COSTS else v for k, v in result.items()}


_COSTS = ("cost_mean", "cost_std", "cost_per_episode", "baseline_cost_mean")


def _numbers(value: Any) -> Any:
    """Return a number, or a list of numbers, with NaN where null stands for one."""
    if isinstance(value, list):
        return [math.nan if v is None else v for v in value]
    return math.nan if value is None else value


def is_done(folder: Path) -> bool:
    """Tell whether the run in `folder` has a result."""
    return (Path(folder) / RESULT).is_file()


def _read_json(path: Path, keys: Sequence[str]) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        reason = "the run is not finished" if path.name == RESULT else "not a run folder"
        raise RunFolderError(f"{path.parent}: there is no {path.name}; {reason}") from None
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{path}: cannot be read as JSON ({error})") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, dict) else None
        raise RunFolderError(f"{path}: format {found!r}, expected {FORMAT}")
    if missing := [key for key in keys if key not in content]:
        raise RunFolderError(f"{path}: a record without {', '.join(missing)}; zoac writes all")
    return content


def read_row(line: str) -> dict[str, Any]:
    """Return one line of `metrics.jsonl`.

    Raises:
        ValueError: If it is damaged.
    """
    row = json.loads(line)
    if not isinstance(row, dict) or "kind" not in row:
        raise ValueError("no row")
    return {key: _numbers(value) for key, value in row.items()}


def read_metrics(folder: Path) -> list[dict[str, Any]]:
    """Return the rows of `metrics.jsonl`; a last line cut by a crash is left out.

    Raises:
        RunFolderError: If the file is missing or a line other than the last is damaged.
    """
    path = Path(folder) / METRICS
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except FileNotFoundError:
        raise RunFolderError(f"{path.parent}: there is no {METRICS}; not a run folder") from None
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{path}: cannot be read ({error})") from None
    rows = []
    for number, line in enumerate(lines[:-1], start=1):
        try:
            rows.append(read_row(line))
        except ValueError:
            raise RunFolderError(f"{path}: line {number} is damaged") from None
    return rows
