"""The folder of a study, which is a run folder with a journal.

run.json        identity and settings; written first
journal.jsonl   see `zoac.study.state.journal`
metrics.jsonl   and
result.json     what report, curves and tables read; made from the journal at the end
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from zoac.core.errors import RunFolderError
from zoac.runs import schema
from zoac.runs.lock import locked
from zoac.runs.provenance import here_and_now
from zoac.study.proposals import check
from zoac.study.state.settings import StudySettings
from zoac.study.state.trial import Trial


def opened(
    folder: Path,
    settings: StudySettings | None,
    trial_timeout: float | None,
    called: Mapping[str, str | None],
) -> tuple[StudySettings, float | None]:
    """Return settings and time limit of the study in a folder, which is begun if there is none.

    Args:
        folder: Of the study.
        settings: What the caller wants; None: whatever is there.
        trial_timeout: Seconds; None: those with which the study was begun.
        called: `task` and `variant` of a study that is begun, for tables.

    Raises:
        RunFolderError: If the folder holds something else, or cannot be used.
    """
    if settings is not None and not (folder / schema.RUN).exists():
        _begin(folder, settings, trial_timeout, called)
    if not (folder / schema.RUN).is_file():
        raise RunFolderError(f"there is no study in {folder}; create it, or name its folder")
    record = schema.read_run(folder)
    if "study" not in record:
        raise RunFolderError(f"{folder} holds a run, not a study; choose another folder")
    found = StudySettings(record["config"], record["tuner"])
    wanted = found if settings is None else settings
    if differences := schema.differing_keys(found.config, wanted.config):
        listed = "".join(f"\n  {key}: {a!r}, now {b!r}" for key, (a, b) in differences.items())
        raise RunFolderError(
            f"{folder} holds a study of other settings:{listed}\nuse those, or another folder"
        )
    return found, trial_timeout or record["study"]["trial_timeout"]


def _begin(
    folder: Path, settings: StudySettings, timeout: float | None, called: Mapping[str, str | None]
) -> None:
    """Write `run.json`, unless another process does so first."""
    tuner = check(settings)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with locked(folder / ".lock", wait=True):
            if not (folder / schema.RUN).exists():
                record = {
                    "format": schema.FORMAT,
                    "tuner": settings.tuner,
                    "seed": settings.config["seed"],
                    "config": settings.config,
                    "config_hash": schema.config_hash(settings.config),
                    "command": list(sys.argv),
                    "objective": "the cost that is told",
                    "tuner_choices": {},
                    "parameters": [asdict(p) for p in settings.space.parameters],
                    "fixed": settings.fixed,
                    "nominal": settings.baseline,
                    **here_and_now(),
                    "study": {"trial_timeout": timeout},
                    "tuner_name": tuner.display_name or settings.tuner,
                    **called,
                }
                schema.write_json(folder / schema.RUN, record)
    except OSError as error:
        raise RunFolderError(
            f"cannot make or use the folder {folder}: {error.strerror}; choose another"
        ) from None


def write_result(
    folder: Path, found: Mapping[str, Any], trials: Sequence[Trial], best: Trial
) -> None:
    """Write `metrics.jsonl` and `result.json` of a finished study, whose result is `found`."""
    rows = [*_improvements(trials), {**_row(best, trials), "final": True}]
    lines = "".join(map(schema.json_line, rows))
    schema.write_atomically(folder / schema.METRICS, lines.encode())
    run = schema.read_run(folder)
    identity = {k: run[k] for k in ("format", "task", "tuner", "seed", "variant", "config_hash")}
    schema.write_json(folder / schema.RESULT, {**identity, **found})


def result(settings: StudySettings, trials: Sequence[Trial], best: Trial) -> dict[str, Any]:
    """Return what a result says of a study, finished or not."""
    bad = [t for t in trials if t.state in ("failed", "abandoned")]
    found = {
        **_row(best, trials),
        "experiments": len(trials),
        "best_trial": best.number,
        "failures": len(bad),
        "first_failure": bad[0].reason if bad else None,
        "warnings": [],
    }
    del found["kind"]
    if settings.baseline_first and trials:
        # If the first failed, the acceptance test may have measured the baseline values later.
        first, *later = (t for t in trials if t.x == trials[0].x)
        good = [t for t in later if t.cost is not None] if first.cost is None else [first]
        found["baseline_cost_mean"] = None
        if good:
            found["baseline_cost_mean"] = mean = float(np.mean([t.rank[1] for t in good]))
            found["baseline"] = {"cost_mean": mean, **good[0].metrics}
    if best.violation > 0:
        found["warnings"] += ["no experiment kept all constraints; the answer breaks them least"]
    same = [t for t in trials if t.x == best.x and not t.pending]
    if failed := [t.number for t in same if t.state == "failed"]:
        found["warnings"] += [
            f"The answer failed in {len(failed)} of its {len(same)} experiments, the first is "
            f"experiment {failed[0]}."
        ]
    return found


def _improvements(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """Return a row for the first success and for every better one, by number."""
    rows: list[dict[str, Any]] = []
    best = (math.inf, math.inf)
    for count, trial in enumerate(trials, start=1):
        if trial.state == "told" and trial.rank < best:
            best = trial.rank
            rows.append({**_row(trial, trials[:count]), "final": False})
    return rows


def _row(best: Trial, trials: Sequence[Trial]) -> dict[str, Any]:
    """Return an evaluation row: the best of so many experiments, measured as often as it was."""
    costs = [t.cost for t in trials if t.state == "told" and t.x == best.x]
    values = np.array(costs, dtype=np.float64)
    ended = [t.ended for t in trials if t.ended is not None]
    return {
        "kind": "eval",
        "env_steps": len(trials),
        "wall_seconds": round(max(ended, default=0.0) - trials[0].asked, 3),
        "cost_mean": float(values.mean()) if len(values) else math.nan,
        "cost_std": float(values.std(ddof=1)) if len(values) > 1 else 0.0,
        "cost_per_episode": costs,
        "episode_lengths": [1] * len(costs),
        "terminations": 0,
        **best.metrics,
        "parameters": best.parameters,
        "x": list(best.x),
    }
