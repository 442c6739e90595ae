"""Tune a PID for the plant of a file: `python -m zoac.pid plant.yaml`."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import OmegaConf

from zoac.core.errors import ConfigError, ZoacError, suggest
from zoac.run.pipes import reader_may_leave

if TYPE_CHECKING:
    from zoac.pid.tuning import PidResult


def from_file(path: str | Path) -> PidResult:
    """Tune a PID for the plant of a YAML file.

    Its keys are the arguments of `tune_pid`, and `export`, a file to write. A plant is
    `{num: [2], den: [0.1, 0.7, 1]}`, or a list of such; specs are as in a task's YAML file, where
    the signals `y`, `r` and `u` need not be named.

    Raises:
        ConfigError: If something in the file cannot be used.
    """
    from zoac.controllers.pid_export import writable  # --help need not wait for these
    from zoac.pid.tuning import tune_pid

    known = ["plant", "export", *list(inspect.signature(tune_pid).parameters)[1:]]
    given: Any
    try:
        given = OmegaConf.to_container(OmegaConf.load(path), resolve=True)
    except Exception as error:  # whatever the reader raises
        raise ConfigError(f"{path} cannot be read: {error}") from error
    if not isinstance(given, dict):
        raise ConfigError(f"{path}: expected keys and values, such as sample_time: 0.05")
    given = {str(key): value for key, value in given.items()}
    for key in given:
        if key not in known:
            raise ConfigError(f"{path}: no key {key!r}; {suggest(key, known)}")
    missing = [key for key in ("plant", "sample_time") if key not in given]
    if missing:
        raise ConfigError(f"{path}: no value for {', '.join(missing)}")
    export = given.pop("export", None)
    if export is not None:
        writable(export)  # known before tuning
    plant = given.pop("plant")
    plant = [_system(one) for one in plant] if isinstance(plant, list) else _system(plant)
    result = tune_pid(plant, **given)
    if export is not None:
        result.export(export)
    return result


def _system(given: Any) -> Any:
    """Return a transfer function from numerator and denominator."""
    import control

    for key in given if isinstance(given, dict) else ():
        if key == "dead_time":
            raise ConfigError(
                "plant: dead_time has a line of its own beside plant; a list gives one per plant"
            )
        if key not in ("num", "den"):
            raise ConfigError(f"plant: no key {key!r}; {suggest(str(key), ('num', 'den'))}")
    try:
        return control.tf(given["num"], given["den"])
    except Exception as error:  # whatever python-control finds wrong
        raise ConfigError(
            f"plant={given!r}: expected num and den, coefficients of falling powers of s, such as "
            f"{{num: [2], den: [0.1, 0.7, 1]}} ({error})"
        ) from error


def main(arguments: Sequence[str] | None = None) -> int:
    """Tune from a file, and print the table; return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if len(given) != 1 or given[0] in ("-h", "--help"):
        print("usage: python -m zoac.pid plant.yaml   (see docs/tune_pid.md)")
        return 0 if given and given[0] in ("-h", "--help") else 1
    try:
        result = from_file(given[0])
    except ZoacError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(result)
    return 0


if __name__ == "__main__":
    with reader_may_leave():
        sys.exit(main())
