"""What the commands of this package share: arguments, one message for an error, output files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from zoac.analysis.data.load import load
from zoac.analysis.data.runs import WITHOUT_VARIANT, Collection
from zoac.cli.pipes import reader_may_leave
from zoac.core.errors import ConfigError, ZoacError, suggest

FORMATS = ("svg", "pdf", "png")


def parser(module: str, summary: str, out: str) -> argparse.ArgumentParser:
    """Return a parser that knows RUNS and --out.

    Args:
        module: The command's module.
        summary: One sentence for --help.
        out: Default output folder.
    """
    made = argparse.ArgumentParser(prog=f"python -m zoac.analysis.{module}", description=summary)
    made.add_argument("runs", type=folder, help="a folder of runs, or one run folder")
    made.add_argument(
        "--out", type=folder, default=Path(out), metavar="FOLDER", help=f"default: {out}"
    )
    return made


def folder(text: str) -> Path:
    """Parse a path, which may begin with ~."""
    return Path(text).expanduser()


def count(text: str) -> int:
    """Parse a whole number of at least 1."""
    return _whole(text, 1)


def seed(text: str) -> int:
    """Parse a whole number of at least 0."""
    return _whole(text, 0)


def _whole(text: str, least: int) -> int:
    if not text.isdecimal() or int(text) < least:
        raise argparse.ArgumentTypeError(
            f"expected a whole number of at least {least}, got {text!r}"
        )
    return int(text)


def seeds(text: str) -> list[int]:
    """Parse seeds, 0,3,4 or 0-9 or both, into ascending ones that differ."""
    found: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.partition("-")
        if not first.isdecimal() or (dash and not (last.isdecimal() and int(first) <= int(last))):
            raise argparse.ArgumentTypeError(f"expected seeds such as 0,3,4 or 0-9, got {text!r}")
        found.update(range(int(first), int(last or first) + 1))
    return sorted(found)


def add_variant(parser: argparse.ArgumentParser) -> None:
    """Add --variant, for `Collection.of_variant`."""
    parser.add_argument(
        "--variant",
        metavar="NAME",
        help=f"keep to runs of this variant; {WITHOUT_VARIANT}: to those without one",
    )


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Add --trust-code, for commands that build the task of a run again."""
    parser.add_argument(
        "--trust-code",
        action="store_true",
        help="load modules that run folders name, and pickles that they hold, to build their tasks "
        "again; either can do anything, so only for folders of people whom you trust",
    )


def add_formats(parser: argparse.ArgumentParser) -> None:
    """Add --format, a list of picture formats."""

    def formats(text: str) -> list[str]:
        chosen = text.split(",")
        for name in chosen:
            if name not in FORMATS:
                raise argparse.ArgumentTypeError(
                    f"unknown format {name!r}; {suggest(name, FORMATS)}"
                )
        return chosen

    parser.add_argument(
        "--format",
        type=formats,
        default=list(FORMATS),
        metavar="svg,pdf,png",
        help="default: all three",
    )


def guarded(
    body: Callable[[argparse.Namespace], None],
    arguments: argparse.ArgumentParser,
    argv: Sequence[str] | None,
) -> int:
    """Parse `argv` and call `body`; print a user's error as one message and return 1."""
    options = arguments.parse_args(argv)
    try:
        with reader_may_leave():
            body(options)
    except ZoacError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def load_aloud(root: Path, *, episodes: bool = True, trust_code: bool = False) -> Collection:
    """Load runs; name on stderr each folder that is left out, and why.

    Args:
        root: A folder of runs, or one run folder.
        episodes: Whether the cost of each episode is needed.
        trust_code: Whether a replay may load code that is not zoac's own.

    Raises:
        RunFolderError: If nothing can be read, or episodes are needed and were not kept.
    """
    collection = load(root, trust_code=trust_code)
    for run in collection.finished if episodes else ():
        _ = run.costs
    for item in collection.left_out:
        print(f"left out {item}", file=sys.stderr)
    return collection


def only_task(collection: Collection) -> str:
    """Return the only task there is.

    Raises:
        ConfigError: If there are several.
        RunFolderError: If no run is finished.
    """
    tasks = sorted({run.method.task for run in collection.some_finished()})
    if len(tasks) > 1:
        raise ConfigError(f"runs of several tasks; choose with --task: {', '.join(tasks)}")
    return tasks[0]


def output_folder(path: Path) -> Path:
    """Make and return a folder for output.

    Raises:
        ConfigError: If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot make the output folder {path}: {error.strerror}") from None
    return path


def write(path: Path, content: str | bytes) -> None:
    """Write one output file and say so.

    Raises:
        ConfigError: If it cannot be written.
    """
    with writing(path):
        path.write_bytes(content.encode() if isinstance(content, str) else content)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Let the body write one output file, and say so.

    Raises:
        ConfigError: If it cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror or error}") from None
    print(f"wrote {path}")
