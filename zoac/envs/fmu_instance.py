"""An instance of an FMU of FMI 2.0 or 3.0 for co-simulation, by FMPy.

A library that is loaded into this process can damage it, so calls keep to the order that the
standard asks for, whatever fails: an instance is freed once, not after a fatal error, and neither
in a forked process nor while Python ends, when what an FMU embeds may be gone.
"""

import os
import shutil
import tempfile
import weakref
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from zoac.core.errors import ConfigError, EnvironmentFailure

_FATAL = 4
"""Status after which no function of an instance may be called, by both standards."""


REAL = {"2": "Real", "3": "Float64"}
"""What a number of double precision is called, by the first number of the FMI version."""


class FmuInstance:
    """One instance, whose files lie in a temporary folder of its own; of FMI 3.0, no event mode."""

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
        self._version = version(model)
        try:
            library().extract(str(path), unzipdir=folder)
            loader = import_module(f"fmpy.fmi{self._version}")
            self._fmu = getattr(loader, f"FMU{self._version}Slave")(
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

    def get(self, references: Sequence[int]) -> list[float]:
        """Return the values of variables."""
        return list(getattr(self._fmu, f"get{REAL[self._version]}")(references))

    def set(self, references: Sequence[int], values: Sequence[float]) -> None:
        """Set variables."""
        getattr(self._fmu, f"set{REAL[self._version]}")(references, values)

    def begin(self, references: Sequence[int], values: Sequence[float], stop_time: float) -> None:
        """Begin an episode of a new instance, or of one that was reset, with parameters."""
        times = {"startTime": 0.0, "stopTime": stop_time}
        if self._version == "2":
            self._fmu.setupExperiment(**times)
            times = {}
        if references:
            self.set(references, values)
        self._fmu.enterInitializationMode(**times)
        self._fmu.exitInitializationMode()

    def step(self, time: float, step_size: float) -> None:
        """Go on from a time by a step, both in seconds.

        Raises:
            EnvironmentFailure: If the FMU asks for the end of the simulation.
        """
        told = self._fmu.doStep(time, step_size)  # by FMI 3.0: event, end, ...; by 2.0 nothing
        if told and told[1]:
            raise EnvironmentFailure(f"it asks for the end of the simulation at {time:g} s")

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
    if version(model) not in REAL or model.coSimulation is None:
        raise ConfigError(
            f"{path}: FMI {model.fmiVersion}"
            f"{'' if model.coSimulation else ' without co-simulation'}; expected FMI 2.0 or 3.0 "
            "for co-simulation"
        )
    if fmpy.platform not in platforms:
        known = ", ".join(platforms) or "none"
        raise ConfigError(f"{path}: has no binary for {fmpy.platform}; it has those for: {known}")
    return model


def version(model: Any) -> str:
    """Return the first number of the FMI version of a model description."""
    return str(model.fmiVersion).partition(".")[0]


def _free(fmu: Any, process: int) -> None:
    if os.getpid() == process:  # in a fork the threads that an FMU may have are gone
        with suppress(Exception):  # it may have crashed before
            fmu.freeInstance()


def _remove(folder: str, process: int) -> None:
    if os.getpid() == process:  # in a fork the files are those of the process that is forked
        shutil.rmtree(folder, ignore_errors=True)
