"""What a user's functions, classes and objects are: a short text, the same in every process.

Two things with the same text do the same: the text holds a digest of code, default values,
closures, the globals that the code reads, and attributes. Code of Python itself, of installed
packages and of zoac goes by its name; `run.json` has their versions.
"""

import copyreg
import dis
import functools
import hashlib
import sys
import types
from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from pathlib import Path, PurePath
from typing import Any

import gymnasium
import numpy as np

_BY_TEXT = (bool, int, float, complex, str, bytes, range, slice, PurePath, types.EllipsisType)
_BY_NAME = (
    types.BuiltinFunctionType, types.WrapperDescriptorType, types.MethodDescriptorType,
    types.MemberDescriptorType, types.GetSetDescriptorType, types.ClassMethodDescriptorType,
)  # fmt: skip

CHANGES_WITH_USE = ("_np_random", "_np_random_seed", "_cached_spec", "low_repr", "high_repr")
"""Attributes of Gymnasium's environments and spaces that say nothing about what they are."""


class CannotTellError(Exception):
    """Something of which nobody can tell whether another is the same; the text says what."""


def described(thing: Any) -> str:
    """Return the name of a thing and a digest of what it does; a string stands for itself.

    Raises:
        CannotTellError: If it holds something that cannot be compared.
    """
    if isinstance(thing, str):
        return thing
    try:
        return f"{name(thing)}@{_Walk().digest(thing).hex()[:16]}"
    except RecursionError:
        raise CannotTellError("it is nested too deeply") from None


def told(parts: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return things, or dicts of them, as `described`; and a sentence for each that cannot be told.

    Args:
        parts: Things by name, such as `zoac.rollout.task.Task.parts` returns.
    """
    texts: dict[str, Any] = {}
    doubts: list[str] = []
    for key, thing in parts.items():
        if isinstance(thing, dict):
            texts[key], inner = told(thing)
            doubts += [f"{key}.{doubt}" for doubt in inner]
            continue
        try:
            texts[key] = described(thing)
        except CannotTellError as doubt:
            texts[key] = name(thing)
            doubts.append(f"{key}: {doubt}, which cannot be compared")
    return texts, doubts


def name(thing: Any) -> str:
    """Return the name of a function, of a class, of what a partial calls, or of an object's class.

    An environment of `gymnasium.make` goes by its id.
    """
    if isinstance(thing, str):
        return thing
    if isinstance(thing, functools.partial):
        return name(thing.func)
    if isinstance(thing, gymnasium.Env) and thing.unwrapped.spec is not None:
        return thing.unwrapped.spec.id
    by_itself = hasattr(thing, "__qualname__") and hasattr(thing, "__module__")
    named = thing if by_itself else type(thing)  # a generator has the first alone
    return f"{named.__module__}.{named.__qualname__}"


def is_installed(module: str | None) -> bool:
    """Tell whether a module is of Python, zoac or an installed package, and no user's own."""
    top = (module or "builtins").partition(".")[0]
    if top in sys.stdlib_module_names or top == __name__.partition(".")[0]:
        return True
    file = getattr(sys.modules.get(module or ""), "__file__", None)
    return file is not None and not {"site-packages", "dist-packages"}.isdisjoint(Path(file).parts)


class _Walk:
    """A walk through everything that one thing consists of."""

    def __init__(self) -> None:
        self._open: dict[int, int] = {}  # what is being looked at: id -> depth
        self._done: dict[int, tuple[Any, bytes]] = {}  # with the thing, so that no id comes twice
        self._path: list[str] = []

    def digest(self, thing: Any) -> bytes:
        if thing is None or type(thing) in _BY_TEXT:
            return _hashed(type(thing).__name__, repr(thing))
        key = id(thing)
        if key in self._done:
            return self._done[key][1]
        if key in self._open:
            return _hashed("within itself", str(self._open[key]))
        self._open[key] = len(self._open)
        try:
            found = _hashed(*self._parts(thing))
        finally:
            del self._open[key]
        self._done[key] = thing, found
        return found

    def _all(self, things: Iterable[Any]) -> list[str | bytes]:
        return [self.digest(thing) for thing in things]

    def _named(self, things: Mapping[str, Any], what: str) -> list[str | bytes]:
        found: list[str | bytes] = []
        for key in sorted(things):
            self._path.append(f"{what} {key!r}")
            try:
                found.append(_hashed(key, self.digest(things[key])))
            finally:
                self._path.pop()
        return found

    def _parts(self, thing: Any) -> list[str | bytes]:
        """Return texts and digests that together say what a thing is."""
        if isinstance(thing, types.FunctionType):
            return self._function(thing)
        if isinstance(thing, type):
            return self._class(thing)
        if isinstance(thing, types.CodeType):
            names, variables = " ".join(thing.co_names), " ".join(thing.co_varnames)
            return ["code", thing.co_code, names, variables, *self._all(thing.co_consts)]
        if isinstance(thing, types.ModuleType):
            return ["module", thing.__name__, _content(thing)]
        if isinstance(thing, functools.partial):
            return ["partial", *self._all((thing.func, thing.args, thing.keywords))]
        if isinstance(thing, types.MethodType):
            return ["method", *self._all((thing.__func__, thing.__self__))]
        if isinstance(thing, _BY_NAME):
            bound = getattr(thing, "__self__", None)
            owner = None if isinstance(bound, types.ModuleType | type) else bound
            return ["name", thing.__qualname__, self.digest(owner)]
        if isinstance(thing, property):
            return ["property", *self._all((thing.fget, thing.fset, thing.fdel))]
        if isinstance(thing, staticmethod | classmethod):
            return [type(thing).__name__, self.digest(thing.__func__)]
        if isinstance(thing, functools.cached_property):
            return ["cached property", self.digest(thing.func)]
        return self._object(thing)

    def _function(self, thing: types.FunctionType) -> list[str | bytes]:
        found: list[str | bytes] = ["function", thing.__module__ or "", thing.__qualname__]
        cells = zip(thing.__code__.co_freevars, thing.__closure__ or (), strict=True)
        found += self._named({k: c.cell_contents for k, c in cells if _filled(c)}, "variable")
        found += self._all((thing.__defaults__, thing.__kwdefaults__))
        found += self._named(vars(thing), "attribute")
        if is_installed(thing.__module__):
            return found
        read = {k: thing.__globals__[k] for k in _globals_read(thing.__code__)
                if k in thing.__globals__}  # fmt: skip
        return [*found, self.digest(thing.__code__), *self._named(read, "global")]

    def _class(self, thing: type) -> list[str | bytes]:
        module = getattr(thing, "__module__", None)  # classes written in C may have none
        found: list[str | bytes] = ["class", module or "", thing.__qualname__]
        if is_installed(module):
            return found
        own = {
            key: value
            for key, value in vars(thing).items()
            if key != "_abc_impl"
            and (isinstance(value, types.FunctionType) or not (key[:2] == key[-2:] == "__"))
        }
        return [*found, *self._all(thing.__bases__), *self._named(own, "attribute")]

    def _object(self, thing: Any) -> list[str | bytes]:
        kind = self.digest(type(thing))
        if isinstance(thing, np.ndarray | np.generic):
            array = np.asarray(thing)
            content = self.digest(array.tolist()) if array.dtype.hasobject else array.tobytes()
            return [kind, str(array.dtype), str(array.shape), content]
        if isinstance(thing, Enum):
            return [kind, thing.name]
        if isinstance(thing, _BY_TEXT):  # of a class of their own
            return [kind, repr(thing)]
        if isinstance(thing, dict | types.MappingProxyType):
            return [kind, *sorted(_hashed(*self._all(item)) for item in thing.items())]
        if isinstance(thing, set | frozenset):
            return [kind, *sorted(map(self.digest, thing))]
        if isinstance(thing, gymnasium.Env):
            return [kind, *self._env(thing)]
        if hasattr(thing, "py_func"):  # compiled by numba
            return [kind, self.digest(thing.py_func)]
        if hasattr(thing, "detach") and hasattr(thing, "numpy"):  # a tensor of torch
            return [kind, self.digest(thing.detach().cpu().numpy())]
        items = self._all(thing) if isinstance(thing, tuple | list) else []
        if type(thing) in (tuple, list):
            return [kind, *items]
        return [kind, *items, *self._reduced(thing)]

    def _env(self, thing: gymnasium.Env) -> list[str | bytes]:
        """Return digests of an environment's attributes.

        Attributes that cannot be compared are left out where the environment is a registered one:
        its id and arguments are among the others.
        """
        found: list[str | bytes] = []
        for key, value in sorted(_lasting(thing, vars(thing)).items()):
            try:
                found += self._named({key: value}, "attribute")
            except CannotTellError:
                if thing.unwrapped.spec is None:
                    raise
        return found

    def _reduced(self, thing: Any) -> list[str | bytes]:
        """Return what a pickle of a thing would be made from."""
        try:
            reducer = copyreg.dispatch_table.get(type(thing))
            reduced = reducer(thing) if reducer else thing.__reduce_ex__(4)
        except Exception:  # whatever says that it cannot be pickled
            where = " of ".join(reversed(self._path)) or "it"
            raise CannotTellError(f"{where} is a {type(thing).__name__}") from None
        if isinstance(reduced, str):  # a global's name
            return [reduced, self.digest(getattr(thing, "__wrapped__", None))]
        made, arguments, state, *items = (*reduced, None)[: max(3, len(reduced))]
        found = self._all((made, arguments))
        if isinstance(state, dict) and all(isinstance(key, str) for key in state):
            found += self._named(_lasting(thing, state), "attribute")
        else:
            found.append(self.digest(state))
        return [*found, *self._all(list(rest) for rest in items if isinstance(rest, Iterator))]


def _lasting(thing: Any, attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return attributes without random streams of Gymnasium and without cached properties."""
    skipped = CHANGES_WITH_USE if isinstance(thing, gymnasium.Env | gymnasium.Space) else ()
    return {
        key: value
        for key, value in attributes.items()
        if key not in skipped
        and not isinstance(getattr(type(thing), key, None), functools.cached_property)
    }


def _globals_read(code: types.CodeType) -> set[str]:
    """Return the names of the globals that code reads, inner functions included."""
    read = (i for i in dis.get_instructions(code) if i.opname in ("LOAD_GLOBAL", "LOAD_NAME"))
    inner = (c for c in code.co_consts if isinstance(c, types.CodeType))
    return {i.argval for i in read}.union(*map(_globals_read, inner))


def _filled(cell: types.CellType) -> bool:
    try:
        _ = cell.cell_contents
    except ValueError:
        return False
    return True


def _content(module: types.ModuleType) -> bytes:
    """Return the digest of a user's own module's file."""
    file = getattr(module, "__file__", None)
    if is_installed(module.__name__) or file is None:
        return b""
    return hashlib.sha256(Path(file).read_bytes()).digest()


def _hashed(*parts: str | bytes) -> bytes:
    """Return one digest of texts and digests, the borders between them included."""
    whole = hashlib.sha256()
    for part in parts:
        content = part.encode("utf-8", "surrogatepass") if isinstance(part, str) else part
        whole.update(len(content).to_bytes(8, "little") + content)
    return whole.digest()
