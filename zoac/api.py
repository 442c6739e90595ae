"""For people who write Python, not YAML."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from omegaconf import OmegaConf

from zoac.build import build_task
from zoac.config import GROUPS, compose_config, resolved
from zoac.errors import ConfigError, suggest
from zoac.task import Task


def make_task(name: str, **overrides: Any) -> Task:
    """Return a task by its config name.

    Args:
        name: As on the command line: "pid_acc", "mpc_tracking", ...
        overrides: Config groups by name (`mpc_solver="riccati"`, `fidelity="authors_code"`), or
            options of the task (`max_episode_steps=200`).

    Raises:
        ConfigError: If the task, a group's choice or an option is unknown, or a value is unusable.
    """
    groups = [f"{key}={value}" for key, value in overrides.items() if key in GROUPS]
    config = compose_config([f"task={name}", *groups])
    OmegaConf.set_struct(config, False)
    for key, value in overrides.items():
        if key in GROUPS:
            continue
        if key not in config.task:
            known = [*(k for k in config.task if not str(k).startswith("_")), *GROUPS]
            raise ConfigError(f"task {name!r} has no option {key!r}; {suggest(key, known)}")
        OmegaConf.update(config, f"task.{key}", value)
    return build_task(resolved(config))


def task_from_config(config: Mapping[str, Any]) -> Task:
    """Return the task of a run, from the `config` in its `run.json`."""
    return build_task(config)
