"""Signals, specs and the sample time of a user's task, from Python or from a YAML file."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np

from zoac import specs as requirements
from zoac.config.named_code import locate_code
from zoac.core.errors import ConfigError, suggest
from zoac.core.types import is_number
from zoac.envs.objective import Objective
from zoac.rollout.task import Task
from zoac.specs.judge import check
from zoac.specs.signals import Signal, action, constant, info, observation
from zoac.specs.spec import Spec

SOURCES: dict[str, Callable[..., Signal]] = {
    make.__name__: make for make in (observation, action, info)
}
"""What a signal may be of in a YAML file: `{observation: 1, unit: m}`."""

KNOWN = [name for name in requirements.__all__ if name not in ("Spec", "cvar")]


def signals_of(given: Mapping[str, Any]) -> dict[str, Signal]:
    """Return signals by name.

    Args:
        given: By name: a `Signal`, a number, a function of a segment or its dotted path, or
            `{observation: i}`, `{action: i}`, `{info: key}`, each with a `unit` if wanted.

    Raises:
        ConfigError: If one is none of these.
    """
    if not isinstance(given, Mapping):
        raise ConfigError(
            f"signals={given!r}: expected signals by name, such as {{'y': zoac.observation(0)}}"
        )
    return {name: _signal(name, value) for name, value in given.items()}


def _signal(name: str, given: Any) -> Signal:
    if isinstance(given, str):
        wanted = "a function of a segment"
        given = locate_code(given, f"signals.{name}", (Signal,), (np.ndarray,), wanted)
    if isinstance(given, Signal):
        return given
    if isinstance(given, Mapping):
        fields = dict(given)
        unit = fields.pop("unit", "")
        if len(fields) != 1 or (kind := next(iter(fields))) not in SOURCES:
            raise ConfigError(
                f"signals.{name}={dict(given)!r}: expected one of {', '.join(SOURCES)}, such as "
                "{'observation': 1, 'unit': 'm'}"
            )
        return SOURCES[kind](fields[kind], unit)
    if is_number(given):
        return constant(given)
    if callable(given):
        return Signal(name, given)
    raise ConfigError(
        f"signals[{name!r}]={given!r}: expected zoac.observation(i), zoac.action(i), a "
        "number, or a function of a segment"
    )


def specs_of(given: Sequence[Any], where: str = "specs") -> tuple[Spec, ...]:
    """Return specs.

    Args:
        given: `Spec`s, or their names with their arguments: `{overshoot: {y: y, r: r, max: 0.05}}`.
            There a function `loop` is a dotted path, and `over` may be `{cvar: 0.9}`.
        where: Name of the option, for messages.

    Raises:
        ConfigError: If one is neither, or cannot be used.
    """
    if isinstance(given, Spec | Mapping):
        given = [given]
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise ConfigError(f"{where}={given!r}: expected specs, such as [zoac.specs.overshoot(...)]")
    return tuple(_spec(entry, f"{where}[{k}]") for k, entry in enumerate(given))


def _spec(given: Any, where: str) -> Spec:
    if isinstance(given, Spec):
        return given
    if not isinstance(given, Mapping) or len(given) != 1:
        raise ConfigError(
            f"{where}={given!r}: expected a spec of zoac.specs, such as "
            "{'overshoot': {'y': 'y', 'r': 'r', 'max': 0.05}}"
        )
    ((name, arguments),) = given.items()
    if name not in KNOWN:
        raise ConfigError(f"{where}: no spec {name!r}; {suggest(name, KNOWN)}")
    make = getattr(requirements, name)
    if not isinstance(arguments, Mapping):
        raise ConfigError(f"{where}.{name}={arguments!r}: expected arguments by name")
    arguments = {str(key): value for key, value in arguments.items()}
    if isinstance(loop := arguments.get("loop"), str):
        wanted = "a function of the parameters that returns a system of python-control"
        arguments["loop"] = locate_code(loop, f"{where}.{name}.loop", (), (), wanted)
    if isinstance(over := arguments.get("over"), Mapping) and set(over) == {"cvar"}:
        arguments["over"] = requirements.cvar(over["cvar"])
    try:
        made: Spec = make(**arguments)
    except ConfigError as error:
        raise ConfigError(f"{where}.{error}") from None
    return made


def with_objective(specs: tuple[Spec, ...], objective: Any) -> tuple[str, tuple[Spec, ...]]:
    """Return which signal of the environment is the cost, and the specs with the soft ones.

    Args:
        specs: Hard ones, and soft ones if they shall be the objective.
        objective: A name as in `zoac.envs.objective`; or a soft spec, or several, whose weighted
            sum replaces the cost.

    Raises:
        ConfigError: If the objective is a spec with a limit, or there are two objectives.
    """
    soft = [spec for spec in specs if not spec.hard]
    if isinstance(objective, str):
        if soft and objective != "auto":
            raise ConfigError(
                f"objective={objective!r}, and {soft[0]} has no limit, which makes it the "
                "objective; give it max= or min=, or leave one of the two out"
            )
        # The reward is not looked at where specs replace it.
        return ("reward" if soft else objective), specs
    if not isinstance(objective, Spec | Mapping | Sequence):
        Objective(objective)  # says which there are
    for spec in (parts := specs_of(objective, "objective")):
        if spec.hard:
            raise ConfigError(
                f"objective={spec}: it has a limit, {spec.limit}; give it in specs=, and in "
                "objective= without one"
            )
    return "reward", (*specs, *parts)


def require(task: Task, options: Mapping[str, Any]) -> None:
    """Give a task `signals`, `sample_time`, `specs` and `objective` of `zoac.tune`'s options.

    They stand beside its own; a signal of the same name, and soft specs, take their place.

    Raises:
        ConfigError: If one cannot be used.
    """
    _, added = with_objective(specs_of(options["specs"]), options["objective"])
    signals, seconds = options["signals"], options["sample_time"]
    if not (signals or added or seconds):
        return
    kept = [s for s in task.specs if s.hard or all(other.hard for other in added)]
    task.signals = {**task.signals, **signals_of(signals or {})}
    task.sample_time = _seconds(seconds) or task.sample_time
    task.specs = (*kept, *added)
    task.objective = objective_text(added, task.objective)
    check(task.specs, task.signals, task.sample_time)


def sample_time_of(given: float | None, env: gymnasium.Env) -> float | None:
    """Return the seconds of a step: what is given, or what the environment says; None: unknown.

    An environment says it by an attribute `sample_time` or `dt`, or by the key `sample_time` of its
    metadata.

    Raises:
        ConfigError: If it is no number above 0.
    """
    if given is None:
        inner = env.unwrapped
        told = [getattr(inner, name, None) for name in ("sample_time", "dt")]
        told.append(inner.metadata.get("sample_time"))
        given = next(filter(is_number, told), None)
    return _seconds(given)


def _seconds(given: Any) -> float | None:
    if given is not None and not (is_number(given) and math.isfinite(given) and given > 0):
        raise ConfigError(f"sample_time={given!r}: expected seconds, above 0")
    return None if given is None else float(given)


def shortest_horizon_of(env: gymnasium.Env) -> int:
    """Return the steps after which an episode can tell good parameters from bad ones; 0: unknown.

    An environment says it by an attribute `shortest_horizon`, or by that key of its metadata.

    Raises:
        ConfigError: If it is no whole number above 0.
    """
    inner = env.unwrapped
    told = getattr(inner, "shortest_horizon", inner.metadata.get("shortest_horizon"))
    if told is None:
        return 0
    if not (is_number(told) and told >= 1 and told % 1 == 0):
        raise ConfigError(f"shortest_horizon={told!r}: expected steps, a whole number above 0")
    return int(told)


def objective_text(specs: Sequence[Spec], otherwise: str) -> str:
    """Return what is minimised, for people to read."""
    soft = [spec for spec in specs if not spec.hard]
    return " + ".join(f"{s}" if s.weight == 1 else f"{s.weight:g} {s}" for s in soft) or otherwise
