"""Overrides as text: what is written out before Hydra reads them, and what it cannot read."""

import re
from collections.abc import Sequence
from pathlib import Path

from zoac.config.settings import RUN_KEYS
from zoac.core.errors import ConfigError

GROUPS_OF_RUN = ("task", "tuner", "executor", "mpc_solver", "fidelity", "logger")

NOT_OF_THE_RUN = ("hydra", "method", "experiment", "search")


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
    known = {*NOT_OF_THE_RUN, *GROUPS_OF_RUN, *RUN_KEYS}
    for flag, after in zip(arguments, [*arguments[1:], ""], strict=False):
        key, equals, value = flag.removeprefix("--").partition("=")
        if not flag.startswith("--") or key.partition(".")[0] not in known:
            continue
        if not equals and "=" not in after and not after.startswith("-"):
            value, flag = after, f"{flag} {after}".rstrip()
        raise ConfigError(f"{flag}: expected key=value; did you mean {key}={value or '<value>'}?")


def why_unreadable(text: str, error: Exception) -> str:
    """Return why Hydra cannot read an override, and what to write.

    The cause of Hydra's error knows the place of a character that no override may have there.
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
