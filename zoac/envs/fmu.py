"""A functional mock-up unit (FMI 2.0, co-simulation) as an environment."""

from __future__ import annotations

import atexit
import math
import shutil
import tempfile
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box

from zoac.core.errors import ConfigError, EnvironmentFailure, UnsavableError, suggest
from zoac.core.types import is_number

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
        fmpy = _library()
        self._path = Path(path).expanduser()
        self._model = _description(fmpy, self._path)
        for name, seconds in (("step_size", step_size), ("stop_time", stop_time)):
            if not (is_number(seconds) and math.isfinite(seconds) and seconds > 0):
                raise ConfigError(f"{name}={seconds!r}: expected seconds, above zero")
        self.dt = float(step_size)
        self._steps = max(1, round(stop_time / step_size))
        self._variables = {v.name: v for v in self._model.modelVariables if v.type == "Real"}
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
        self._fmu: Any = None
        vars(self).update({name: float(self._variables[name].start) for name in self._parameters})
        self._begin()

    def _reference(self, name: str, causalities: Sequence[str] = ()) -> int:
        """Return the number by which the FMU knows a variable."""
        fitting = [n for n, v in self._variables.items()
                   if not causalities or v.causality in causalities]  # fmt: skip
        if name not in fitting:
            kind = "real input or parameter" if causalities else "real variable"
            raise ConfigError(f"{self._path.name} has no {kind} {name!r}; {suggest(name, fitting)}")
        reference: int = self._variables[name].valueReference
        return reference

    def _begin(self) -> None:
        """Make the instance, or reset it, up to its initialisation."""
        if self._fmu is None:
            self._fmu = _instance(_library(), self._path, self._model)
            folder = self._fmu.unzipDirectory
            self._release = weakref.finalize(self, _release, self._fmu, folder)
            self._release.atexit = False  # what an FMU embeds may be gone by then
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
        else:
            self._fmu.reset()
        self._fmu.setupExperiment(startTime=0.0, stopTime=self._steps * self.dt)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode with the parameters that the attributes hold."""
        super().reset(seed=seed)
        with self._guarded("reset"):
            self._begin()
            if self._parameters:
                values = [float(getattr(self, name)) for name in self._parameters]
                self._fmu.setReal(list(self._parameters.values()), values)
            self._fmu.enterInitializationMode()
            self._fmu.exitInitializationMode()
            self._count = 0
            return self._see(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Apply an action for one step; a step that fails raises `EnvironmentFailure`."""
        applied = np.asarray(action, dtype=np.float64).reshape(-1).tolist()
        with self._guarded("step"):
            if applied:
                self._fmu.setReal(self._applied, applied)
            self._fmu.doStep(self._count * self.dt, self.dt)
            self._count += 1
            observation = self._see()
            cost = self._cost_of(observation, applied)
        return observation, -cost, False, self._count >= self._steps, {"cost": cost}

    def _see(self) -> np.ndarray:
        return np.array(self._fmu.getReal(self._observed), dtype=np.float64)

    def _cost_of(self, observation: np.ndarray, applied: Sequence[float]) -> float:
        if self._cost_reference is not None:
            return float(self._fmu.getReal([self._cost_reference])[0])
        assert callable(self._cost)
        values = dict(zip(self._names, observation.tolist(), strict=True))
        values |= dict(zip(self._inputs, applied, strict=True))
        return float(self._cost({**values, "time": self._count * self.dt}))

    def _guarded(self, what: str) -> _Guard:
        return _Guard(self, what)

    def close(self) -> None:
        """Free the instance; a later reset makes another."""
        if self._fmu is not None:
            self._release()
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
        state = self._fmu.getFMUState()
        try:
            content = bytes(self._fmu.serializeFMUState(state))
        finally:
            self._fmu.freeFMUState(state)
        return content, self._count, {name: getattr(self, name) for name in self._parameters}

    def set_state(self, state: tuple[bytes, int, dict[str, float]]) -> None:
        """Go on from a state that `get_state` returned, of this or another instance."""
        content, self._count, parameters = state
        if self._fmu is None:
            self.reset()
        vars(self).update(parameters)
        found = self._fmu.deserializeFMUState(content)
        try:
            self._fmu.setFMUState(found)
        finally:
            self._fmu.freeFMUState(found)


class _Guard:
    """Turns what an FMU raises into the failure of an environment, which gets a new instance."""

    def __init__(self, env: FmuEnv, what: str) -> None:
        self._env, self._what = env, what

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: Any, error: BaseException | None, _: Any) -> None:
        if error is None or not isinstance(error, Exception):
            return
        self._env.close()
        raise EnvironmentFailure(f"the FMU's {self._what} failed: {error}") from error


def _library() -> Any:
    try:
        import fmpy
    except ImportError as error:
        raise ConfigError("an FMU needs FMPy: pip install 'zoac[fmu]'") from error
    return fmpy


def _description(fmpy: Any, path: Path) -> Any:
    """Return the model description of an FMU that can run here."""
    if not path.is_file():
        raise ConfigError(f"there is no file {str(path)!r}; expected an FMU")
    try:
        model = fmpy.read_model_description(str(path))
        platforms = fmpy.supported_platforms(str(path))
    except Exception as error:  # whatever readers of zip and XML raise
        raise ConfigError(f"{path}: cannot be read as an FMU: {error}") from error
    if model.fmiVersion != "2.0" or model.coSimulation is None:
        raise ConfigError(
            f"{path}: FMI {model.fmiVersion}"
            f"{'' if model.coSimulation else ' without co-simulation'}; expected FMI 2.0 for "
            "co-simulation"
        )
    if fmpy.platform not in platforms:
        known = ", ".join(platforms) or "none"
        raise ConfigError(f"{path}: has no binary for {fmpy.platform}; it has those for: {known}")
    return model


def _instance(fmpy: Any, path: Path, model: Any) -> Any:
    """Return an instance, whose files lie in a temporary folder of its own."""
    from fmpy.fmi2 import FMU2Slave

    folder = tempfile.mkdtemp(prefix="zoac-fmu-")
    try:
        fmpy.extract(str(path), unzipdir=folder)
        fmu = FMU2Slave(
            guid=model.guid,
            unzipDirectory=folder,
            modelIdentifier=model.coSimulation.modelIdentifier,
            instanceName=path.stem,
        )
        fmu.instantiate()
    except Exception as error:  # of the loader, or whatever FMPy raises
        shutil.rmtree(folder, ignore_errors=True)
        raise ConfigError(f"{path}: cannot be instantiated: {error}") from error
    return fmu


def _release(fmu: Any, folder: str) -> None:
    with suppress(Exception):  # it may have crashed before
        fmu.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)


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
