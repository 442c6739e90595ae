"""An instance of an FMU of FMI 2.0 or 3.0 for co-simulation, by FMPy.

A library that is loaded into this process can damage it, so calls keep to the order that the
standard asks for, whatever fails: an instance is freed once, not after a fatal error, and neither
in a forked process nor while Python ends, when what an FMU embeds may be gone.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from zoac.core.errors import ConfigError, EnvironmentFailure

_FATAL = 4
"""Status after which no function of an instance may be called, by both standards."""


class FmuInstance(ABC):
    """One instance, whose files lie in a temporary folder of its own."""

    real: str
    """What the standard calls a variable that is a number of double precision."""

    def __init__(self, path: Path, model: Any) -> None:
        """
        Args:
            path: Of the FMU.
            model: Its description.

        Raises:
            ConfigError: If it cannot be instantiated here.
        """
        folder = tempfile.mkdtemp(prefix="zoac-fmu-")
        self._remove = weakref.finalize(self, _remove, folder, os.getpid())
        try:
            library().extract(str(path), unzipdir=folder)
            self._fmu = self._loaded(
                guid=model.guid,
                unzipDirectory=folder,
                modelIdentifier=model.coSimulation.modelIdentifier,
                instanceName=path.stem,
            )
            self._fmu.instantiate()
        except Exception as error:  # of the loader, or whatever FMPy raises
            self._remove()
            raise ConfigError(f"{path}: cannot be instantiated: {error}") from error
        self._free = weakref.finalize(self, _free, self._fmu, os.getpid())
        self._free.atexit = False

    @abstractmethod
    def _loaded(self, **options: Any) -> Any:
        """Return FMPy's object for the library."""

    def get(self, references: Sequence[int]) -> list[float]:
        """Return the values of variables."""
        return list(getattr(self._fmu, f"get{self.real}")(references))

    def set(self, references: Sequence[int], values: Sequence[float]) -> None:
        """Set variables."""
        getattr(self._fmu, f"set{self.real}")(references, values)

    @abstractmethod
    def begin(self, references: Sequence[int], values: Sequence[float], stop_time: float) -> None:
        """Begin an episode of a new instance, or of one that was reset, with parameters."""

    def _initialise(
        self, references: Sequence[int], values: Sequence[float], **times: float
    ) -> None:
        if references:
            self.set(references, values)
        self._fmu.enterInitializationMode(**times)
        self._fmu.exitInitializationMode()

    @abstractmethod
    def step(self, time: float, step_size: float) -> None:
        """Go on from a time by a step, both in seconds."""

    def reset(self) -> None:
        """Bring the instance to where it was made."""
        self._fmu.reset()

    def state(self) -> bytes:
        """Return the serialised state."""
        state = self._fmu.getFMUState()
        try:
            return bytes(self._fmu.serializeFMUState(state))
        finally:
            self._fmu.freeFMUState(state)

    def restore(self, content: bytes) -> None:
        """Bring the instance to a state that `state` returned, of this or another instance."""
        state = self._fmu.deserializeFMUState(content)
        try:
            self._fmu.setFMUState(state)
        finally:
            self._fmu.freeFMUState(state)

    def close(self, error: BaseException | None = None) -> None:
        """Free the instance and remove its files.

        Args:
            error: What the last call raised, if it did.
        """
        if getattr(error, "status", None) == _FATAL:
            self._free.detach()
        self._free()
        self._remove()


class Fmu2(FmuInstance):
    """By FMI 2.0."""

    real = "Real"

    def _loaded(self, **options: Any) -> Any:
        from fmpy.fmi2 import FMU2Slave

        return FMU2Slave(**options)

    def begin(self, references: Sequence[int], values: Sequence[float], stop_time: float) -> None:
        """See `FmuInstance.begin`."""
        self._fmu.setupExperiment(startTime=0.0, stopTime=stop_time)
        self._initialise(references, values)

    def step(self, time: float, step_size: float) -> None:
        """See `FmuInstance.step`."""
        self._fmu.doStep(time, step_size)


class Fmu3(FmuInstance):
    """By FMI 3.0, without its event mode."""

    real = "Float64"

    def _loaded(self, **options: Any) -> Any:
        from fmpy.fmi3 import FMU3Slave

        return FMU3Slave(**options)

    def begin(self, references: Sequence[int], values: Sequence[float], stop_time: float) -> None:
        """See `FmuInstance.begin`."""
        self._initialise(references, values, startTime=0.0, stopTime=stop_time)

    def step(self, time: float, step_size: float) -> None:
        """See `FmuInstance.step`.

        Raises:
            EnvironmentFailure: If the FMU asks for the end of the simulation.
        """
        _, ends, _, _ = self._fmu.doStep(time, step_size)
        if ends:
            raise EnvironmentFailure(f"it asks for the end of the simulation at {time:g} s")


KINDS: dict[str, type[FmuInstance]] = {"2": Fmu2, "3": Fmu3}
"""By the first number of the FMI version."""


def library() -> Any:
    """Return FMPy.

    Raises:
        ConfigError: If it is not installed.
    """
    try:
        import fmpy
    except ImportError as error:
        raise ConfigError("an FMU needs FMPy: pip install 'zoac[fmu]'") from error
    return fmpy


def description(path: Path) -> Any:
    """Return the model description of an FMU that can run here.

    Raises:
        ConfigError: If it cannot.
    """
    fmpy = library()
    if not path.is_file():
        raise ConfigError(f"there is no file {str(path)!r}; expected an FMU")
    try:
        model = fmpy.read_model_description(str(path))
        platforms = fmpy.supported_platforms(str(path))
    except Exception as error:  # whatever readers of zip and XML raise
        raise ConfigError(f"{path}: cannot be read as an FMU: {error}") from error
    if kind(model) is None or model.coSimulation is None:
        raise ConfigError(
            f"{path}: FMI {model.fmiVersion}"
            f"{'' if model.coSimulation else ' without co-simulation'}; expected FMI 2.0 or 3.0 "
            "for co-simulation"
        )
    if fmpy.platform not in platforms:
        known = ", ".join(platforms) or "none"
        raise ConfigError(f"{path}: has no binary for {fmpy.platform}; it has those for: {known}")
    return model


def kind(model: Any) -> type[FmuInstance] | None:
    """Return the class for the FMI version of a model description; None: there is none."""
    return KINDS.get(str(model.fmiVersion).partition(".")[0])


def _free(fmu: Any, process: int) -> None:
    if os.getpid() == process:  # in a fork the threads that an FMU may have are gone
        with suppress(Exception):  # it may have crashed before
            fmu.freeInstance()


def _remove(folder: str, process: int) -> None:
    if os.getpid() == process:  # in a fork the files are those of the process that is forked
        shutil.rmtree(folder, ignore_errors=True)
