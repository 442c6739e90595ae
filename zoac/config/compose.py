"""The command line's configuration: composed by Hydra, with messages that a person can use.

This module and `zoac.run.command` are the only ones that know Hydra.
"""

import itertools
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
from zoac.config.overrides import (
    GROUPS_OF_RUN,
    NOT_OF_THE_RUN,
    why_unreadable,
    with_whole_steps,
)
from zoac.config.settings import RUN_KEYS, WITHOUT_EFFECT, Evaluation, RunSettings, converted
from zoac.config.validate import check_arguments
from zoac.core.errors import ConfigError, option_names, suggest

GROUPS = (*GROUPS_OF_RUN, "launcher", "method", "experiment", "search")

OPTIONAL_GROUPS = {"preset": "tuner", "fidelity/task": "task", "fidelity/tuner": "tuner"}
"""Group -> the key whose options it sets, for some choices only."""

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
        raise ConfigError(explain(error, overrides)) from error


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
        except HydraException as error:
            why = why_unreadable(text, error)
            raise ConfigError(f"cannot read the override {text!r}: {why}") from error
        key = override.key_or_group
        if not key or key != key.strip("."):
            raise ConfigError(
                f"cannot read the override {text!r}: there is no key; write key=value"
            )
        parent, _, name = key.rpartition(".")
        setting = key in RUN_KEYS or (parent == "evaluation" and name in OF_EVALUATION)
        if override.is_delete():
            if setting or key in GROUPS_OF_RUN:
                raise ConfigError(f"{text}: a value is needed, {key}=<value>")
            continue
        for value in _values(text, override):
            if key in GROUPS or key.startswith("hydra/"):
                _check_choice(text, key, value)
            elif key in OPTIONAL_GROUPS:
                _check_optional(text, override, value)
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
        raise ConfigError(
            f"{text}: there is nothing to go through, so that the sweep has no jobs; glob() "
            f"chooses among the files of a group, such as tuner=glob(zoac*); write numbers as "
            "seed=0,1,2 or seed=range(0,3)"
        )
    return values


def _check_choice(text: str, group: str, value: Any) -> None:
    """Refuse what is no name of a group's choice; whether there is one of this name, Hydra says."""
    names = value if isinstance(value, list) and group == "logger" else [value]
    left_out = value is None and group in ("method", "experiment", "search")
    if not left_out and not all(isinstance(name, str) for name in names):
        hint = suggest(str(value), choices(group))
        if isinstance(value, list) and group != "logger":
            hint = f"for several, one after the other: -m {group}={','.join(map(str, value))}"
        raise ConfigError(f"{text}: expected a name of the group {group}; {hint}")


def _check_optional(text: str, override: Override, value: Any) -> None:
    """Refuse a choice that Hydra would pass over, since the group may be left out."""
    key = override.key_or_group
    place = f"{key}@{OPTIONAL_GROUPS[key]}"
    if override.package != OPTIONAL_GROUPS[key]:
        raise ConfigError(f"{text}: write {place}={value}")
    if (name := str(value)) not in choices(key):
        raise ConfigError(unknown_choice(key, name))


def explain(error: Exception, overrides: Sequence[str]) -> str:
    """Return what Hydra complains about as one message, with the nearest valid choice."""
    cause: BaseException = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    lines = [line.strip() for e in (error, cause) for line in str(e).splitlines()]
    text = "\n".join(
        dict.fromkeys(line for line in lines if line and not line.startswith(INTERNAL))
    )
    if "nterpolation" in text and (place := getattr(cause, "full_key", None)):
        return f"{place}: {text}"
    for launcher, extra in EXTRA_OF_LAUNCHER.items():
        if f"Could not find 'hydra/launcher/{launcher}'" in text:
            return f"the launcher {launcher} is not installed: pip install 'zoac[{extra}]'"
    for override in overrides:
        key = override.lstrip("+~").partition("=")[0]
        if f"override '{key}'" in text and "To append to your config" in text:
            # Of search.ranges={num_envs: ...} it is the key inside that is unknown.
            unknown = getattr(cause, "full_key", None) or key
            return f"unknown key {unknown!r} in {override!r}; {_siblings(unknown, overrides)}"
    if found := re.search(r"Could not (?:find|load) '(?!hydra/)(\w+)/(\S*)'", text):
        return unknown_choice(*found.groups())
    return text


def _siblings(key: str, overrides: Sequence[str]) -> str:
    """Return the hint that lists what stands beside `key` where the same choices are made.

    Of the jobs of a sweep, it is about the first that does not know the key.
    """
    parent, _, name = key.rpartition(".")
    if not parent:
        return suggest(name, [*GROUPS_OF_RUN, *RUN_KEYS])
    pairs = [text.lstrip("+").partition("=") for text in overrides]
    groups = {group: value.split(",") for group, _, value in pairs if group in GROUPS}
    swept = [group for group, values in groups.items() if len(values) > 1]
    for values in itertools.product(*groups.values()):
        chosen = dict(zip(groups, values, strict=True))
        # A run has no search, so that one is added.
        texts = [f"{'+' * (g == 'search')}{g}={value}" for g, value in chosen.items()]
        try:
            config = _composed(texts)
        except Exception:  # a choice may be wrong as well, in any of the ways that Hydra knows
            return "see --help"
        node = OmegaConf.select(config, parent)
        if not (isinstance(node, DictConfig) and name in node):
            break
    if node is None and "." in parent:  # what is unknown stands further up
        return _siblings(parent, overrides)
    plain: Any = OmegaConf.to_container(node) if isinstance(node, DictConfig) else {}
    known = option_names(plain)
    if parent in GROUPS and not known:
        option = config.hydra.runtime.choices.get(parent)
        return f"{parent}={option} has no keys; choices: {', '.join(choices(parent))}"
    told = "".join(f"{group}={chosen[group]}: " for group in swept)
    group = parent.partition(".")[0]
    may_add = not swept and (parent == "task" or key.startswith("search.ranges."))
    added = f"; what the {group}'s file leaves out is added: +{key}=..." if may_add else ""
    return told + suggest(key, [f"{parent}.{name}" for name in known]) + added


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
        raise ConfigError(explain(error, [])) from error
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
