"""A user's own single-lane environment and controller, as lanes."""

from __future__ import annotations

import copy
import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

from zoac.checks import locate
from zoac.environment import LaneEnv
from zoac.errors import ConfigError, EnvironmentContractError, suggest
from zoac.parameters import Parameter, ParameterSpace, choice
from zoac.seeding import stream
from zoac.task import Constraint, Controller, Diagnostics, Memory, Metric, Parameters, Task

EnvSource = str | gymnasium.Env | Callable[[], gymnasium.Env]
Bounds = tuple[float, float] | list[float]


class GymnasiumLanes(LaneEnv):
    """n copies of a `gymnasium.Env`, stepped one after the other.

    The cost of a step is `info["cost"]` if the environment gives one, else the negative reward.
    A lane is saved by a deep copy of its environment.
    """

    def __init__(
        self,
        envs: Sequence[gymnasium.Env],
        max_episode_steps: int | None,
        plant: Mapping[str, float] | None = None,
        vary: Mapping[str, Bounds] | None = None,
    ) -> None:
        """
        Args:
            envs: One environment a lane.
            max_episode_steps: Cut episodes here; None: where the environment's own limit does.
            plant: Attributes of the innermost environment, and the numbers they are set to.
            vary: Likewise, and the range (low, high) from which every episode draws uniformly.

        Raises:
            ConfigError: If its spaces are of a kind that cannot be tuned on, or it has no such
                attribute.
        """
        first = envs[0]
        if not isinstance(first.observation_space, Box):
            raise ConfigError(
                f"the environment's observations are {first.observation_space}; expected a Box "
                "(wrap it, for instance with gymnasium.wrappers.FlattenObservation)"
            )
        size = int(np.prod(first.observation_space.shape))
        observations = Box(-np.inf, np.inf, (size,), np.float64)
        if isinstance(first.action_space, Discrete):
            actions = Box(-np.inf, np.inf, (1,), np.float64)
        elif isinstance(first.action_space, Box):
            flat = int(np.prod(first.action_space.shape))
            actions = Box(-np.inf, np.inf, (flat,), np.float64)
        else:
            raise ConfigError(
                f"the environment's actions are {first.action_space}; expected a Box or Discrete"
            )
        limit = max_episode_steps or (first.spec.max_episode_steps if first.spec else None)
        super().__init__(len(envs), observations, actions, limit or np.iinfo(np.int64).max)
        self._envs = list(envs)
        for name, value in (plant or {}).items():
            for env in self._envs:
                _set_plant(env, name, float(value))
        self._vary = {name: _range(name, bounds) for name, bounds in (vary or {}).items()}
        self._draws: list[np.random.Generator] = [np.random.default_rng(0) for _ in envs]
        self._seen = np.zeros((len(envs), size))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """See `LaneEnv.reset`."""
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if isinstance(seed, (int, np.integer)):
            seeds: Sequence[int | None] = [int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = seed or [None] * self.num_envs
        lanes = range(self.num_envs) if mask is None else np.flatnonzero(mask).tolist()
        for lane in lanes:
            lane_seed = seeds[lane]
            # Many environments hand their seed to libraries that take 32 bits.
            short = None if lane_seed is None else int(lane_seed) % 2**31
            if lane_seed is not None and self._vary:
                self._draws[lane] = stream(int(lane_seed), "plant")
            for name, (low, high) in self._vary.items():
                _set_plant(self._envs[lane], name, float(self._draws[lane].uniform(low, high)))
            result = self._envs[lane].reset(seed=short, options=options or None)
            observation, _ = _parts(result, "reset", ("observation", "info"))
            self._see(lane, observation)
            self._steps[lane] = 0
        return self._seen.copy(), {}

    def step(
        self, actions: np.ndarray, mask: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """See `LaneEnv.step`."""
        n = self.num_envs
        cost, terminated, truncated = np.zeros(n), np.zeros(n, bool), np.zeros(n, bool)
        for lane in range(n) if mask is None else np.flatnonzero(mask).tolist():
            action = env_action(self._envs[lane].action_space, actions[lane])
            result = self._envs[lane].step(action)
            observation, reward, terminated[lane], cut, info = _parts(result, "step", _STEP)
            self._see(lane, observation)
            cost[lane] = info.get("cost", -float(reward))
            if not np.isfinite(cost[lane]):
                raise EnvironmentContractError(
                    f"the environment's step gave the cost {cost[lane]} (reward {reward!r}), "
                    "expected a finite number"
                )
            self._steps[lane] += 1
            over_time = self._steps[lane] >= self.max_episode_steps
            truncated[lane] = (cut or over_time) and not terminated[lane]
        return self._seen.copy(), -cost, terminated, truncated, {"cost": cost}

    def _see(self, lane: int, observation: Any) -> None:
        flat = np.asarray(observation, dtype=np.float64).reshape(-1)
        if flat.shape != self._seen[lane].shape:
            raise EnvironmentContractError(
                f"the environment returned an observation of {flat.size} numbers, expected "
                f"{self._seen.shape[1]} as its observation_space says"
            )
        if not np.isfinite(flat).all():
            raise EnvironmentContractError(
                f"the environment returned the observation {flat.tolist()}; every number must be "
                "finite"
            )
        self._seen[lane] = flat

    def state(self, lanes: Sequence[int] | np.ndarray) -> dict[str, Any]:
        """See `LaneEnv.state`."""
        return {
            "envs": [copy.deepcopy(self._envs[lane]) for lane in np.asarray(lanes).tolist()],
            "draws": [copy.deepcopy(self._draws[lane]) for lane in np.asarray(lanes).tolist()],
            "seen": self._seen[lanes].copy(),
            "steps": self._steps[lanes].copy(),
        }

    def restore(self, lanes: Sequence[int] | np.ndarray, state: dict[str, Any]) -> np.ndarray:
        """See `LaneEnv.restore`."""
        rows = zip(np.asarray(lanes).tolist(), state["envs"], state["draws"], strict=True)
        for lane, env, draws in rows:
            self._envs[lane] = copy.deepcopy(env)
            self._draws[lane] = copy.deepcopy(draws)
        self._seen[lanes] = state["seen"]
        self._steps[lanes] = state["steps"]
        return self._seen.copy()

    def close(self, **kwargs: Any) -> None:
        """Close every environment."""
        for env in self._envs:
            env.close()


def env_action(space: gymnasium.Space, action: np.ndarray) -> Any:
    """Return a controller's action (m,) as the environment takes it.

    Args:
        space: Its action space: Discrete, where the nearest action counts, or Box, whose bounds
            clip.
        action: What the controller returned.
    """
    if isinstance(space, Discrete):
        return int(space.start + np.clip(round(float(action[0])) - space.start, 0, space.n - 1))
    assert isinstance(space, Box)
    return np.clip(action.reshape(space.shape), space.low, space.high).astype(space.dtype)


def _set_plant(env: gymnasium.Env, name: str, value: float) -> None:
    inner = env.unwrapped
    present = getattr(inner, name, None)
    if not isinstance(present, (int, float, np.number)):
        numbers = [k for k, v in vars(inner).items() if isinstance(v, (int, float, np.number))]
        raise ConfigError(
            f"{type(inner).__name__} has no number {name!r} to set; {suggest(name, numbers)}"
        )
    setattr(inner, name, value)


def _range(name: str, bounds: Bounds) -> tuple[float, float]:
    if len(bounds) != 2 or not bounds[0] <= bounds[1]:
        raise ConfigError(f"vary.{name}={list(bounds)}: expected [low, high]")
    return float(bounds[0]), float(bounds[1])


_STEP = ("observation", "reward", "terminated", "truncated", "info")


def _parts(result: Any, method: str, expected: tuple[str, ...]) -> tuple[Any, ...]:
    """Return what an environment's method returned, if it has the parts that Gymnasium asks for."""
    if isinstance(result, tuple) and len(result) == len(expected) and isinstance(result[-1], dict):
        return result
    found = f"{len(result)} values" if isinstance(result, tuple) else type(result).__name__
    raise EnvironmentContractError(
        f"the environment's {method} returned {found}, expected ({', '.join(expected)}), info a "
        "dict; an environment of the old Gym must be wrapped"
    )


class ScalarController:
    """`act(params, obs)` for one lane, as a `Controller`.

    What has a method `act` may keep state in its attributes and begin an episode in `reset()`; it
    is then copied before every call, so that lanes, saved states and branches stay apart.
    """

    def __init__(
        self, controller: Any, fixed: Mapping[str, float], space: ParameterSpace | None = None
    ) -> None:
        """
        Args:
            controller: A function `act(params, obs)`, or an object with such a method, where
                params is {name: number} and obs (o,); returns a number or an array (m,).
            fixed: Parameters that are not tuned, handed on with the others.
            space: Of the tuned ones, so that whole numbers come as int and options as such.
        """
        self._controller = controller
        self._plain = {p.name: p.plain for p in space.parameters} if space is not None else {}
        self._fixed = dict(fixed)
        self._remembers = hasattr(controller, "act")

    def init(self, n: int) -> Memory:
        """Return one fresh controller a lane, if it may remember."""
        if not self._remembers:
            return {}
        fresh = np.empty(n, dtype=object)
        for lane in range(n):
            fresh[lane] = copy.deepcopy(self._controller)
            if hasattr(fresh[lane], "reset"):
                fresh[lane].reset()
        return {"controller": fresh}

    def act(
        self, params: Parameters, obs: np.ndarray, memory: Memory
    ) -> tuple[np.ndarray, Memory, Diagnostics]:
        """See `Controller.act`."""
        following = np.empty(len(obs), dtype=object)
        actions = []
        for lane in range(len(obs)):
            values = {
                name: self._plain.get(name, float)(value[lane]) for name, value in params.items()
            }
            act = self._controller
            if self._remembers:
                following[lane] = copy.deepcopy(memory["controller"][lane])
                act = following[lane].act
            action = act({**values, **self._fixed}, obs[lane].copy())
            actions.append(np.atleast_1d(np.asarray(action, dtype=np.float64)).reshape(-1))
        return np.stack(actions), {"controller": following} if self._remembers else {}, {}


class UserTask(Task):
    """A task from a user's environment, controller and bounds."""

    def __init__(
        self,
        env: EnvSource,
        controller: Any,
        space: ParameterSpace,
        fixed: Mapping[str, float] | None = None,
        start: Mapping[str, Any] | None = None,
        metrics: Sequence[Metric] = (),
        max_episode_steps: int | None = None,
        constraints: Sequence[Constraint] = (),
        plant: Mapping[str, float] | None = None,
        vary: Mapping[str, Bounds] | None = None,
    ) -> None:
        """
        Args:
            env: A Gymnasium id, a function that makes an environment, or an environment, which is
                then copied for every lane.
            controller: A batched `Controller` (it has `init`), or see `ScalarController`.
            space: What is tuned.
            fixed: Parameters that are not.
            start: Today's values, for comparison and as a start.
            metrics: Reported beside the cost.
            max_episode_steps: Cut episodes here.
            constraints: What must hold at every step.
            plant: See `GymnasiumLanes`.
            vary: See `GymnasiumLanes`.
        """
        self._env, self._controller, self.fixed = env, controller, dict(fixed or {})
        self.space, self.metrics, self.constraints = space, tuple(metrics), tuple(constraints)
        self.nominal = dict(start) if start is not None else None
        self._max_episode_steps = max_episode_steps
        self._plant, self._vary = dict(plant or {}), dict(vary or {})

    def make_env(self, n: int) -> GymnasiumLanes:
        """Return `n` environments as lanes."""
        envs = [self._one_env() for _ in range(n)]
        return GymnasiumLanes(envs, self._max_episode_steps, self._plant, self._vary)

    def _one_env(self) -> gymnasium.Env:
        if isinstance(self._env, str):
            return gymnasium.make(self._env)
        if isinstance(self._env, gymnasium.Env):
            return copy.deepcopy(self._env)
        return self._env()

    def make_controller(self) -> Controller:
        """Return the user's controller."""
        if hasattr(self._controller, "init") and hasattr(self._controller, "act"):
            return self._controller
        return ScalarController(self._controller, self.fixed, self.space)

    def env_action(self, action: np.ndarray) -> Any:
        """See `Task.env_action`."""
        return env_action(self._action_space, action)

    @cached_property
    def _action_space(self) -> gymnasium.Space:
        env = self._one_env()
        env.close()
        return env.action_space

    def with_plant(self, plant: Mapping[str, float]) -> UserTask:
        """Return the same task on a plant with other numbers; they no longer vary."""
        other = copy.copy(self)
        other._plant = {**self._plant, **plant}
        other._vary = {k: v for k, v in self._vary.items() if k not in plant}
        return other


def user_task(
    *,
    env: EnvSource,
    controller: Any,
    space: ParameterSpace | Mapping[str, Any],
    start: Mapping[str, Any] | None = None,
    metrics: Sequence[Metric] | Mapping[str, Any] = (),
    constraints: Sequence[Constraint] | Mapping[str, Any] = (),
    max_episode_steps: int | None = None,
    plant: Mapping[str, float] | None = None,
    vary: Mapping[str, Bounds] | None = None,
) -> UserTask:
    """Return a task from what a user has; `_target_: zoac.adapters.user_task` in a YAML file.

    Args:
        env: A Gymnasium id, a function (or class) that makes an environment, its dotted path, or
            an environment.
        controller: `act(params, obs)`, an object with such a method, or the dotted path of one; a
            class is called without arguments.
        space: See `parse_space`.
        start: Today's values, beside those that `space` names.
        metrics: Reported beside the cost: `Metric`s, or functions of a segment, or their dotted
            paths, by name.
        constraints: What must hold at every step: `Constraint`s, or functions likewise.
        max_episode_steps: Cut episodes here; needed if the environment does not end by itself.
        plant: Attributes of the innermost environment, and the numbers they are set to.
        vary: Likewise, and the range from which every episode draws.

    Raises:
        ConfigError: If any of them cannot be used.
    """
    if isinstance(env, str) and _DOTTED.fullmatch(env):
        env = locate(env, "env")
    if isinstance(controller, str):
        controller = locate(controller, "controller")
    if inspect.isclass(controller):
        controller = controller()
    if not (callable(controller) or hasattr(controller, "act")):
        raise ConfigError(
            f"controller={controller!r}: expected a function act(params, obs) or an object with "
            "a method of that name"
        )
    parsed, fixed, starts = parse_space(space)
    starts = {**starts, **(start or {})}
    if starts:
        parsed.unit(starts)  # says what is wrong with a start value
    return UserTask(
        env,
        controller,
        parsed,
        fixed,
        starts or None,
        _named(metrics, Metric, "metrics"),
        max_episode_steps,
        _named(constraints, Constraint, "constraints"),
        plant,
        vary,
    )


_DOTTED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+")


def _named(given: Sequence[Any] | Mapping[str, Any], kind: Any, where: str) -> list[Any]:
    """Return metrics or constraints from functions or dotted paths by name."""
    if not isinstance(given, Mapping):
        return list(given)
    located = {
        name: locate(value, f"{where}.{name}") if isinstance(value, str) else value
        for name, value in given.items()
    }
    return [v if isinstance(v, kind) else kind(name, v) for name, v in located.items()]


def parse_space(
    space: ParameterSpace | Mapping[str, Any],
) -> tuple[ParameterSpace, dict[str, float], dict[str, Any]]:
    """Return the space, the fixed parameters and the start values that a dict describes.

    Args:
        space: A `ParameterSpace`, or by name: `(low, high)`, `(low, high, "log")`,
            `(low, high, "integer")`, `{"low": ..., "high": ..., "scale": ..., "unit": ...,
            "start": ...}`, `{"choices": [...], "start": ...}`, or one number, which is fixed.

    Raises:
        ConfigError: If an entry is none of these.
    """
    if isinstance(space, ParameterSpace):
        return space, {}, {}
    parameters: list[Parameter] = []
    fixed: dict[str, float] = {}
    start: dict[str, Any] = {}
    for name, entry in space.items():
        if isinstance(entry, (int, float)):
            fixed[name] = float(entry)
        elif isinstance(entry, Mapping):
            entry = dict(entry)
            if "start" in entry:
                given = entry.pop("start")
                start[name] = given if "choices" in entry else float(given)
            parameters.append(_parameter(name, entry))
        elif isinstance(entry, Sequence) and not isinstance(entry, str):
            parameters.append(_parameter(name, dict(zip(_FIELDS, entry, strict=False))))
        else:
            raise ConfigError(
                f"space[{name!r}]={entry!r}: expected (low, high), (low, high, 'log'), a dict or "
                "a number"
            )
    return ParameterSpace(parameters), fixed, start


_FIELDS = ("low", "high", "scale", "unit")


def _parameter(name: str, fields: Mapping[str, Any]) -> Parameter:
    fields = dict(fields)
    if fields.get("scale") == "integer":
        fields |= {"scale": "linear", "kind": "integer"}
    try:
        if "choices" in fields:
            return choice(name, fields.pop("choices"), **fields)
        return Parameter(name=name, **fields)
    except TypeError:
        raise ConfigError(
            f"space[{name!r}]={dict(fields)!r}: expected low and high, and if wanted "
            "scale ('linear', 'log' or 'integer'), unit, start; or choices"
        ) from None
