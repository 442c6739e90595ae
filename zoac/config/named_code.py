"""What a dotted path of a configuration leads to, looked at before anything calls it.

A configuration names tasks and tuners, not programs. Finding a name imports its module, so the
modules that a configuration names must be trusted like any other import.
"""

import functools
import inspect
import types
from collections.abc import Callable
from typing import Annotated, Any, Protocol, Union, get_args, get_origin, get_type_hints

from zoac.config.fingerprint import is_installed
from zoac.config.validate import locate
from zoac.core.errors import ConfigError


def locate_maker(path: str, kinds: tuple[type, ...], where: str) -> Callable[..., Any]:
    """Return the class or function of a `_target_`, which a place that takes `kinds` may call.

    Raises:
        ConfigError: If there is no such name, or if it is neither a subclass of `kinds` nor a
            function that is annotated to return one of them.
    """
    found = locate(path, where)
    made = (found,) if inspect.isclass(found) else _returned(_function(found))
    if not _any_is(made, kinds):
        raise ConfigError(
            f"{where}: {path!r} is not what this key takes, and was not called; expected a "
            f"subclass of {_names(kinds)}, or a function that says so: "
            f"def make(...) -> {kinds[0].__name__}"
        )
    return found


def locate_code(
    path: str, where: str, kinds: tuple[type, ...], returned: tuple[type, ...], wanted: str
) -> Any:
    """Return what the path of a user's own environment, controller or metric leads to.

    Args:
        path: "package.module.name".
        where: The key that names it, for messages; `wanted` says what is expected.
        kinds: Classes, or protocols, of which it may be a subclass or an object.
        returned: What an annotated function may return.

    Raises:
        ConfigError: If there is no such name, or if it is something else: a function must be
            written in Python in a module of the user's own, or be annotated.
    """
    found = locate(path, where)
    function = _function(found)
    fits = _any_is((found if inspect.isclass(found) else type(found),), kinds)
    own = function is not None and not is_installed(function.__module__)
    if not (fits or own or _any_is(_returned(function), returned)):
        raise ConfigError(
            f"{where}: {path!r} is not what this key takes, and was not called; expected {wanted}, "
            f"written in a module of your own or annotated: -> {returned[0].__name__}"
        )
    return found


def kinds_of(hint: Any) -> tuple[type, ...]:
    """Return the classes that a type hint names; none for a hint that allows everything."""
    origin = get_origin(hint)
    if origin is Annotated:
        return kinds_of(get_args(hint)[0])
    if origin in (Union, types.UnionType):
        return tuple(kind for part in get_args(hint) for kind in kinds_of(part))
    kind = origin or hint
    return (kind,) if inspect.isclass(kind) and kind not in (object, types.NoneType) else ()


def _function(found: Any) -> types.FunctionType | None:
    """Return the Python function that runs when `found`, or an object of this class, is called."""
    while isinstance(found, functools.partial):
        found = found.func
    found = inspect.unwrap(found)
    found = getattr(found, "__func__", found)
    if not isinstance(found, types.FunctionType):
        made = found if inspect.isclass(found) else type(found)
        found = inspect.getattr_static(made, "__call__", None)
    return found if isinstance(found, types.FunctionType) else None


def _returned(function: types.FunctionType | None) -> tuple[type, ...]:
    """Return the classes that a function is annotated to return."""
    try:
        return () if function is None else kinds_of(get_type_hints(function).get("return"))
    except NameError:  # a hint that is imported for type checkers only
        return ()


def _any_is(made: tuple[type, ...], kinds: tuple[type, ...]) -> bool:
    return any(_is(one, kind) for one in made for kind in kinds)


def _is(made: type, kind: type) -> bool:
    """Tell whether a class is a `kind`: derived from it, or with the members of a protocol."""
    if Protocol not in kind.__bases__:
        return issubclass(made, kind)
    members = {*vars(kind), *inspect.get_annotations(kind)}
    return all(hasattr(made, name) for name in members if not name.startswith("_"))


def _names(kinds: tuple[type, ...]) -> str:
    return " or ".join(f"{kind.__module__}.{kind.__qualname__}" for kind in kinds)
