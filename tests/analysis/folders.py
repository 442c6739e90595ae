"""Run folders made to measure, in the schema of `zoac.runs.schema`."""

import json
from typing import Any

import numpy as np

from zoac.runs import schema

PID = {
    "_target_": "zoac.tasks.pid_acc.PidAcc",
    "preceding_std": 0.05,
    "jerk": "rate",
    "max_episode_steps": 40,
}
GAINS = {"k": 2.0, "Kp": 1.0, "Ki": 0.1, "Kd": 3.0}
NOMINAL = {"k": 2.492, "Kp": 0.8307, "Ki": 0.0, "Kd": 3.1173}
SPACE = [{"name": n, "low": 0.0, "high": 10.0, "scale": "linear", "unit": ""} for n in GAINS]


def write_run(
    root,
    tuner="zoac",
    seed=0,
    *,
    task="pid_acc",
    variant=None,
    costs=(3.0, 4.0, 5.0, 6.0),
    evaluations=((0, 50.0), (500, 10.0)),
    finished=True,
    config=None,
    gains=None,
    result=None,
):
    """Write a run folder and return it.

    Its evaluations while tuning are pairs of steps and mean cost, of two episodes each; `costs` are
    those of the final episodes. `config` and `result` hold keys that differ from the default.
    """
    folder = root / task / tuner / f"seed={seed}" / (f"variant={variant}" if variant else "")
    folder.mkdir(parents=True)
    gains = gains or GAINS
    budget = 0 if tuner == "nominal" else 1000
    settings = {
        "task": PID,
        "tuner": {"_target_": f"somewhere.{tuner}"},
        "seed": seed,
        "budget": 1000,
        "num_envs": 2,
        "executor": {"_target_": "zoac.rollout.executors.base.Serial"},
        "eval_every": 500,
        "evaluation": {"episodes": 2, "final_episodes": len(costs), "seed": 0},
        "variant": variant,
        **(config or {}),
    }
    shared = {
        "format": schema.FORMAT,
        "task": task,
        "tuner": tuner,
        "seed": seed,
        "variant": variant,
        "config_hash": schema.config_hash(settings),
    }
    _write(
        folder / schema.RUN,
        {
            **shared,
            "config": settings,
            "command": ["zoac/run/__main__.py", f"task={task}", f"tuner={tuner}", f"seed={seed}"],
            "tuner_choices": {"start": "uniform <from the seed>"},
            "parameters": SPACE,
            "nominal": NOMINAL,
            "fixed": {},
            "versions": {"zoac": "0.1.0"},
            "commit": "0123abcd",
            "started": "2026-01-01T00:00:00+00:00",
            "machine": {"system": "somewhere", "processor": "x86_64", "cores": 2},
        },
    )
    common = {"terminations": 0, "prediction_error": 2e-4, "solver_failures": 0}
    rows: list[dict[str, Any]] = [
        {
            "kind": "eval",
            "env_steps": steps,
            "wall_seconds": steps / 100 + seed,
            "compute_seconds": steps / 50,
            "cost_mean": cost,
            "cost_per_episode": [cost - 1.0, cost + 1.0],
            "episode_lengths": [40, 40],
            **common,
            "parameters": {name: value + 1e-3 * cost for name, value in gains.items()},
            "final": False,
        }
        for steps, cost in evaluations
    ]
    if rows:
        train = {"kind": "train", "env_steps": 250, "wall_seconds": 2.5, "iteration": 1}
        rows = sorted([*rows, train], key=lambda row: row["env_steps"])
    rows = [row for row in rows if row["env_steps"] <= budget]
    if finished:
        outcome = {
            "env_steps": budget,
            "cost_mean": float(np.mean(costs)),
            "cost_std": float(np.std(costs, ddof=1)),
            "cost_per_episode": list(costs),
            "episode_lengths": [40] * len(costs),
            **common,
            "parameters": gains,
            "wall_seconds": 12.0 + seed,
            "compute_seconds": 20.0 + seed,
            "solver_seconds": 3.0,
            "tuner_seconds": 4.0,
            "evaluation_seconds": 2.0,
            "warnings": [],
            **(result or {}),
        }
        rows.append({"kind": "eval", **outcome, "final": True})
        _write(folder / schema.RESULT, {**shared, **outcome})
    (folder / schema.METRICS).write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


def _write(path, content):
    path.write_text(json.dumps(content))
