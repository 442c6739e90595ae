"""A user's dynamics: named states, inputs and parameters, one sample ahead.

A user writes one function of (x, u, p), tuples with names, that returns one entry for each state:

    def pendulum(x, u, p):
        return x.rate, -p.gravity / p.length * np.sin(x.angle) + u.torque

Entries are numbers, arrays of numbers (several points at once), complex numbers or CasADi's
symbols, whatever the model needs; the function does not see the difference.
"""

import keyword
import math
from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from zoac.core.errors import ConfigError, as_text
from zoac.core.types import is_number

Function = Callable[[Any, Any, Any], Any]


def made_of(kind: Callable[..., Any], given: Mapping[str, Any]) -> Any:
    """Call a class with arguments by name: what its pickle names, so that a copy is built anew."""
    return kind(**given)


class Dynamics:
    """What a user says of a plant, checked; `advance` maps a state to that of the next sample.

    Args:
        states: Names of the states.
        inputs: Names of the inputs.
        parameters: Values by name; a `zoac.mpc.Mpc` takes those that are tuned instead.
        step: The next state, a function of (x, u, p); or
        derivative: the state's derivative, which `substeps` steps of the classical Runge-Kutta
            method integrate over one sample, with the input constant.
        sample_time: [s], for `derivative`.
        substeps: Of the integration.

    Raises:
        ConfigError: If a name cannot be one of Python's or comes twice, or of step and derivative
            not exactly one is given.
    """

    def __init__(
        self,
        states: Iterable[str],
        inputs: Iterable[str],
        parameters: Mapping[str, float] | None = None,
        *,
        step: Function | None = None,
        derivative: Function | None = None,
        sample_time: float | None = None,
        substeps: int = 1,
    ) -> None:
        self.states, self.inputs = _names("states", states), _names("inputs", inputs)
        self.parameters = {k: float(v) for k, v in _numbers(parameters or {}).items()}
        every = [*self.states, *self.inputs, *_names("parameters", self.parameters, 0)]
        repeated = sorted({name for name in every if every.count(name) > 1})
        if repeated:
            raise ConfigError(f"states, inputs, parameters: {', '.join(repeated)} comes twice")
        if (step is None) == (derivative is None):
            raise ConfigError("a model needs step=..., the next state, or derivative=..., not both")
        if derivative is not None and not _is_positive(sample_time):
            raise ConfigError(f"sample_time={sample_time!r}: derivative needs seconds above 0")
        if not (_is_positive(substeps) and substeps % 1 == 0):
            raise ConfigError(f"substeps={substeps!r}: expected a whole number from 1")
        self._function: Function = step or derivative  # type: ignore[assignment]
        self.sample_time = None if sample_time is None else float(sample_time)
        self.substeps = int(substeps)
        self.continuous = derivative is not None
        self._given: dict[str, Any] = {
                       "states": self.states, "inputs": self.inputs, "parameters": self.parameters,
                       "step": step, "derivative": derivative, "sample_time": sample_time,
                       "substeps": substeps}  # fmt: skip

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy derives and compiles its own; buffers hold addresses.
        return made_of, (type(self), self._given)

    def advance(self, wrap: Callable[[Any], Any] = lambda f: f) -> Callable[..., Any]:
        """Return the map (x (nx, ...), u (nu, ...), p (np,)) to the next state (nx, ...).

        Args:
            wrap: Applied to every function that it consists of: numba's `njit`, say.
        """
        state, command, parameters = map(wrap, self.tuples())
        write, function = wrap(_writer(len(self.states))), self._function
        if not self.continuous:

            def step(x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
                after = np.empty_like(x)
                write(function(state(x), command(u), parameters(p)), after)
                return after

            return wrap(step)
        substeps = self.substeps
        h = (self.sample_time or 0.0) / substeps

        def runge_kutta(x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
            held, numbers = command(u), parameters(p)
            first, second, third, fourth = (
                np.empty_like(x), np.empty_like(x), np.empty_like(x), np.empty_like(x),
            )  # fmt: skip
            for _ in range(substeps):
                write(function(state(x), held, numbers), first)
                write(function(state(x + 0.5 * h * first), held, numbers), second)
                write(function(state(x + 0.5 * h * second), held, numbers), third)
                write(function(state(x + h * third), held, numbers), fourth)
                x = x + h / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
            return x

        return wrap(runge_kutta)

    def tuples(self) -> list[Callable[[Any], Any]]:
        """Return the functions that make x, u and p from arrays."""
        return [
            _tuple_of("State", self.states),
            _tuple_of("Input", self.inputs),
            _tuple_of("Parameters", self.parameters),
        ]

    def check(self) -> None:
        """See that the function returns an entry for each state.

        Raises:
            ConfigError: If it does not, or raises anything.
        """
        numbers = np.ones(len(self.states)), np.ones(len(self.inputs)), [*self.parameters.values()]
        x, u, p = (make(array) for make, array in zip(self.tuples(), numbers, strict=True))
        name = getattr(self._function, "__name__", "the function")
        try:
            with np.errstate(all="ignore"):
                count = len(getattr(self._function, "py_func", self._function)(x, u, p))
        except ArithmeticError:
            return  # a point that the model may refuse, since nobody asked for it
        except Exception as error:  # whatever a user's function raises
            raise ConfigError(
                f"model: {name}(x, u, p) raised {as_text(error)}; x, u and p are "
                f"tuples with the names {', '.join((*self.states, *self.inputs))}"
                f"{''.join(f', {name}' for name in self.parameters)}"
            ) from error
        if count != len(self.states):
            raise ConfigError(
                f"model: {name}(x, u, p) returned {count} entries, expected one for each of "
                f"{', '.join(self.states)}"
            )


def _is_positive(value: Any) -> bool:
    return is_number(value) and math.isfinite(value) and value > 0


def _numbers(given: Mapping[str, float]) -> Mapping[str, float]:
    if not isinstance(given, Mapping):
        raise ConfigError(f"parameters={given!r}: expected values by name, such as {{'mass': 1.0}}")
    for name, value in given.items():
        if not (is_number(value) and math.isfinite(value)):
            raise ConfigError(f"parameters[{name!r}]={value!r}: expected a finite number")
    return given


def _names(what: str, given: Iterable[str], least: int = 1) -> tuple[str, ...]:
    names = given.split() if isinstance(given, str) else tuple(given)
    for name in names:
        if not (isinstance(name, str) and name.isidentifier()) or keyword.iskeyword(name):
            raise ConfigError(f"{what}: {name!r} is no name; write it as a variable of Python's")
        if name.startswith("_"):
            raise ConfigError(f"{what}: the name {name!r} must not begin with an underscore")
    if len(names) < least:
        raise ConfigError(f"{what}: expected one name or more")
    return tuple(names)


def _tuple_of(kind: str, names: Iterable[str]) -> Callable[[Any], Any]:
    """Return the function that makes a named tuple from the rows of an array.

    It is written out, entry by entry, as numba needs it.
    """
    names = list(names)
    entries = ", ".join(f"v[{i}]" for i in range(len(names)))
    made: dict[str, Any] = {"Tuple": namedtuple(kind, names)}
    exec(f"def read(v):\n    return Tuple({entries})", made)
    return made["read"]


def _writer(count: int) -> Callable[[Any, Any], None]:
    """Return the function that writes the entries of a tuple into the rows of an array."""
    made: dict[str, Any] = {}
    lines = "".join(f"    into[{i}] = given[{i}]\n" for i in range(count))
    exec(f"def write(given, into):\n{lines}", made)
    return made["write"]
