"""Types of the top-level keys, made from the settings, for Hydra to check."""

from collections.abc import Mapping
from dataclasses import field, fields, make_dataclass
from enum import Enum
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from zoac.config.files import AUTO
from zoac.config.settings import Evaluation, Settings
from zoac.core.errors import ConfigError, suggest

NOT_OF_THE_RUN = ("hydra", "method", "experiment", "search")


class Resume(Enum):
    """What to do when the run folder holds a run already."""

    auto = "auto"
    never = "never"
    overwrite = "overwrite"


def _typed(owner: type, defaults: Any) -> list[tuple[str, Any, Any]]:
    """Return the fields of a dataclass as Hydra takes them: bounds and choices left out."""
    hints = get_type_hints(owner)
    return [(f.name, _plain_type(hints[f.name]), getattr(defaults, f.name)) for f in fields(owner)]


def _plain_type(hint: Any) -> Any:
    if get_origin(hint) is Literal:
        return str
    if NoneType in get_args(hint):
        (kind,) = set(get_args(hint)) - {NoneType}
        return _plain_type(kind) | None
    return hint


_GROUPS_OF_RUN = ("task", "tuner", "executor", "mpc_solver", "fidelity", "logger")

EvaluationSchema = make_dataclass("EvaluationSchema", _typed(Evaluation, Evaluation()))

# Types of the top-level keys; groups are checked against what they configure.
RunSchema = make_dataclass(
    "RunSchema",
    [(group, Any, MISSING) for group in _GROUPS_OF_RUN]
    + [
        (name, EvaluationSchema, field(default_factory=EvaluationSchema))
        if kind is Evaluation
        else (name, kind, default)
        for name, kind, default in _typed(Settings, Settings())
    ]
    + [
        ("runs_dir", str, "runs"),
        ("variant", str | None, None),
        ("resume", Resume, Resume.auto),
        ("search", Any, None),  # of `zoac.search`; no part of a run
    ],
)


ConfigStore.instance().store(group="zoac", name="run_schema", node=RunSchema)
ConfigStore.instance().store(group="tuner", name=AUTO, node={})


def check_keys(given: Any, schema: type, prefix: str) -> None:
    """See that a schema's keys are there and no others, which `+key=value` and `~key` can undo."""
    known = [f.name for f in fields(schema) if f.name not in NOT_OF_THE_RUN]
    if not isinstance(given, Mapping):
        raise ConfigError(f"{prefix[:-1]}={given!r}: expected the keys {', '.join(known)}")
    for key in given:
        if key not in known:
            raise ConfigError(f"unknown key '{prefix}{key}'; {suggest(str(key), known)}")
    for key in known:
        if key not in given:
            raise ConfigError(f"{prefix}{key}: a value is needed")
