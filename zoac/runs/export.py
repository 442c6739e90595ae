"""Tuned parameters as a file of another language; a tuned controller as a callable."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.core.types import is_number
from zoac.runs import schema

if TYPE_CHECKING:
    from zoac.rollout.task import Task


def export(parameters: Mapping[str, Any], path: str | Path, units: Mapping[str, str]) -> Path:
    """Write parameters in the format that the suffix names; return the path.

    Every number is written with as many digits as bring the same double back.

    Args:
        parameters: Physical values by name: numbers, or options of a choice. A name that C, C++ or
            MATLAB cannot take becomes one that it can: `c-f` is `c_f`, `end` is `end_`.
        path: `.yaml` or `.yml`, `.json`, `.h` (C and C++), `.m` (a MATLAB function that returns a
            struct).
        units: By name, for comments; names without one are left out.

    Raises:
        ConfigError: If the suffix is unknown, two names become one identifier, a value is not
            finite or has no literal in that language, or the file cannot be written.
    """
    if not isinstance(path, str | Path):
        raise ConfigError(f"export to {path!r}: expected a file, such as 'gains.yaml'")
    path = Path(path).expanduser()
    writer = FORMATS.get(path.suffix)
    if writer is None:
        raise ConfigError(f"export to {path.name!r}: {suggest(path.suffix, FORMATS)}")
    for name, value in parameters.items():
        if isinstance(value, (float, np.floating)) and not np.isfinite(value):
            raise ConfigError(
                f"export to {path.name!r}: parameter {name!r} is {value}, expected a finite "
                "number; nothing was written"
            )
    text = writer(parameters, {k: u for k, u in units.items() if u}, path.stem)
    try:
        schema.write_atomically(path, text.encode())
    except OSError as error:
        raise ConfigError(
            f"export to {str(path)!r}: {error.strerror}; choose a folder that is there and can be "
            "written to"
        ) from None
    return path


def export_c(task: Task, parameters: Mapping[str, Any], path: str | Path) -> Path:
    """Write a task's controller as C, if it has a method `export`; return the path.

    Raises:
        ConfigError: If it has none, or something of it has no form in C.
    """
    controller = task.make_controller()
    if not hasattr(controller, "export"):
        raise ConfigError(
            f"export to {Path(path).name!r}: {type(controller).__name__} cannot be written as C, "
            "zoac.mpc.Mpc can; .h writes the parameters"
        )
    env = task.make_env(1)
    size = int(np.prod(env.single_observation_space.shape or ()))
    env.close()
    return controller.export(parameters, path, size)


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
    for identifier, name, value in _entries(parameters):
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
    for identifier, name, value in _entries(parameters):
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


def _entries(parameters: Mapping[str, Any]) -> list[tuple[str, str, Any]]:
    """Return each parameter as (identifier, name, value).

    Raises:
        ConfigError: If two identifiers are the same, or a value is no text, number or bool.
    """
    found = [(_identifier(name), name, value) for name, value in parameters.items()]
    identifiers = [identifier for identifier, _, _ in found]
    doubled = [name for identifier, name, _ in found if identifiers.count(identifier) > 1]
    if doubled:
        raise ConfigError(f"the names {', '.join(doubled)} are one identifier; rename one")
    for _, name, value in found:
        if not isinstance(value, (str, int, float)):
            raise ConfigError(
                f"parameter {name!r}: {value!r} has no literal in C or MATLAB; expected a number, "
                "text or a bool; export to .json or .yaml"
            )
    return found


def _identifier(name: str) -> str:
    """Return `name` as C, C++ and MATLAB allow it."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    word = word if re.match(r"[A-Za-z]", word) else f"p{word}"
    return f"{word}_" if word in _KEYWORDS else word


# C23 and C++23, without those that begin with an underscore; then what only MATLAB's iskeyword has.
_WORDS = """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t
    char32_t class co_await co_return co_yield compl concept const const_cast consteval constexpr
    constinit continue decltype default delete do double dynamic_cast else enum explicit export
    extern false float for friend goto if inline int long mutable namespace new noexcept not not_eq
    nullptr operator or or_eq private protected public register reinterpret_cast requires restrict
    return short signed sizeof static static_assert static_cast struct switch template this
    thread_local throw true try typedef typeid typename typeof typeof_unqual union unsigned using
    virtual void volatile wchar_t while xor xor_eq
    classdef elseif end function global otherwise parfor persistent spmd
"""
_KEYWORDS = frozenset(_WORDS.split())


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
        values = task.space.values(task.space.normalise(named))
        self._values = {
            name: np.array([named[name] if is_number(named[name]) else value], dtype=np.float64)
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
