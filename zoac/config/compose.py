"""The command line's configuration: composed by Hydra, with messages that a person can use.

This module and `zoac.run.command` are the only ones that know Hydra.
"""

import itertools
import re
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from hydra import compose, initialize_config_module
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Glob, Override
from hydra.core.plugins import Plugins
from hydra.errors import HydraException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from zoac.config.files import CONFIG_MODULE, choices, own_conf
from zoac.config.schema import (
    GROUPS_OF_RUN,
    NOT_OF_THE_RUN,
    EvaluationSchema,
    RunSchema,
    check_keys,
    why_unreadable,
    with_whole_steps,
)
from zoac.config.settings import WITHOUT_EFFECT
from zoac.core.errors import ConfigError, option_names, suggest

GROUPS = (*GROUPS_OF_RUN, "launcher", "method", "experiment", "search")

OPTIONAL_GROUPS = {"preset": "tuner", "fidelity/task": "task", "fidelity/tuner": "tuner"}
"""Group -> the key whose options it sets, for some choices only."""

# Overrides that say which run this is; keys of `WITHOUT_EFFECT` cannot change its numbers.
NOT_A_VARIANT = ("task", "tuner", "seed", "launcher", "method", "experiment")

# How lines of Hydra's messages begin that say nothing to a user.
INTERNAL = ("full_key:", "object_type=", "reference_type=", "See https://")
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
        with _hydra():
            return compose("run", overrides=list(overrides), return_hydra_config=True)
    except Exception as error:  # Hydra answers some odd overrides with a ValueError, say
        raise ConfigError(explain(error, overrides)) from error


@contextmanager
def _hydra() -> Iterator[GlobalHydra]:
    """Yield Hydra ready to compose this package's configuration; whose it was has it back."""
    with _ONE_AT_A_TIME:
        hydra = GlobalHydra.instance()
        earlier, hydra.hydra = hydra.hydra, None
        try:
            know_own_conf()
            with initialize_config_module(CONFIG_MODULE, version_base="1.3"):
                yield GlobalHydra.instance()
        finally:
            GlobalHydra.instance().hydra = earlier


_ONE_AT_A_TIME = threading.RLock()  # Hydra is one object per process


def check_overrides(overrides: Sequence[str]) -> None:
    """Refuse overrides that Hydra would answer with a traceback.

    Raises:
        ConfigError: If one names no key, or gives a group what is no name of a choice.
    """
    parser = OverridesParser.create()
    for text in overrides:
        try:
            override = parser.parse_override(text)
        except HydraException as error:
            why = why_unreadable(text, error)
            raise ConfigError(f"cannot read the override {text!r}: {why}") from error
        key = override.key_or_group
        group = key in GROUPS or key.startswith("hydra/")
        if not key or key != key.strip("."):
            raise ConfigError(
                f"cannot read the override {text!r}: there is no key; write key=value"
            )
        if override.is_sweep_override() and not _goes_through(override):
            raise ConfigError(
                f"{text}: there is nothing to go through, so that the sweep has no jobs; glob() "
                f"chooses among the files of a group, such as tuner=glob(zoac*); write numbers as "
                "seed=0,1,2 or seed=range(0,3)"
            )
        if key in OPTIONAL_GROUPS and not override.is_delete():
            _check_optional(text, override)
        if not group or override.is_delete() or override.is_sweep_override():
            continue
        value = override.value()
        names = value if isinstance(value, list) else [value]
        if not all(isinstance(name, str) for name in names) and not (
            value is None and key in ("method", "experiment", "search")
        ):
            raise ConfigError(
                f"{text}: expected a name of the group {key}; {suggest(str(value), _choices(key))}"
            )
        if isinstance(value, list) and key != "logger":
            raise ConfigError(
                f"{text}: expected one {key}; to run several, one after the other: "
                f"-m {key}={','.join(map(str, value))}"
            )


def _check_optional(text: str, override: Override) -> None:
    """Refuse a choice that Hydra would pass over, since the group may be left out."""
    key = override.key_or_group
    place = f"{key}@{OPTIONAL_GROUPS[key]}"
    if override.package != OPTIONAL_GROUPS[key]:
        raise ConfigError(f"{text}: write {place}={override.value()}")
    if (name := str(override.value())) not in (known := choices(key)):
        raise ConfigError(f"unknown {key} {name!r}; {suggest(name, known)}")


def _goes_through(override: Override) -> bool:
    value = override.value()
    if isinstance(value, Glob):
        return bool(value.filter(_choices(override.key_or_group)))
    return any(True for _ in override.sweep_iterator())


def explain(error: Exception, overrides: Sequence[str]) -> str:
    """Return what Hydra complains about as one message, with the nearest valid choice."""
    cause: BaseException = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    lines = [line.strip() for e in (error, cause) for line in str(e).splitlines()]
    text = "\n".join(
        dict.fromkeys(line for line in lines if line and not line.startswith(INTERNAL))
    )
    if found := re.search(r"override (.*)\n.* is not a subclass of EvaluationSchema", text):
        return f"{found[1]}: expected a group of keys; {_siblings('evaluation.', overrides)}"
    if found := re.search(r"Value (.*) of type '.*' could not be converted to (\w+)", text):
        kind = {"Integer": "a whole number", "Float": "a number"}.get(found[2], found[2])
        written = re.search(r"Error merging override (.*)", text)
        return f"{written[1] if written else found[1]}: expected {kind}, got {found[1]}"
    if found := re.search(r"override (.*)\nValue '(.*)' is not a valid bool", text):
        return f"{found[1]}: expected true or false, got {found[2]!r}"
    if found := re.search(
        r"override (\w+)=.*\nInvalid value '(.*)', expected one of \[(.*)\]", text
    ):
        return f"{found[1]}={found[2]!r}; {suggest(found[2], found[3].split(', '))}"
    if found := re.search(r"override (.*)\n.*(is not Optional|does not support deletion)", text):
        return f"{found[1]}: a value is needed, {found[1].strip('~').partition('=')[0]}=<value>"
    if found := re.search(r"Missing mandatory value: (\w+)", text):
        return f"{found[1]}: a value is needed; {suggest('', _choices(found[1]))}"
    if found := re.search(r"interpolation '(.*)', possible interpolation keys: (.*)", text):
        missing = set(re.findall(r"\$\{(\w+)\}", found[1])) - set(found[2].split(", "))
        group = min(missing, default="")
        return f"{group}: a value is needed; {suggest('', _choices(group))}"
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
    if found := re.search(r"Could not (?:find|load) '(?:hydra/)?(\w+)/(\S*)'", text):
        group = found[0].split("'")[1].removesuffix(f"/{found[2]}")
        return f"unknown {group} {found[2]!r}; {suggest(found[2], _choices(group, found[2]))}"
    return text


def _siblings(key: str, overrides: Sequence[str]) -> str:
    """Return the hint that lists what stands beside `key` where the same choices are made.

    Of the jobs of a sweep, it is about the first that does not know the key.
    """
    parent, _, name = key.rpartition(".")
    pairs = [text.lstrip("+").partition("=") for text in overrides]
    groups = {group: value.split(",") for group, _, value in pairs if group in GROUPS}
    swept = [group for group, values in groups.items() if len(values) > 1]
    for values in itertools.product(*groups.values()):
        chosen = dict(zip(groups, values, strict=True))
        try:
            with _hydra():
                # A run has no search, so that one is added.
                texts = [f"{'+' * (g == 'search')}{g}={value}" for g, value in chosen.items()]
                config = compose("run", overrides=texts, return_hydra_config=True)
        except Exception:  # a choice may be wrong as well, in any of the ways that Hydra knows
            return "see --help"
        node = OmegaConf.select(config, parent) if parent else config
        if not (isinstance(node, DictConfig) and name in node):
            break
    if node is None and "." in parent:  # what is unknown stands further up
        return _siblings(parent, overrides)
    plain: Any = OmegaConf.to_container(node) if isinstance(node, DictConfig) else {}
    inside = plain if parent else dict.fromkeys(plain)  # of the run, the top level alone
    known = [name for name in option_names(inside) if name not in NOT_OF_THE_RUN]
    prefix = f"{parent}." if parent else ""
    if parent in GROUPS and not known:
        option = config.hydra.runtime.choices.get(parent)
        return f"{parent}={option} has no keys; choices: {', '.join(_choices(parent))}"
    told = "".join(f"{group}={chosen[group]}: " for group in swept)
    group = parent.partition(".")[0]
    may_add = not swept and (parent == "task" or key.startswith("search.ranges."))
    added = f"; what the {group}'s file leaves out is added: +{key}=..." if may_add else ""
    return told + suggest(prefix + name, [f"{prefix}{name}" for name in known]) + added


def _choices(group: str, name: str = "") -> list[str]:
    """Return the names of a group's files; for "suite/lqr" also those of its folder suite."""
    folder = name.partition("/")[0]
    with _hydra() as hydra:
        names = hydra.config_loader().get_group_options
        inner = names(f"{group}/{folder}") if folder else []
        return [*names(group), *(f"{folder}/{one}" for one in inner)]


def resolved(config: DictConfig) -> dict[str, Any]:
    """Return the configuration as plain Python, interpolations resolved, without Hydra's own part.

    Raises:
        ConfigError: If a value is missing or an interpolation leads nowhere.
    """
    try:
        plain: dict[str, Any] = OmegaConf.to_container(  # type: ignore[assignment]
            OmegaConf.masked_copy(config, [k for k in map(str, config) if k not in NOT_OF_THE_RUN]),
            resolve=True,
            throw_on_missing=True,
            enum_to_str=True,
        )
    except OmegaConfBaseException as error:
        raise ConfigError(explain(error, [])) from error
    check_keys(plain, RunSchema, "")
    check_keys(plain["evaluation"], EvaluationSchema, "evaluation.")
    return plain


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
