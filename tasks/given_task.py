"""What `zoac.tune` tunes: a task, by name or as an object, or what a user has."""

import re
from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any

from zoac.config import factory, fingerprint
from zoac.config.files import configuration
from zoac.core.errors import ConfigError, option_names, suggest
from zoac.envs.single_env import EnvSource
from zoac.rollout.task import Task
from zoac.tasks.user_space import parse_space
from zoac.tasks.user_specs import require
from zoac.tasks.user_task import user_task

REQUIREMENTS = ("signals", "sample_time", "specs", "objective")
"""Options of `zoac.tune` that go with any task."""


def make_task(name: str, **overrides: Any) -> Task:
    """Return a task by its config name.

    Args:
        name: As on the command line: "pid_acc", "mpc_tracking", ...
        overrides: `mpc_solver="riccati"`, `fidelity="authors_code"`, or options of the task
            (`max_episode_steps=200`).

    Raises:
        ConfigError: If the task, a choice or an option is unknown, or a value cannot be used.
    """
    groups = {key: overrides.pop(key) for key in ("mpc_solver", "fidelity") if key in overrides}
    config = configuration(task=name, tuner=None, **groups)
    set_options(config["task"], overrides, f"task {name!r}", ("mpc_solver", "fidelity"))
    task = factory.build_task(config)
    task.preset = name
    return task


def given_task(
    task: Task | str | None, of_user: Mapping[str, Any], options: Mapping[str, Any]
) -> Task:
    """Return the task to tune, which nobody else holds.

    Args:
        task: An object, or the name of a built-in one; None: the user's own.
        of_user: `env`, `controller` and `space`; None each beside a `task`.
        options: The others of `user_task`, as `zoac.tune` was given them. Beside a `task` these
            may be `baseline` and `REQUIREMENTS`.

    Raises:
        ConfigError: If both or neither are given, or something cannot be used.
    """
    if task is None:
        if any(part is None for part in of_user.values()):
            raise ConfigError("tune needs a task, or all of env, controller and space")
        return user_task(**of_user, **options)
    of_task = {k: v or None for k, v in options.items() if k not in ("baseline", *REQUIREMENTS)}
    doubled = [name for name, value in {**of_user, **of_task}.items() if value is not None]
    if isinstance(options["objective"], str) and options["objective"] != "auto":
        doubled.append("objective")
    if doubled:
        raise ConfigError(f"give either task or env, controller and space; not {doubled} too")
    if not isinstance(task, Task | str):
        raise ConfigError(f"task={task!r}: expected a Task, or the name of a built-in one")
    made = make_task(task) if isinstance(task, str) else copy(task)
    require(made, options)
    if options["baseline"] is not None:
        _, _, made.baseline = parse_space(made.space, options["baseline"])
    return made


def is_by_name(task: Task | str | None, options: Mapping[str, Any]) -> bool:
    """Return whether the name of a built-in task tells all of it, so that it has a YAML file."""
    required = any(options[n] for n in REQUIREMENTS if n != "objective")
    return isinstance(task, str) and not required and options["objective"] == "auto"


def name_of(task: Task | str | None, env: EnvSource | None) -> str:
    """Return what a task is called in tables: its own name, its class's or its environment's."""
    if task is not None:
        return task if isinstance(task, str) else type(task).__name__
    last = fingerprint.name(env).rpartition(".")[2]
    return re.sub(r"[^\w.-]+", "-", last).strip("-")


def set_options(
    node: dict[str, Any], options: Mapping[str, Any], what: str, more: Sequence[str] = ()
) -> None:
    """Set options of a config node, in dicts for inner nodes; `what` is its name in messages.

    Raises:
        ConfigError: If there is no such option; the message names the nearest.
    """
    for key, value in options.items():
        if key not in node:
            known = [*option_names(node), *more]
            raise ConfigError(f"{what} has no option {key!r}; {suggest(key, known)}")
        if isinstance(node[key], dict) and isinstance(value, Mapping):
            set_options(node[key], value, f"{key} of {what}")
        else:
            node[key] = value
