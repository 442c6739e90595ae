"""The configuration files read without Hydra, for Python callers; the command line composes them.

`conf/run.yaml` says which groups there are, in which order, and what is chosen where nothing else
is said. Both ways of reading give the same configuration, which a test holds.
"""

import functools
import re
from collections.abc import Mapping
from copy import deepcopy
from importlib.resources import files
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from zoac.core.errors import ConfigError, suggest

CONFIG_MODULE = "zoac.conf"

AUTO = "auto"
"""The tuner without a file: a rule chooses it by the task, see `zoac.config.auto_tuner`."""

NOT_OF_A_RUN = ("logger", "launcher", "method", "experiment")
"""Groups that say where a command line's jobs run and what they log."""


def own_conf() -> Path | None:
    """Return the folder `conf` below the current one, unless there is none or it is zoac's own."""
    folder = Path.cwd() / "conf"
    is_zoacs = (folder.parent / "zoac" / "run" / "command.py").is_file()
    return folder if folder.is_dir() and not is_zoacs else None


def configuration(**chosen: str | None) -> dict[str, Any]:
    """Return the configuration of a run as plain Python.

    Args:
        chosen: Group -> name of a choice, such as task="pid_acc", or None for a group to leave out;
            other groups have the choice of `conf/run.yaml`.

    Raises:
        ConfigError: If a choice is unknown or its file cannot be used.
    """
    run = _read("run", "")
    names: dict[str, Any] = {}
    parts = []
    pairs = [
        pair for entry in run.pop("defaults") if isinstance(entry, dict) for pair in entry.items()
    ]
    for key, name in pairs:
        group, _, place = key.removeprefix("optional ").partition("@")
        if group in NOT_OF_A_RUN or group.startswith("override"):
            continue
        names[group] = name = chosen.get(group, _filled_in(name, names))
        if name is None or (key.startswith("optional ") and name not in choices(group)):
            continue
        parts.append({place or group: choice(group, name)})
    del run["hydra"]
    try:
        plain: Any = OmegaConf.to_container(OmegaConf.unsafe_merge(run, *parts), resolve=True)
    except OmegaConfBaseException as error:
        raise ConfigError(str(error).splitlines()[0]) from error
    return plain


def _filled_in(name: str | None, chosen: Mapping[str, Any]) -> str | None:
    """Return the name of a choice with ${group} replaced by what that group chose."""
    return name and re.sub(r"\$\{(\w+)\}", lambda found: str(chosen[found[1]]), name)


def choice(group: str, name: str) -> dict[str, Any]:
    """Return the file of a choice, merged over those of its group that its `defaults` name.

    Raises:
        ConfigError: If there is none, or it cannot be used.
    """
    if name not in choices(group):
        raise ConfigError(unknown_choice(group, name))
    node = _read(name, group)
    merged: dict[str, Any] = {}
    for entry in node.pop("defaults", ["_self_"]):
        if not isinstance(entry, str):
            raise ConfigError(
                f"conf/{group}/{name}.yaml: its defaults reach into other groups ({entry}); only "
                "the command line can compose it"
            )
        merged = _over(merged, node if entry == "_self_" else choice(group, entry))
    return merged


def _over(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Return what two files say, options in options; where both say something, `above` holds."""
    both = {
        key for key in above if isinstance(above[key], dict) and isinstance(below.get(key), dict)
    }
    return below | above | {key: _over(below[key], above[key]) for key in both}


def unknown_choice(group: str, name: str) -> str:
    """Return the message for a name that is no choice of its group."""
    folder = f"{name.partition('/')[0]}/"  # such as task/suite
    near = [one for one in choices(group) if "/" not in one or one.startswith(folder)]
    if group == "tuner":
        near.append(AUTO)
    return f"unknown {group} {name!r}; {suggest(name, near or choices(group))}"


def choices(group: str) -> list[str]:
    """Return the names of a group's files, the package's and those of the current folder."""
    return sorted({name for root in _roots() for name in names_in(root / group)})


def names_in(folder: Path) -> list[str]:
    """Return the names of the YAML files in a group's folder, such as "suite/lqr"."""
    paths = folder.rglob("*.yaml")
    return sorted(path.relative_to(folder).with_suffix("").as_posix() for path in paths)


def _roots() -> list[Path]:
    own = own_conf()
    package = Path(str(files(CONFIG_MODULE)))
    return [package] if own is None else [package, own]


def _read(name: str, group: str) -> dict[str, Any]:
    """Return a file; the package's comes before one of the same name in the current folder."""
    path = next(p for root in _roots() if (p := root / group / f"{name}.yaml").is_file())
    try:
        node = _parsed(path.read_text(encoding="utf-8"))
    except Exception as error:  # by the YAML parser
        raise ConfigError(f"{path}: cannot be read as YAML: {error}") from error
    if isinstance(node, list):
        raise ConfigError(f"{path}: expected keys and values, not a list")
    return deepcopy(node)


@functools.cache
def _parsed(text: str) -> Any:
    """Return what a file says, by its text: each run of a process reads the same few files."""
    return OmegaConf.to_container(OmegaConf.create(text))
