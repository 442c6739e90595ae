"""What building a task from a configuration would load that is not zoac's own."""

import inspect
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from zoac.config.validate import TARGET, locate
from zoac.core.errors import ConfigError

OWN = ("zoac.tasks.", "zoac.mpc.")
"""Packages whose classes a configuration may name without being trusted."""

USER_TASK = "zoac.tasks.user_task.user_task"
NAMED_CODE = ("env", "controller", "metrics", "constraints")
"""Arguments of `user_task` that may name code by dotted path, or by name and path."""


def foreign_code(node: Any, where: str = "task") -> list[str]:
    """Return what a config node names that is not zoac's own, each as `key: path`.

    Nothing is imported but modules of zoac.

    Args:
        node: The node, resolved, as plain Python.
        where: Its name in the config.
    """
    if isinstance(node, list):
        return [found for i, n in enumerate(node) for found in foreign_code(n, f"{where}[{i}]")]
    if not isinstance(node, Mapping):
        return []
    target = node.get(TARGET)
    named: Iterable[tuple[str, Any]] = [] if target is None else [(TARGET, target)]
    if target == USER_TASK:
        named = _code_of_user_task(node)
    found = [f"{where}.{key}: {path}" for key, path in named if not _is_own(path)]
    return found + [f for key, value in node.items() for f in foreign_code(value, f"{where}.{key}")]


def _code_of_user_task(node: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key in NAMED_CODE:
        value = node.get(key)
        for inner, path in value.items() if isinstance(value, Mapping) else [("", value)]:
            # The id of an environment, "CartPole-v1", names no code; "module:CartPole-v1" does.
            if isinstance(path, str) and not (key == "env" and not {".", ":"} & set(path)):
                yield f"{key}.{inner}".rstrip("."), path


def _is_own(path: Any) -> bool:
    if not (isinstance(path, str) and path.startswith(OWN)):
        return False
    try:
        thing = locate(path, TARGET)
    except ConfigError:  # told when it is built
        return True
    return inspect.isclass(thing) and f"{thing.__module__}.".startswith(OWN)
