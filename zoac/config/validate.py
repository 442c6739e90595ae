"""Configuration values against the signature of what they configure.

A constructor's type hints, with bounds as `Annotated[float, Field(gt=0)]`, are the schema of its
YAML file: there is no second list to keep in step, and a user's own class is checked alike.
"""

import functools
import importlib
import inspect
import math
import re
import traceback
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, get_type_hints

from pydantic import (
    ConfigDict,
    PydanticSchemaGenerationError,
    PydanticUserError,
    TypeAdapter,
    ValidationError,
)

from zoac.core.errors import ConfigError, as_text, nearest, suggest
from zoac.core.types import is_number

TARGET = "_target_"


def locate(path: str, where: str) -> Callable[..., Any]:
    """Return the class or function of a dotted path, which the key `where` names.

    Raises:
        ConfigError: If it cannot be imported or has no such name.
    """
    module_name, _, name = path.rpartition(".")
    try:
        module = importlib.import_module(module_name)
    except ValueError:
        raise ConfigError(f"{where}: expected a dotted path, got {path!r}") from None
    except ConfigError:  # says by itself what it needs
        raise
    except Exception as error:  # whatever a user's own module raises while it is imported
        hint = _import_hint(module_name, error)
        raise ConfigError(f"{where}: cannot import {path!r}: {hint}") from error
    if not hasattr(module, name):
        names = [n for n, v in vars(module).items() if callable(v)]
        raise ConfigError(f"{where}: no {name!r} in {module_name}; {suggest(name, names)}")
    return getattr(module, name)


def _import_hint(module: str, error: Exception) -> str:
    """Say why a module could not be imported, and what to do."""
    missing = error.name if isinstance(error, ModuleNotFoundError) else None
    if missing is None or not f"{module}.".startswith(f"{missing}."):
        steps = traceback.extract_tb(error.__traceback__)
        place = f" ({steps[-1].filename}, line {steps[-1].lineno})" if steps else ""
        return f"importing {module} raised {as_text(error)}{place}"
    here = Path.cwd()
    top = module.partition(".")[0]
    modules = {p.stem for p in here.glob("*.py")} | {p.parent.name for p in here.glob("*/*.py")}
    return (
        f"there is no module {missing!r}; run from the folder that holds {top}.py or {top}/, or "
        f"name that folder in PYTHONPATH. In {here}: {suggest(top, modules)}"
    )


def check_arguments(
    target: Callable[..., Any],
    given: Mapping[str, Any],
    where: str,
    provided: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Check keyword arguments against the signature of `target`.

    Returns:
        The type hints of its arguments, by name.

    Raises:
        ConfigError: If one is unknown, missing, of the wrong type or out of its bounds.
    """
    parameters, hints = _signature(target)
    accepted = {n: p for n, p in parameters.items() if n not in provided}
    open_ended = any(p.kind is p.VAR_KEYWORD for p in accepted.values())
    faults = []
    for name, value in given.items():
        if name not in accepted:
            if not open_ended:
                place = f"{where}: " if where else ""
                faults.append(f"{place}unknown key {name!r}; {suggest(name, accepted)}")
        elif not (isinstance(value, Mapping) and TARGET in value):
            key = f"{where}.{name}" if where else name
            hint = hints.get(name, Any)
            if isinstance(value, Mapping) and isinstance(hint, type) and is_dataclass(hint):
                try:
                    check_arguments(hint, value, key)
                except ConfigError as error:
                    faults.append(str(error))
            elif isinstance(hint, type) and is_dataclass(hint):
                names = ", ".join(f"{key}.{option.name}" for option in fields(hint))
                faults.append(f"{key}={_short(value)}: this is a group of options: {names}")
            else:
                faults.extend(_faults(value, hint, key))
    needed = (
        n
        for n, p in accepted.items()
        if p.default is p.empty and p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)
    )
    faults.extend(f"{where}.{name}: a value is needed" for name in needed if name not in given)
    if faults:
        raise ConfigError("\n".join(faults))
    return hints


def with_groups(given: Mapping[str, Any], hints: Mapping[str, Any]) -> dict[str, Any]:
    """Return checked arguments, those that are a group of options as its dataclass."""
    return {
        name: hints[name](**value)
        if isinstance(value, Mapping) and is_dataclass(hints.get(name))
        else value
        for name, value in given.items()
    }


def _signature(target: Callable[..., Any]) -> tuple[dict[str, inspect.Parameter], dict[str, Any]]:
    """Return parameters and type hints; `**options` stands for those of the next base class."""
    if not inspect.isclass(target) or hasattr(target, "__dataclass_fields__"):
        return dict(inspect.signature(target).parameters), _hints(target)
    parameters: dict[str, inspect.Parameter] = {}
    hints: dict[str, Any] = {}
    for base in target.__mro__:
        if "__init__" not in vars(base):
            continue
        own = dict(inspect.signature(base).parameters)
        inherited = [n for n, p in own.items() if p.kind is p.VAR_KEYWORD]
        parameters = {**own, **parameters}
        hints = {**_hints(vars(base)["__init__"]), **hints}
        if not inherited or base.__mro__[1] is object:
            break
        del parameters[inherited[0]]
    return parameters, hints


def _hints(target: Any) -> dict[str, Any]:
    try:
        return get_type_hints(target, include_extras=True)
    except NameError:  # a hint imported for type checkers only: nothing to check against
        return {}


def _faults(value: Any, hint: Any, where: str) -> list[str]:
    """Return what is wrong with `value` as a `hint`, one message each."""
    if isinstance(value, int) and not (isinstance(value, bool) or is_number(value)):
        return [f"{where}={_short(value)}: larger than any float; expected a finite number"]
    try:
        adapter = _adapter(hint)
    except TypeError:  # it cannot be hashed
        adapter = _adapter.__wrapped__(hint)
    try:
        adapter.validate_python(value, strict=True)
    except ValidationError as error:
        return [
            f"{where}{''.join(f'[{part}]' for part in e['loc'] if isinstance(part, int))}"
            f"={_short(e['input'])}: {e['msg'][0].lower()}{e['msg'][1:]}{_nearest(e)}"
            for e in error.errors()
        ]
    except PydanticUserError:  # a hint whose parts are imported for type checkers only
        pass
    # Where a hint allows everything, it allows these too.
    parts = {f"{where}[{i}]": v for i, v in enumerate(value)} if isinstance(value, list) else {}
    return [
        f"{place}={part}: input should be a finite number"
        for place, part in {where: value, **parts}.items()
        if isinstance(part, float) and not math.isfinite(part)
    ]


@functools.cache
def _adapter(hint: Any) -> TypeAdapter[Any]:
    """Return what checks values against a hint; to make it takes longer than to check with it."""
    try:
        return TypeAdapter(hint, config=_CHECKED)
    except PydanticSchemaGenerationError:
        return TypeAdapter(Any)
    except PydanticUserError:  # types that bring their own configuration take none
        return TypeAdapter(hint)


_CHECKED = ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=False)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _nearest(error: Any) -> str:
    """Return the choice that is nearest to what was written, as a clause, if there is one."""
    if error["type"] == "is_instance_of" and error["ctx"]["class"] == "Sequence":
        return ", a list such as [64,64]"
    if error["type"] != "literal_error":
        return ""
    choices = re.findall(r"'([^']*)'", error["ctx"]["expected"])
    close = nearest(str(error["input"]), choices)
    return f"; did you mean {close!r}?" if close is not None else ""
