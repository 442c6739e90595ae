"""A user's own environment, controller and bounds, as a task."""

import copy
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property, partial
from typing import Any, Protocol, Self

import gymnasium
import numpy as np

from zoac.config.named_code import locate_code
from zoac.controllers.user_controller import as_controller
from zoac.core.controller import Controller
from zoac.core.errors import ConfigError
from zoac.core.measures import Constraint, Metric
from zoac.core.parameters import ParameterSpace
from zoac.core.types import is_number
from zoac.envs.gymnasium_adapter import GymnasiumVecEnv
from zoac.envs.objective import Objective
from zoac.envs.plant_numbers import Bounds, PlantNumbers
from zoac.envs.single_env import EnvSource, env_action, single_env
from zoac.rollout.task import Task
from zoac.specs.judge import check
from zoac.specs.spec import Spec
from zoac.tasks.user_fmu import FmuFile
from zoac.tasks.user_space import parse_space
from zoac.tasks.user_specs import (
    objective_text,
    sample_time_of,
    shortest_horizon_of,
    signals_of,
    specs_of,
    with_objective,
)

MAX_STEPS = 10_000_000
"""Steps of an episode that a user may ask for."""

_DOTTED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+")


class Acts(Protocol):
    """What has a method `act`."""

    def act(self, *given: Any) -> Any:
        """Return the action."""
        ...


class UserTask(Task):
    """A task from a user's environment, controller and bounds.

    As `user_task` it is the `_target_` of a YAML file of his own.
    """

    def __init__(
        self,
        *,
        env: EnvSource,
        controller: Any,
        space: ParameterSpace | Mapping[str, Any],
        baseline: Mapping[str, Any] | None = None,
        metrics: Sequence[Metric] | Mapping[str, Any] = (),
        constraints: Sequence[Constraint] | Mapping[str, Any] = (),
        max_episode_steps: int | None = None,
        plant: Mapping[str, float] | None = None,
        vary: Mapping[str, Bounds] | None = None,
        objective: str | Spec | Mapping[str, Any] | Sequence[Any] = "auto",
        signals: Mapping[str, Any] | None = None,
        sample_time: float | None = None,
        specs: Sequence[Any] = (),
        observations: Sequence[str] | None = None,
        actions: Sequence[str] | Mapping[str, Bounds] | None = None,
        cost: Any = None,
        step_size: float | None = None,
        stop_time: float | None = None,
    ) -> None:
        """
        Args:
            env: A Gymnasium id, a function (or class) that makes an environment, its dotted path,
                or an environment, which is then copied; or the path of an `.fmu` file.
            controller: See `zoac.controllers.user_controller.as_controller`; or the dotted path of
                such a thing.
            space: See `zoac.tasks.user_space.parse_space`.
            baseline: Today's values, beside those that `space` names.
            metrics: Reported beside the cost: `Metric`s, or functions of a segment, or their dotted
                paths, by name.
            constraints: What must hold at every step: `Constraint`s, or functions likewise.
            max_episode_steps: Cut episodes here; needed if the environment does not end by itself.
            plant: Attributes of the innermost environment, and the numbers they are set to before
                every reset.
            vary: Likewise, and the range from which every episode draws.
            objective: What is minimised: "reward", its negative; "cost", `info["cost"]`;
                "info:<key>", another number of info; "auto", the negative reward unless
                `info["cost"]` differs from it, which is refused; or a spec without a limit, or
                several, whose weighted sum counts.
            signals: What specs and figures call the numbers of an episode; see
                `zoac.tasks.user_specs.signals_of`.
            sample_time: Seconds of a step; None: the environment's attribute `sample_time` or
                `dt`, or what its metadata say.
            specs: Requirements on whole episodes; see `zoac.tasks.user_specs.specs_of`.
            observations: Of an FMU: names of variables; see `zoac.envs.FmuEnv`, also for the
                others.
            actions: Of an FMU: names of inputs, or bounds [low, high] by name.
            cost: Of an FMU: a variable, a function of {name: value}, or the dotted path of one.
            step_size: Of an FMU: seconds of a step.
            stop_time: Of an FMU: seconds of an episode.

        Raises:
            ConfigError: If any of them cannot be used.
        """
        if max_episode_steps is not None and not _is_count(max_episode_steps):
            raise ConfigError(
                f"max_episode_steps={max_episode_steps!r}: expected 1 or more, a whole number, at "
                f"most {MAX_STEPS:,}"
            )
        for what, numbers in (("plant", plant), ("vary", vary)):
            by_name = isinstance(numbers, Mapping) and all(isinstance(k, str) for k in numbers)
            if not (by_name or numbers is None):
                raise ConfigError(f"{what}={numbers!r}: expected numbers by attribute")
        of_fmu = {"observations": observations, "actions": actions, "cost": cost,
                  "step_size": step_size, "stop_time": stop_time}  # fmt: skip
        if isinstance(env, str) and env.endswith(".fmu"):
            env = FmuFile(env, **of_fmu)
        elif given := [name for name, value in of_fmu.items() if value is not None]:
            raise ConfigError(f"{', '.join(given)}: only for an FMU, with env: <path>.fmu")
        if isinstance(env, str) and _DOTTED.fullmatch(env):
            kinds = (gymnasium.Env,)
            wanted = "a gymnasium.Env, its class, or a function that makes one"
            env = locate_code(env, "env", kinds, kinds, wanted)
        if isinstance(controller, str):
            wanted = "a function act(params, obs), an object with such a method, or what makes one"
            returned = (np.ndarray, float, int, Acts)
            controller = locate_code(controller, "controller", (Acts,), returned, wanted)
        self.space, self.fixed, values = parse_space(space, baseline)
        of_env, self.specs = with_objective(specs_of(specs), objective)
        self._env, self._controller = env, controller
        self.baseline = values or None
        self.metrics = tuple(_named(metrics, Metric, "metrics"))
        self.constraints = tuple(_named(constraints, Constraint, "constraints"))
        self._max_episode_steps = None if max_episode_steps is None else int(max_episode_steps)
        self._plant, self._vary = dict(plant or {}), dict(vary or {})
        self._objective = of_env
        self.objective = objective_text(self.specs, str(Objective(of_env)))
        self.signals = signals_of({} if signals is None else signals)
        if self.signals or self.specs or sample_time is not None:
            self.sample_time = self._seen(lambda env: sample_time_of(sample_time, env))
            check(self.specs, self.signals, self.sample_time)
        self.make_controller()  # says what is wrong with it

    def parts(self) -> dict[str, Any]:
        return {
            "env": self._env,
            "controller": self._controller,
            "metrics": {metric.name: metric for metric in self.metrics},
            "constraints": {constraint.name: constraint for constraint in self.constraints},
            "specs": {spec.label: spec for spec in self.specs},
            "signals": dict(self.signals),
        }

    def make_env(self, n: int) -> GymnasiumVecEnv:
        """Return `n` copies of the environment, side by side."""
        make = partial(single_env, self._env)
        return GymnasiumVecEnv(
            [make() for _ in range(n)],
            self._max_episode_steps,
            self._plant,
            self._vary,
            make=make,
            objective=self._objective,
            info=tuple(s.info for s in self.signals.values() if s.info is not None),
        )

    def _seen(self, look: Callable[[gymnasium.Env], Any]) -> Any:
        """Return what a look at an environment tells; it is made for it and closed."""
        env = single_env(self._env)
        try:
            return look(env)
        finally:
            with suppress(Exception):  # it has served
                env.close()

    def make_controller(self) -> Controller:
        return as_controller(self._controller, self.fixed, self.space)

    def env_action(self, action: np.ndarray) -> Any:
        return env_action(self._action_space, action)

    @cached_property
    def _action_space(self) -> gymnasium.Space:
        return self._seen(lambda env: env.action_space)

    @cached_property
    def shortest_horizon(self) -> int:
        """See `Task.shortest_horizon`; what the environment says."""
        return self._seen(shortest_horizon_of)

    def with_plant(self, plant: Mapping[str, float]) -> Self:
        """Return the same task on a plant with other numbers; they no longer vary."""
        other = copy.copy(self)
        other._plant = {**self._plant, **plant}
        other._vary = {k: v for k, v in self._vary.items() if k not in plant}
        return other

    def varied(self, vary: Mapping[str, Bounds]) -> PlantNumbers:
        """Return what draws such numbers of the plant: whole ones where the plant's are whole."""
        return self._seen(lambda env: PlantNumbers(env, {}, vary))


user_task = UserTask


def _is_count(value: Any) -> bool:
    return is_number(value) and value % 1 == 0 and 1 <= value <= MAX_STEPS


def _named(given: Sequence[Any] | Mapping[str, Any], kind: Any, where: str) -> list[Any]:
    """Return metrics or constraints from functions or dotted paths by name."""
    found = []
    if isinstance(given, Mapping):
        wanted = f"a {kind.__name__}, or a function of a segment"
        for name, value in given.items():
            if isinstance(value, str):
                value = locate_code(value, f"{where}.{name}", (kind,), (np.ndarray,), wanted)
            found.append(value if isinstance(value, kind) else kind(name, value))
    else:
        several = isinstance(given, Sequence) and not isinstance(given, str)
        for value in given if several else [given]:
            if not isinstance(value, kind):
                raise ConfigError(
                    f"{where}: {value!r} is no {kind.__name__}; give functions by name, such as "
                    f"{where}={{'my_name': function}}"
                )
            found.append(value)
    names = [value.name for value in found]
    repeated = {name for name in names if names.count(name) > 1}
    if repeated:
        raise ConfigError(f"{where}: names must differ; repeated: {', '.join(sorted(repeated))}")
    return found
