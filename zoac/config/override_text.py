"""What people type as overrides: as Hydra takes it, and why Hydra cannot read it."""

import re
from collections.abc import Sequence
from pathlib import Path


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


def why_unreadable(text: str, complaint: str) -> str | None:
    """Return why Hydra cannot read an override, and what to write; None: its own words say it.

    Args:
        text: The override.
        complaint: Hydra's message, which points at the first character that it cannot read.
    """
    key, equals, value = text.partition("=")
    if not equals:
        key, _, value = text.lstrip("-").partition(" ")
        meant = f"; did you mean {key}={value or '<value>'}?" if _KEY.fullmatch(key) else ""
        return f"expected key=value{meant}"
    pointed = _POINTER.search(complaint)
    if pointed is None:
        return None
    found = text[len(pointed[1]) - len(_COMPLAINT)]
    if found in "'\"":
        return "a quote is not closed; write key=value"
    if found in key:
        return f"a key has no {found!r}; write key=value"
    quoted = f"""; write "{key}='{value}'\"""" if not set(value) & set("'\"[]{}()") else ""
    return f"a value with {found!r} needs quotes{quoted}"


_COMPLAINT = "LexerNoViableAltException: "
_POINTER = re.compile(r"^( *)\^$", re.MULTILINE)
_KEY = re.compile(r"[A-Za-z_][\w.]*")
