"""A functional mock-up unit (FMI 2.0 or 3.0, co-simulation) as an environment."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box

from zoac.core.errors import ConfigError, EnvironmentFailure, UnsavableError, suggest
from zoac.core.types import is_number
from zoac.envs.fmu_instance import REAL, FmuInstance, description, version

Cost = Callable[[dict[str, float]], float]


class FmuEnv(gymnasium.Env):
    """An FMU, one step of fixed length after the other.

    One instance is made and reset for every episode. Its parameters are attributes of the
    environment, set before the episode begins, so that `plant` and `vary` find them. Where the FMU
    can serialise its state, `get_state` and `set_state` save and restore it. For several
    environments give zoac a function that makes one:

        zoac.tune(env=lambda: FmuEnv("plant.fmu", observations=["y"], ...), ...)
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(
        self,
        path: str | Path,
        *,
        observations: Sequence[str],
        actions: Sequence[str] | Mapping[str, tuple[float, float]],
        cost: str | Cost,
        step_size: float,
        stop_time: float,
    ) -> None:
        """
        Args:
            path: Of the `.fmu` file.
            observations: Names of variables, in the order of the observation.
            actions: Names of inputs, or of tunable parameters, in the order of the action; or
                bounds (low, high) by name. Without them, the FMU's bounds count, if it has any.
            cost: Of a step: the name of a variable, or a function of {name: value} of
                observations, actions and `time` [s] at the end of the step.
            step_size: Seconds of a step.
            stop_time: Seconds of an episode.

        Raises:
            ConfigError: If the file cannot be used here, or has no such variable.
        """
        self._path = Path(path).expanduser()
        self._model = description(self._path)
        for name, seconds in (("step_size", step_size), ("stop_time", stop_time)):
            if not (is_number(seconds) and math.isfinite(seconds) and seconds > 0):
                raise ConfigError(f"{name}={seconds!r}: expected seconds, above zero")
        self.dt = float(step_size)
        self._steps = max(1, round(stop_time / step_size))
        real = REAL[version(self._model)]
        self._variables = {
            v.name: v for v in self._model.modelVariables if v.type == real and not v.dimensions
        }
        self._observed = [self._reference(name) for name in observations]
        self._names = list(observations)
        self._applied = [self._reference(name, ("input", "parameter")) for name in actions]
        self._inputs = list(actions)
        self._cost = cost
        self._cost_reference = self._reference(cost) if isinstance(cost, str) else None
        self.observation_space = Box(-np.inf, np.inf, (len(observations),), np.float64)
        given = actions if isinstance(actions, Mapping) else {}
        bounds = [_bounds(self._variables[name], given.get(name)) for name in actions]
        low, high = np.array(bounds, dtype=np.float64).reshape(-1, 2).T
        self.action_space = Box(low, high, dtype=np.float64)
        self.spec = EnvSpec(self._path.stem, max_episode_steps=self._steps)
        self._parameters = {
            name: v.valueReference
            for name, v in self._variables.items()
            if v.causality == "parameter" and v.start is not None
            and name not in actions and not hasattr(self, name)
        }  # fmt: skip
        self._count = 0
        self._fmu: FmuInstance | None = None
        vars(self).update({name: float(self._variables[name].start) for name in self._parameters})
        self._made()

    def _reference(self, name: str, causalities: Sequence[str] = ()) -> int:
        """Return the number by which the FMU knows a variable."""
        fitting = [n for n, v in self._variables.items()
                   if not causalities or v.causality in causalities]  # fmt: skip
        if name not in fitting:
            kind = "real input or parameter" if causalities else "real variable"
            raise ConfigError(f"{self._path.name} has no {kind} {name!r}; {suggest(name, fitting)}")
        return self._variables[name].valueReference

    def _made(self) -> FmuInstance:
        """Return the instance, which is made if there is none."""
        if self._fmu is None:
            self._fmu = FmuInstance(self._path, self._model)
            self._is_new = True
        return self._fmu

    @contextmanager
    def _failing(self, what: str) -> Iterator[None]:
        """Turn what the FMU raises into the failure of an environment, whose instance is closed."""
        try:
            yield
        except Exception as error:
            self.close(error)
            raise EnvironmentFailure(f"the FMU's {what} failed: {error}") from error

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode with the parameters that the attributes hold."""
        super().reset(seed=seed)
        fmu = self._made()
        with self._failing("reset"):
            if not self._is_new:
                fmu.reset()
            self._is_new = False
            values = [float(getattr(self, name)) for name in self._parameters]
            fmu.begin(list(self._parameters.values()), values, self._steps * self.dt)
            self._count = 0
            return self._see(fmu), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Apply an action for one step; a step that fails raises `EnvironmentFailure`."""
        applied = np.asarray(action, dtype=np.float64).reshape(-1).tolist()
        fmu = self._made()
        with self._failing("step"):
            if applied:
                fmu.set(self._applied, applied)
            fmu.step(self._count * self.dt, self.dt)
            self._count += 1
            observation = self._see(fmu)
            cost = self._cost_of(fmu, observation, applied)
        return observation, -cost, False, self._count >= self._steps, {"cost": cost}

    def _see(self, fmu: FmuInstance) -> np.ndarray:
        return np.array(fmu.get(self._observed), dtype=np.float64)

    def _cost_of(self, fmu: FmuInstance, seen: np.ndarray, applied: Sequence[float]) -> float:
        if self._cost_reference is not None:
            return fmu.get([self._cost_reference])[0]
        assert callable(self._cost)
        values = dict(zip(self._names, seen.tolist(), strict=True))
        values |= dict(zip(self._inputs, applied, strict=True))
        return float(self._cost({**values, "time": self._count * self.dt}))

    def close(self, error: BaseException | None = None) -> None:
        """Free the instance; a later reset makes another.

        Args:
            error: What its last call raised, if it did.
        """
        if self._fmu is not None:
            self._fmu.close(error)
            self._fmu = None

    def get_state(self) -> tuple[bytes, int, dict[str, float]]:
        """Return the FMU's serialised state, the number of steps and the parameters.

        Raises:
            UnsavableError: If the FMU cannot serialise its state.
        """
        simulation = self._model.coSimulation
        if not (simulation.canGetAndSetFMUstate and simulation.canSerializeFMUstate):
            raise UnsavableError(
                f"{self._path.name} cannot save its state (canSerializeFMUstate is false); a tuner "
                "of whole episodes needs none, such as cmaes_full or bo"
            )
        if self._fmu is None:
            self.reset()
        parameters = {name: getattr(self, name) for name in self._parameters}
        return self._made().state(), self._count, parameters

    def set_state(self, state: tuple[bytes, int, dict[str, float]]) -> None:
        """Go on from a state that `get_state` returned, of this or another instance."""
        content, count, parameters = state
        if self._fmu is None or self._is_new:
            self.reset()
        vars(self).update(parameters)
        self._made().restore(content)
        self._count = count


def _bounds(variable: Any, given: Any) -> tuple[float, float]:
    """Return the bounds of a variable: those given, else the FMU's."""
    if given is None:
        low, high = variable.min, variable.max
        return (-np.inf if low is None else float(low), np.inf if high is None else float(high))
    try:
        low, high = map(float, given)
    except (TypeError, ValueError):
        raise ConfigError(f"actions: {variable.name!r}: {given!r}, expected (low, high)") from None
    if not low < high:
        raise ConfigError(f"actions: {variable.name!r}: {given!r}, expected low below high")
    return low, high
