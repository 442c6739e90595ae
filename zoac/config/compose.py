"""The command line's configuration: composed by Hydra, with messages that a person can use.

This module and `zoac.run.command` are the only ones that know Hydra.
"""

import re
import threading
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from hydra import compose, initialize_config_module
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Glob, Override
from hydra.core.plugins import Plugins
from hydra.errors import HydraException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from zoac.config.files import AUTO, CONFIG_MODULE, choices, own_conf, unknown_choice
from zoac.config.overrides import GROUPS_OF_RUN, NOT_OF_THE_RUN, with_whole_steps
from zoac.config.settings import RUN_KEYS, WITHOUT_EFFECT, Evaluation, RunSettings, converted
from zoac.config.validate import check_arguments
from zoac.core.errors import ConfigError, option_names, suggest

GROUPS = (*GROUPS_OF_RUN, "launcher", "method", "experiment", "search")

OPTIONAL_GROUPS = ("preset", "fidelity/task", "fidelity/tuner")
"""Groups in which Hydra passes over a choice that is not there."""

# Overrides that say which run this is; keys of `WITHOUT_EFFECT` cannot change its numbers.
NOT_A_VARIANT = ("task", "tuner", "seed", "launcher", "method", "experiment")

OF_EVALUATION = tuple(f.name for f in fields(Evaluation))

ConfigStore.instance().store(group="tuner", name=AUTO, node={})

# How lines of Hydra's messages begin that say nothing to a user.
INTERNAL = (
    "full_key:", "object_type=", "reference_type=", "See https://", "Config search path:",
    "provider=",
)  # fmt: skip
EXTRA_OF_LAUNCHER = {
    "joblib": "launchers", "submitit_local": "launchers", "submitit_slurm": "launchers",
    "ray": "ray-launcher",
}  # fmt: skip


class OwnConf(SearchPathPlugin):
    """Lets Hydra find `conf/` of the current folder, behind the package's: a user's own choices."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Add the folder, if it is there, where it is zoac that composes."""
        own = any(source.path == f"pkg://{CONFIG_MODULE}" for source in search_path.get_path())
        if own and (folder := own_conf()) is not None:
            search_path.append("own", f"file://{folder}")


def know_own_conf() -> None:
    """Make Hydra ask `OwnConf` from now on."""
    Plugins.instance().register(OwnConf)


def compose_config(overrides: Sequence[str]) -> DictConfig:
    """Compose the configuration from Hydra overrides, as the command line does.

    Raises:
        ConfigError: If an override names nothing, or has a value of the wrong type.
    """
    overrides = with_whole_steps(overrides)
    check_overrides(overrides)
    try:
        return _composed(overrides)
    except Exception as error:  # Hydra answers some odd overrides with a ValueError, say
        raise ConfigError(explain(error)) from error


def _composed(overrides: Sequence[str]) -> DictConfig:
    """Compose this package's configuration with Hydra; whose Hydra was has it back."""
    with _ONE_AT_A_TIME:
        hydra = GlobalHydra.instance()
        earlier, hydra.hydra = hydra.hydra, None
        try:
            know_own_conf()
            with initialize_config_module(CONFIG_MODULE, version_base="1.3"):
                return compose("run", overrides=list(overrides), return_hydra_config=True)
        finally:
            GlobalHydra.instance().hydra = earlier


_ONE_AT_A_TIME = threading.RLock()  # Hydra is one object per process


def check_overrides(overrides: Sequence[str]) -> None:
    """Refuse overrides that Hydra would answer with a traceback, and settings that no run can have.

    Raises:
        ConfigError: If one names no key, or gives a group or a setting what it cannot be.
    """
    parser = OverridesParser.create()
    for text in overrides:
        try:
            override = parser.parse_override(text)
            key = override.key_or_group
        except HydraException:
            key = ""
        if not key or key != key.strip("."):
            raise ConfigError(
                f"cannot read the override {text!r}: expected key=value; a value with special "
                "characters needs quotes, \"key='value'\""
            )
        parent, _, name = key.rpartition(".")
        setting = key in RUN_KEYS or (parent == "evaluation" and name in OF_EVALUATION)
        if override.is_delete():
            if setting or key in GROUPS_OF_RUN:
                raise ConfigError(f"{text}: a value is needed, {key}=<value>")
            continue
        for value in _values(text, override):
            if key in GROUPS or key in OPTIONAL_GROUPS:
                _check_choice(key, value)
            elif setting and "${" not in str(value):
                owner = Evaluation if parent else RunSettings
                check_arguments(owner, converted(owner, {name: value}, text=True), parent)


def _values(text: str, override: Override) -> list[Any]:
    """Return the value of an override, or those that a sweep goes through."""
    value = override.value()
    if isinstance(value, Glob):
        values = value.filter(choices(override.key_or_group))
    elif override.is_sweep_override():
        # What stood in quotes has them off in `text`.
        values = [getattr(one, "text", one) for one in override.sweep_iterator()]
    else:
        return [value]
    if not values:
        raise ConfigError(f"{text}: there is nothing to go through, so the sweep has no jobs")
    return values


def _check_choice(group: str, value: Any) -> None:
    """Refuse what is no name of a choice, as far as Hydra does not."""
    names = value if isinstance(value, list) and group == "logger" else [value]
    left_out = value is None and group in ("method", "experiment", "search")
    passed_over = group in OPTIONAL_GROUPS and value not in choices(group)
    if passed_over or not (left_out or all(isinstance(name, str) for name in names)):
        raise ConfigError(unknown_choice(group, str(value)))


def explain(error: Exception) -> str:
    """Return what Hydra complains about as one message, with the nearest valid choice."""
    cause: BaseException = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    lines = [line.strip() for e in (error, cause) for line in str(e).splitlines()]
    text = "\n".join(
        dict.fromkeys(line for line in lines if line and not line.startswith(INTERNAL))
    )
    place = getattr(cause, "full_key", None)
    if "nterpolation" in text and place:
        return f"{place}: {text}"
    for launcher, extra in EXTRA_OF_LAUNCHER.items():
        if f"Could not find 'hydra/launcher/{launcher}'" in text:
            return f"the launcher {launcher} is not installed: pip install 'zoac[{extra}]'"
    if place and (found := re.search(r"To append to your config use \+(.+)", text)):
        hint = _siblings(place, getattr(cause, "parent_node", None))
        return f"unknown key {place!r} in {found[1]!r}; {hint}"
    if found := re.search(r"Could not (?:find|load) '(?!hydra/)(\w+)/(\S*)'", text):
        return unknown_choice(*found.groups())
    return text


def _siblings(key: str, node: Any) -> str:
    """Return the hint that lists what stands in the node that has no `key`."""
    parent = key.rpartition(".")[0]
    if not parent:
        return suggest(key, [*GROUPS_OF_RUN, *RUN_KEYS])
    plain: Any = OmegaConf.to_container(node) if isinstance(node, DictConfig) else {}
    hint = suggest(key, [f"{parent}.{name}" for name in option_names(plain)])
    if key.startswith(("task.", "search.ranges.")):
        hint += f"; what its file leaves out is added: +{key}=..."
    return hint


def resolved(config: DictConfig) -> dict[str, Any]:
    """Return the configuration as plain Python, interpolations resolved, without Hydra's own part.

    Raises:
        ConfigError: If a value is missing, unknown or of the wrong type, or an interpolation leads
            nowhere.
    """
    try:
        plain: dict[str, Any] = OmegaConf.to_container(  # type: ignore[assignment]
            OmegaConf.masked_copy(config, [k for k in map(str, config) if k not in NOT_OF_THE_RUN]),
            resolve=True,
            throw_on_missing=True,
        )
    except OmegaConfBaseException as error:
        raise ConfigError(explain(error)) from error
    known = [*GROUPS_OF_RUN, *RUN_KEYS]
    for key in plain:
        if key not in known:
            raise ConfigError(f"unknown key {key!r}; {suggest(key, known)}")
    for key in GROUPS_OF_RUN:
        if key not in plain:
            raise ConfigError(f"{key}: a value is needed; {suggest('', choices(key))}")
    groups = {key: plain.pop(key) for key in GROUPS_OF_RUN}
    settings = converted(RunSettings, plain, text=True)
    settings["evaluation"] = converted(Evaluation, plain["evaluation"], text=True)
    check_arguments(RunSettings, settings, "")
    return groups | settings


def variant_of(config: Mapping[str, Any], overrides: Sequence[str]) -> str | None:
    """Return the run's variant: as given, or what the overrides change beyond its identity."""
    if config["variant"] is not None:
        return str(config["variant"])
    named = []
    for override in sorted(overrides):
        key = override.lstrip("+~").partition("=")[0].partition("@")[0]
        if key not in NOT_A_VARIANT and key.partition(".")[0] not in WITHOUT_EFFECT:
            named.append(override.lstrip("+~"))
    return ",".join(named).replace("/", "-") or None
