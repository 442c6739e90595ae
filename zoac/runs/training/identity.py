"""What tells a run from others beside its settings: the user's own code and objects."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from zoac.config import fingerprint
from zoac.config.validate import TARGET, locate
from zoac.rollout.task import Task
from zoac.runs import schema


def settings_of_task(
    task: Task, options: Mapping[str, Any], node: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the settings that tell a task without a YAML file from others, as plain data.

    Args:
        options: As for `zoac.tasks.given_task.given_task`.
        node: Configuration of the built-in task that it is made from; empty without one.
    """
    told = {
        "built_in": {("target" if k == TARGET else k): value for k, value in node.items()},
        "space": [str(p) for p in task.space.parameters],
        "fixed": dict(task.fixed),
        "baseline": dict(task.baseline or {}),
        "max_episode_steps": options["max_episode_steps"],
        "plant": dict(options["plant"] or {}),
        "vary": dict(options["vary"] or {}),
        "objective": options["objective"] if isinstance(options["objective"], str) else "specs",
        "signals": {name: str(signal.label) for name, signal in task.signals.items()},
        "sample_time": task.sample_time,
        "specs": [spec.told() for spec in task.specs],
    }
    plain: dict[str, Any] = json.loads(schema.json_line(told))
    return {key: value for key, value in plain.items() if value or key == "fixed"}


def with_code(config: Mapping[str, Any], task: Task) -> tuple[dict[str, Any], Sequence[str]]:
    """Return a configuration with what tells a user's code and objects from others; and doubts.

    Args:
        config: Resolved configuration; its task has a `_target_` if it comes from a YAML file.

    Returns:
        The configuration with the key `code`, if the task has code that is not zoac's own; and a
        sentence for each part that cannot be compared with that of another run.
    """
    node = config["task"]
    if TARGET not in node:
        code, doubts = fingerprint.told(task.parts())
    else:
        # Jobs of a sweep may share a process, and earlier ones may have changed the code's globals.
        key = json.dumps(node, sort_keys=True)
        if key not in _seen:
            _seen[key] = fingerprint.told(_parts_from_file(node[TARGET], task))
        code, doubts = _seen[key]
    kept = {name: texts for name, texts in code.items() if texts}
    return {**config, "code": kept} if kept else dict(config), doubts


_seen: dict[str, tuple[dict[str, Any], list[str]]] = {}


def _parts_from_file(target: str, task: Task) -> dict[str, Any]:
    """Return the parts of a task from a YAML file, which has the task's options already."""
    parts = task.parts()
    if parts.get("task") is not task:
        return parts
    made_by = locate(target, TARGET)
    return {} if fingerprint.is_installed(made_by.__module__) else {"task": made_by}
