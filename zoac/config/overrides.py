"""Overrides as text, before Hydra reads them."""

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
    """Refuse `--seed 3` and `--seed=3`, which Hydra would answer with its usage.

    Raises:
        ConfigError: If a key is written as a flag.
    """
    known = {*NOT_OF_THE_RUN, *GROUPS_OF_RUN, *RUN_KEYS}
    for flag, after in zip(arguments, [*arguments[1:], ""], strict=False):
        key, equals, value = flag.removeprefix("--").partition("=")
        if flag.startswith("--") and key.partition(".")[0] in known:
            value = value if equals else after
            raise ConfigError(f"{flag}: expected key=value; did you mean {key}={value or '...'}?")
