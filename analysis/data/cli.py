"""Options, error messages and output files that the commands of this package have in common."""

import argparse
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from zoac.analysis.data.load import load
from zoac.analysis.data.runs import WITHOUT_VARIANT, Collection
from zoac.core.errors import ConfigError, ZoacError, needs_matplotlib, suggest
from zoac.run.pipes import reader_may_leave

FORMATS = ("svg", "pdf", "png")
WIDTH = 100
"""Columns of prose in Markdown."""


def folder(text: str) -> Path:
    """Parse a path, which may begin with ~."""
    return Path(text).expanduser()


def _whole(least: int, text: str) -> int:
    if not text.isdecimal() or int(text) < least:
        raise argparse.ArgumentTypeError(
            f"expected a whole number of at least {least}, got {text!r}"
        )
    return int(text)


count, seed = partial(_whole, 1), partial(_whole, 0)


def seeds(text: str) -> list[int]:
    """Parse seeds such as 0,3,4 or 0-9 into ascending numbers without repetition."""
    found: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.partition("-")
        if not first.isdecimal() or (dash and not (last.isdecimal() and int(first) <= int(last))):
            raise argparse.ArgumentTypeError(f"expected seeds such as 0,3,4 or 0-9, got {text!r}")
        found.update(range(int(first), int(last or first) + 1))
    return sorted(found)


def formats(text: str) -> list[str]:
    """Parse a list of picture formats such as svg,pdf."""
    chosen = text.split(",")
    for name in chosen:
        if name not in FORMATS:
            raise argparse.ArgumentTypeError(f"unknown format {name!r}; {suggest(name, FORMATS)}")
    return chosen


OPTIONS: dict[str, dict[str, Any]] = {
    "task": {"help": "default: the only one there is"},
    "variant": {
        "metavar": "NAME",
        "help": f"use only runs of this variant; {WITHOUT_VARIANT}: only runs without a variant",
    },
    "trust_code": {
        "action": "store_true",
        "help": "load modules that run folders name, and pickles that they hold, to build their "
        "tasks; both can execute any code, so use it only for folders of people whom you trust",
    },
    "format": {
        "type": formats,
        "default": list(FORMATS),
        "metavar": "svg,pdf,png",
        "help": "default: all three",
    },
}
"""Options that several commands have; those that drive controllers of one task have all."""


def command(
    module: str, summary: str, out: str, /, *shared: str, **own: dict[str, Any]
) -> Callable[[Callable[[argparse.Namespace], None]], Callable[..., int]]:
    """Make a command of a function of its options, which knows RUNS and --out.

    Called with a list of arguments, by default those of the command line, it returns the exit code.
    A user's error is printed as one message.

    Args:
        module: The command's module.
        summary: One sentence for --help.
        out: Default output folder.
        shared: Further options, keys of `OPTIONS`.
        own: Arguments of `ArgumentParser.add_argument`, by option.
    """

    def made(body: Callable[[argparse.Namespace], None]) -> Callable[..., int]:
        def main(argv: Sequence[str] | None = None) -> int:
            prog = f"python -m zoac.analysis.{module}"
            parser = argparse.ArgumentParser(prog=prog, description=summary)
            parser.add_argument("runs", type=folder, help="a folder of runs, or one run folder")
            where = {"type": folder, "default": Path(out), "metavar": "FOLDER"}
            named: dict[str, dict[str, Any]] = {"out": {**where, "help": f"default: {out}"}}
            named |= {name: OPTIONS[name] for name in shared} | own
            for name, arguments in named.items():
                parser.add_argument(f"--{name.replace('_', '-')}", **arguments)
            options = parser.parse_args(argv)
            try:
                with reader_may_leave(), needs_matplotlib():
                    body(options)
            except ZoacError as error:
                print(f"error: {error}", file=sys.stderr)
                return 1
            return 0

        return main

    return made


def load_runs(options: argparse.Namespace, *, episodes: bool = True) -> Collection:
    """Load the runs that the options name; print which folders are left out, and why.

    Args:
        options: `runs`, and if the command has them `variant` and `trust_code`.
        episodes: Whether the cost of each episode is needed.

    Raises:
        RunFolderError: If nothing can be read, or episodes are needed and were not kept.
    """
    collection = load(options.runs, trust_code=getattr(options, "trust_code", False))
    for run in collection.finished if episodes else ():
        _ = run.costs
    for item in collection.left_out:
        print(f"left out {item}", file=sys.stderr)
    return collection


def load_one_task(options: argparse.Namespace) -> Collection:
    """Load the runs of `options.task`, by default the only task, and of `options.variant`."""
    collection = load_runs(options)
    found = {run.method.task for run in collection.some_finished()}
    return collection.of_task(options.task or only_task(found)).of_variant(options.variant)


def only_task(found: set[str]) -> str:
    """Return the only one of some tasks; refuse several."""
    if len(found) > 1:
        raise ConfigError(f"runs of several tasks; choose with --task: {', '.join(sorted(found))}")
    return next(iter(found))


def write(path: Path, content: str | bytes) -> None:
    """Write one output file and print its name."""
    with writing(path):
        path.write_bytes(content.encode() if isinstance(content, str) else content)


def write_markdown(path: Path, text: str) -> None:
    """Print and write Markdown; prose and bullets are wrapped, rows of tables are not."""
    text = "\n".join(map(_wrapped, text.split("\n")))
    print(text)
    write(path, text)


def _wrapped(line: str) -> str:
    if line.startswith(("|", "#")):
        return line
    # A line that began with a minus sign would be a bullet.
    bound, indent = line.replace(" - ", "\0-\0"), "  " if line.startswith("- ") else ""
    return textwrap.fill(
        bound, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    ).replace("\0", " ")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Make the folder of `path`, let the body write the file and print its name.

    Raises:
        ConfigError: If it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror or error}") from None
    print(f"wrote {path}")
