"""The table of all options: `python -m tests.docs.options > docs/options.md`.

Names, types, bounds, defaults and explanations are those of the code: signatures and docstrings.
"""

from __future__ import annotations

import importlib
import inspect
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from omegaconf import OmegaConf

from zoac.config.files import choice, choices
from zoac.config.settings import Settings
from zoac.config.validate import _signature

CONF = Path(__file__).parents[2] / "conf"

GROUPS = {
    "task": "Tasks",
    "tuner": "Tuners",
    "executor": "Executors",
    "mpc_solver": "Solvers of the MPC",
}

HEAD = """\
# Options

Every option of the command line, with its type, bounds and default. Write `name=value`, such as
`python -m zoac.run task=pid_acc tuner=zoac tuner.exploration.sigma=0.05`. In Python the options of
the run are arguments of `zoac.tune`, and those of a tuner go into `tuner_options`:
`{"exploration": {"sigma": 0.05}}`. An option that the task's file leaves out is added with `+`:
`+task.name=value`. Tuners have other defaults for some tasks: see `conf/preset/`.
"""


def main() -> str:
    """Return the page."""
    return "\n".join([HEAD, *run_section(), *(line for g in GROUPS for line in section(g))])


def run_section() -> Iterator[str]:
    """Yield the options of the run, and those that say where it is kept."""
    yield "## The run\n"
    yield from table(rows(Settings))
    yield from rows_of_file(CONF / "run.yaml", "", ("runs_dir", "variant", "resume"))
    yield ""


def rows_of_file(path: Path, prefix: str, keys: Sequence[str] | None = None) -> Iterator[str]:
    """Yield rows from a file's own lines and comments, where no class tells more."""
    found = re.findall(r"^(\w+): (.+?)(?: # (.*))?$", path.read_text(), re.M)
    for key, default, told in found:
        if key[0] != "_" and (keys is None or key in keys):
            yield f"| `{prefix}{key}` | | {default} | {one_line(told)} |"


def section(group: str) -> Iterator[str]:
    """Yield a table for each choice of a group; one that begins from another names what differs."""
    yield f"## {GROUPS[group]}\n"
    for name in (name for name in choices(group) if "/" not in name):  # not the suite's
        own = OmegaConf.to_container(OmegaConf.load(CONF / group / f"{name}.yaml"))
        yield f"### `{group}={name}`\n"
        if "defaults" in own:
            told = ", ".join(f"`{k}={text(v)}`" for k, v in own.items() if k != "defaults")
            yield textwrap.fill(f"As `{group}={own['defaults'][0]}`, with {told}.", 100) + "\n"
            continue
        if name == "ray":  # its class cannot be imported without Ray
            listed = list(rows_of_file(CONF / group / f"{name}.yaml", f"{group}."))
        else:
            target = choice(group, name)["_target_"]
            if name in ("botorch", "smac"):  # needs its library, and has its base's options
                target = "zoac.baselines.extras.model_tuner.ModelTuner"
            module, _, last = target.rpartition(".")
            listed = list(rows(getattr(importlib.import_module(module), last), f"{group}."))
        yield from table(listed) if listed else ["No options."]
        yield ""


def table(lines: Any) -> Iterator[str]:
    """Yield a Markdown table."""
    yield "| option | type | default | what it does |"
    yield "|---|---|---|---|"
    yield from lines


def rows(target: Any, prefix: str = "") -> Iterator[str]:
    """Yield a row for each argument of a class or function, those of a group inside it."""
    arguments, hints = _signature(target)
    told = explanations(target)
    for name, argument in arguments.items():
        hint = hints.get(name, Any)
        if name in ("self", "problem", "return"):
            continue
        groups = [h for h in (hint, *get_args(hint)) if inspect.isclass(h) and is_dataclass(h)]
        for group in groups:
            for row in rows(group, f"{prefix}{name}."):
                yield with_default(row, argument.default)
        if groups:
            continue
        default = "needed" if argument.default is argument.empty else text(argument.default)
        yield f"| `{prefix}{name}` | {kind(hint)} | {default} | {told.get(name, '')} |"


def with_default(row: str, start: Any) -> str:
    """Return a group's row with the default that its owner has, where it is another."""
    cells = row.split(" | ")
    name = cells[0].removeprefix("| `").removesuffix("`").rpartition(".")[2]
    cells[2] = text(getattr(start, name)) if hasattr(start, name) else cells[2]
    return " | ".join(cells)


def explanations(target: Any) -> dict[str, str]:
    """Return what the docstrings of a class and its bases say of each argument."""
    found: dict[str, str] = {}
    bases = target.__mro__ if inspect.isclass(target) else [target]
    for base in bases:
        for documented in (base, vars(base).get("__init__") if inspect.isclass(base) else None):
            doc = inspect.getdoc(documented) or ""
            body = doc.partition("Args:\n")[2].partition("\n\n")[0]
            entries = re.findall(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", body, re.M)
            found |= {n: one_line(t) for n, t in entries if n not in found}
    return found


def one_line(told: str) -> str:
    """Return an explanation on one line, ready for a table."""
    return re.sub(r"\s+", " ", told).replace("|", "\\|")


def kind(hint: Any) -> str:
    """Return a type as people read it, with its bounds."""
    if get_origin(hint) is Annotated:
        base, *notes = get_args(hint)
        limits = [limit for note in notes for limit in bounds(note)]
        return f"{kind(base)} {', '.join(limits)}".strip()
    if get_origin(hint) is Literal:
        return ", ".join(f"`{value}`" for value in get_args(hint))
    if get_origin(hint) in (Union, UnionType):
        parts = [kind(part) for part in get_args(hint)]
        return " or ".join(parts)
    if get_origin(hint) is not None and (inner := get_args(hint)):
        name = "list of" if len(inner) == 1 or get_origin(hint) is tuple else "by name:"
        return f"{name} {kind(inner[-1] if inner[-1] is not ... else inner[0])}"
    plain = {int: "whole number", float: "number", str: "text", bool: "true or false"}
    return plain.get(hint, "null" if hint is NoneType else getattr(hint, "__name__", "any"))


def bounds(note: Any) -> list[str]:
    """Return the limits that an annotation sets."""
    signs = {Ge: ("≥", "ge"), Gt: (">", "gt"), Le: ("≤", "le"), Lt: ("<", "lt")}
    return [
        f"{signs[type(m)][0]} {getattr(m, signs[type(m)][1]):g}"
        for m in getattr(note, "metadata", [])
        if type(m) in signs
    ]


def text(value: Any) -> str:
    """Return a default as YAML has it."""
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(text, value))}]"
    return str(value) or "none"


if __name__ == "__main__":
    print(main())
