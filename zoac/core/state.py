"""What goes into a checkpoint: numbers, text and arrays as such, and a user's objects in a pickle.

A state is a tree of dicts, lists and tuples. Its leaves are numbers, text, None, arrays and random
generators, kept as JSON and arrays (npz). Anything else is refused, unless it is an `OwnObject`:
those are pickled together, apart from the rest. The pickle is opened when one of them is used.
"""

import io
import json
import sys
import threading
from collections.abc import Callable
from copy import deepcopy
from dataclasses import astuple, is_dataclass
from functools import cache
from typing import Any, ClassVar, Literal, NamedTuple

import cloudpickle
import numpy as np

from zoac.core.errors import UnsavableError

_PLAIN = (bool, int, float, str, type(None))
_TREE = "tree"


class OwnObject:
    """Something that only a pickle can keep: a user's environment, a library's optimiser."""

    def __init__(self, value: Any = None, read: Callable[[], Any] | None = None) -> None:
        """
        Args:
            value: The object itself.
            read: Called for the object whenever it is used, in place of `value`.
        """
        self._read = read or (lambda: value)

    @property
    def value(self) -> Any:
        """The object itself."""
        return self._read()

    def __reduce__(self) -> Any:
        return OwnObject, (self.value,)


class Kept:
    """Saves and restores the attributes that the class and each of its bases name in `kept`.

    An attribute is a number, text, an array, or a dict, list or tuple of them; a dataclass of
    them; a random generator; or something that has `state` and `restore` itself. One that is a
    dataclass stays one of that class, and holds no others.
    """

    kept: ClassVar[str] = ""

    def state(self) -> dict[str, Any]:
        """Return a copy of what is kept, by name."""
        return {name: _state_of(getattr(self, name)) for name in self._all_kept()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        for name in self._all_kept():
            setattr(self, name, _restored(getattr(self, name), state[name]))

    def _all_kept(self) -> list[str]:
        return " ".join(vars(kind).get("kept", "") for kind in type(self).__mro__).split()


def _state_of(value: Any) -> Any:
    if isinstance(value, np.random.Generator):
        return value.bit_generator.state
    if hasattr(value, "restore"):
        return value.state()
    if is_dataclass(value) and not isinstance(value, type):
        return astuple(value)  # a copy
    return deepcopy(value)


def _restored(value: Any, state: Any) -> Any:
    """Return what takes the place of an attribute's value."""
    if isinstance(value, np.random.Generator):
        value.bit_generator.state = state
    elif hasattr(value, "restore"):
        value.restore(state)
    else:
        kind: Any = type(value)
        fresh = deepcopy(state)
        return kind(*fresh) if is_dataclass(value) else fresh
    return value


class Encoded(NamedTuple):
    """A state as bytes: an npz file, and a pickle, which is empty where none is needed."""

    plain: bytes
    objects: bytes


def encode(state: Any) -> Encoded:
    """Return a state as bytes.

    Raises:
        UnsavableError: If it holds something that is neither plain nor an `OwnObject`.
        Exception: Whatever an `OwnObject` raises when it is pickled.
    """
    writer = _Writer()
    tree = json.dumps(writer.tree(state, "the state")).encode()
    arrays: dict[str, Any] = {_TREE: np.frombuffer(tree, np.uint8)}
    for kind, parts in writer.arrays.items():
        arrays[kind] = np.concatenate(parts, dtype=kind)
    file = io.BytesIO()
    np.savez(file, **arrays)
    objects = pickled(writer.objects) if writer.objects else b""
    return Encoded(file.getvalue(), objects)


def decode(encoded: Encoded) -> Any:
    """Return the state that `encode` took; its `OwnObject`s open their pickle when first used."""
    with np.load(io.BytesIO(encoded.plain), allow_pickle=False) as file:
        arrays = dict(file)
    objects = cache(lambda: cloudpickle.loads(encoded.objects))
    return _Reader(arrays, objects).value(json.loads(arrays[_TREE].tobytes()))


class _Writer:
    """Takes a state apart. Arrays of one type become one long array, which is fast to write."""

    def __init__(self) -> None:
        self.arrays: dict[str, list[np.ndarray]] = {}
        self.objects: list[Any] = []
        self._sizes: dict[str, int] = {}

    def tree(self, value: Any, where: str) -> Any:
        kind = type(value)
        if kind in _PLAIN:
            return value
        if kind is list:
            return [self.tree(v, f"{where}[{i}]") for i, v in enumerate(value)]
        if kind is tuple:
            return {"tuple": self.tree(list(value), where)}
        if kind is dict:
            items = [(self.tree(k, where), self.tree(v, f"{where}[{k!r}]"))
                     for k, v in value.items()]  # fmt: skip
            return {"dict": items}
        if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biufcSU":
            return {"array" if kind is np.ndarray else "scalar": self._array(np.asarray(value))}
        if kind is np.random.Generator:
            return {"generator": self.tree(value.bit_generator.state, where)}
        if isinstance(value, OwnObject):
            self.objects.append(value.value)
            return {"object": len(self.objects) - 1}
        raise UnsavableError(
            f"{where} is a {kind.__module__}.{kind.__qualname__}, which a checkpoint cannot hold: "
            "expected numbers, text, None, arrays, random generators, and dicts, lists and tuples "
            "of them; wrap an object in zoac.core.state.OwnObject"
        )

    def _array(self, array: np.ndarray) -> list[Any]:
        order: Literal["F", "C"] = "F" if array.flags.fnc else "C"
        kind = array.dtype.str
        start = self._sizes.get(kind, 0)
        self.arrays.setdefault(kind, []).append(array.ravel(order))
        self._sizes[kind] = start + array.size
        return [kind, start, list(array.shape), order]


class _Reader:
    def __init__(self, arrays: dict[str, np.ndarray], objects: Callable[[], list[Any]]) -> None:
        self._arrays, self._objects = arrays, objects

    def value(self, node: Any) -> Any:
        if isinstance(node, list):
            return [self.value(part) for part in node]
        if not isinstance(node, dict):
            return node
        ((kind, content),) = node.items()
        if kind == "tuple":
            return tuple(self.value(content))
        if kind == "dict":
            return {self.value(key): self.value(value) for key, value in content}
        if kind == "array":
            return self._array(*content)
        if kind == "scalar":
            return self._array(*content)[()]
        if kind == "generator":
            return _generator(self.value(content))
        if kind == "object":
            return OwnObject(read=lambda: self._objects()[content])
        raise KeyError(kind)

    def _array(self, kind: str, start: int, shape: list[int], order: Any) -> np.ndarray:
        flat = self._arrays[kind][start : start + int(np.prod(shape))]
        return flat.reshape(shape, order=order).copy(order)


def _generator(state: dict[str, Any]) -> np.random.Generator:
    made = getattr(np.random, state["bit_generator"])()
    made.state = state
    return np.random.Generator(made)


_SCRIPT = "__mp_main__"
"""What multiprocessing calls the user's script in the processes that it spawns."""

_registry = threading.Lock()


def pickled(thing: Any) -> bytes:
    """Return a pickle that holds what the user's script defines by value, if spawned as well."""
    script = sys.modules.get(_SCRIPT)
    if script is None:
        return cloudpickle.dumps(thing)
    with _registry:
        if _SCRIPT in cloudpickle.list_registry_pickle_by_value():
            return cloudpickle.dumps(thing)
        cloudpickle.register_pickle_by_value(script)
        try:
            return cloudpickle.dumps(thing)
        finally:
            cloudpickle.unregister_pickle_by_value(script)
