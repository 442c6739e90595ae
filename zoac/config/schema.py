"""What Hydra checks: types of the top-level keys, made from the settings; overrides as text."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import field, fields, make_dataclass
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from zoac.config.files import AUTO
from zoac.config.settings import Evaluation, Resume, Settings
from zoac.core.errors import ConfigError, suggest

NOT_OF_THE_RUN = ("hydra", "method", "experiment", "search")


def _typed(owner: type) -> list[tuple[str, Any, Any]]:
    """Return the fields of a dataclass as Hydra takes them: bounds and choices left out."""
    hints = get_type_hints(owner)
    return [(f.name, _plain_type(hints[f.name]), f.default) for f in fields(owner)]


def _plain_type(hint: Any) -> Any:
    if get_origin(hint) is Literal:
        return str
    if NoneType in get_args(hint):
        (kind,) = set(get_args(hint)) - {NoneType}
        return _plain_type(kind) | None
    return hint


GROUPS_OF_RUN = ("task", "tuner", "executor", "mpc_solver", "fidelity", "logger")

EvaluationSchema = make_dataclass("EvaluationSchema", _typed(Evaluation))

# Types of the top-level keys; groups are checked against what they configure.
RunSchema = make_dataclass(
    "RunSchema",
    [(group, Any, MISSING) for group in GROUPS_OF_RUN]
    + [
        (name, EvaluationSchema, field(default_factory=EvaluationSchema))
        if kind is Evaluation
        else (name, kind, default)
        for name, kind, default in _typed(Settings)
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


def with_whole_steps(overrides: Sequence[str]) -> list[str]:
    """Return the overrides as Hydra takes them: 5e4 steps written out, and ~ as the home folder."""
    home = str(Path("~").expanduser())
    plain = [_HOME.sub(lambda found: f"{found[1]}={home}", text) for text in overrides]
    return [_STEPS.sub(_written_out, text) for text in plain]


_HOME = re.compile(r"^([+\w.]+)=~(?=/|$)")
_STEPS = re.compile(r"(?<=[=,])\d+(?:\.\d+)?[eE]\+?\d+(?=,|$)")
_COUNTS_STEPS = re.compile(r"\+*(budget|eval_every)=")


def _written_out(found: re.Match[str]) -> str:
    number = float(found[0])
    # Beyond 1e15 not every whole number is one of these, and nobody means it.
    counts = _COUNTS_STEPS.match(found.string) and number.is_integer() and number <= 1e15
    return str(int(number)) if counts else found[0]


def refuse_flags(arguments: Sequence[str]) -> None:
    """Refuse `--budget 3000` and `--budget=3000`, which Hydra would answer with its usage.

    Raises:
        ConfigError: If a key is written as a flag.
    """
    known = {*NOT_OF_THE_RUN, *(one.name for one in fields(RunSchema))}
    for flag, after in zip(arguments, [*arguments[1:], ""], strict=True):
        key, equals, value = flag.removeprefix("--").partition("=")
        if not flag.startswith("--") or key.partition(".")[0] not in known:
            continue
        if not equals and "=" not in after and not after.startswith("-"):
            value, flag = after, f"{flag} {after}".rstrip()
        raise ConfigError(f"{flag}: expected key=value; did you mean {key}={value or '<value>'}?")


def why_unreadable(text: str, error: Exception) -> str:
    """Return why Hydra cannot read an override, and what to write.

    Args:
        text: The override.
        error: Hydra's; its cause knows the place of a character that no override may have there.
    """
    key, equals, value = text.partition("=")
    if not equals:
        key, _, value = text.lstrip("-").partition(" ")
        meant = f"; did you mean {key}={value or '<value>'}?" if _KEY.fullmatch(key) else ""
        return f"expected key=value{meant}"
    place = getattr(error.__cause__, "startIndex", None)
    if place is None:
        return f"{str(error).strip()}; write key=value"
    found = text[place]
    if found in "'\"":
        return "a quote is not closed; write key=value"
    if found in key:
        return f"a key has no {found!r}; write key=value"
    quoted = f"""; write "{key}='{value}'\"""" if not set(value) & set("'\"[]{}()") else ""
    return f"a value with {found!r} needs quotes{quoted}"


_KEY = re.compile(r"[A-Za-z_][\w.]*")
