"""Tuned parameters as a file of another language; a tuned controller as a callable."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac import records
from zoac.errors import ConfigError, suggest

if TYPE_CHECKING:
    from zoac.task import Task


def export(parameters: Mapping[str, Any], path: str | Path, units: Mapping[str, str]) -> Path:
    """Write parameters in the format that the suffix names; return the path.

    Every number is written with as many digits as bring the same double back.

    Args:
        parameters: Physical values by name: numbers, or options of a choice.
        path: `.yaml` or `.yml`, `.json`, `.h` (C and C++), `.m` (a MATLAB function that returns a
            struct).
        units: By name, for comments; names without one are left out.

    Raises:
        ConfigError: If the suffix is unknown, or two names become one identifier.
    """
    path = Path(path)
    writer = FORMATS.get(path.suffix)
    if writer is None:
        raise ConfigError(f"export to {path.name!r}: {suggest(path.suffix, FORMATS)}")
    text = writer(parameters, {k: u for k, u in units.items() if u}, path.stem)
    records.write_atomically(path, text.encode())
    return path


def _json(parameters: Mapping[str, Any], units: Mapping[str, str], stem: str) -> str:
    return json.dumps(dict(parameters), indent=2) + "\n"


def _yaml(parameters: Mapping[str, Any], units: Mapping[str, str], stem: str) -> str:
    # JSON scalars are YAML scalars but for exponents without a point, which YAML reads as text.
    lines = [
        f"{json.dumps(name)}: {_pointed(json.dumps(value))}{_comment('  # ', name, units)}"
        for name, value in parameters.items()
    ]
    return "\n".join(lines) + "\n"


def _pointed(number: str) -> str:
    return re.sub(r"^(-?\d+)(e[+-]\d+)$", r"\1.0\2", number)


def _header(parameters: Mapping[str, Any], units: Mapping[str, str], stem: str) -> str:
    guard = f"{_identifier(stem).upper()}_H"
    lines = [f"#ifndef {guard}", f"#define {guard}", ""]
    for identifier, (name, value) in zip(_identifiers(parameters), parameters.items(), strict=True):
        kind = "double"
        if isinstance(value, str):
            kind, literal = "char *const", json.dumps(value, ensure_ascii=True)
        elif isinstance(value, int):  # bool too
            kind, literal = "long", f"{int(value)}L"
        else:
            literal = repr(float(value))
        unit = f" /* {units[name].replace('*/', '* /')} */" if name in units else ""
        lines.append(f"static const {kind} {identifier} = {literal};{unit}")
    return "\n".join([*lines, "", "#endif", ""])


def _matlab(parameters: Mapping[str, Any], units: Mapping[str, str], stem: str) -> str:
    lines = [f"function parameters = {_identifier(stem)}()"]
    for identifier, (name, value) in zip(_identifiers(parameters), parameters.items(), strict=True):
        if isinstance(value, str):
            literal = "'{}'".format(value.replace("'", "''"))
        else:
            literal = repr(int(value) if isinstance(value, bool) else value)
        lines.append(f"parameters.{identifier} = {literal};{_comment('  % ', name, units)}")
    return "\n".join([*lines, "end", ""])


FORMATS: dict[str, Callable[[Mapping[str, Any], Mapping[str, str], str], str]] = {
    ".yaml": _yaml,
    ".yml": _yaml,
    ".json": _json,
    ".h": _header,
    ".m": _matlab,
}


def _comment(mark: str, name: str, units: Mapping[str, str]) -> str:
    return f"{mark}{units[name]}" if name in units else ""


def _identifiers(parameters: Mapping[str, Any]) -> list[str]:
    """Return one identifier a name.

    Raises:
        ConfigError: If two names become the same.
    """
    found = [_identifier(name) for name in parameters]
    doubled = [name for name, i in zip(parameters, found, strict=True) if found.count(i) > 1]
    if doubled:
        raise ConfigError(f"the names {', '.join(doubled)} are one identifier; rename one")
    return found


def _identifier(name: str) -> str:
    """Return `name` as C and MATLAB allow it."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    return word if re.match(r"[A-Za-z]", word) else f"p{word}"


class TunedController:
    """A controller with its parameters: `action = controller(observation)`.

    What it remembers lasts from call to call; `reset()` begins an episode.
    """

    def __init__(self, task: Task, parameters: Mapping[str, Any]) -> None:
        """
        Args:
            task: Gives the controller and the space.
            parameters: Physical values of all tuned parameters; others are left out.

        Raises:
            ConfigError: If one is missing or lies outside its bounds.
        """
        self._task = task
        self.parameters = dict(parameters)
        named = {name: parameters[name] for name in task.space.names if name in parameters}
        values = task.space.values(task.space.unit(named))
        self._values = {
            name: np.array([named[name] if _is_number(named[name]) else value], dtype=np.float64)
            for name, value in zip(task.space.names, values, strict=True)
        }
        self._controller = task.make_controller()
        self.reset()

    def reset(self) -> None:
        """Begin an episode: forget."""
        self._memory = self._controller.init(1)

    def __call__(self, observation: np.ndarray) -> Any:
        """Return the action for one observation (o,), as one environment of the task takes it."""
        observation = np.asarray(observation, dtype=np.float64).reshape(1, -1)
        actions, self._memory, _ = self._controller.act(self._values, observation, self._memory)
        return self._task.env_action(np.asarray(actions, dtype=np.float64)[0])


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
