"""Die at every system call of a checkpoint write: `python -m stress.checkpoint_faults`.

A child process saves three checkpoints and dies at the k-th call that reaches the disk (open, half
a write, fsync, rename), for every k. Afterwards a whole checkpoint must load, no older than the
last one whose save had returned.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from zoac.runs import checkpoint


def child(folder: Path, die_at: int, acknowledged: Path) -> int:
    """Save 1, 2, 3 and die at the `die_at`-th low-level call; return how many calls were made."""
    calls = 0

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == die_at:
                os._exit(9)
            return function(*arguments, **options)

        return call

    os.replace = counted(os.replace)
    os.fsync = counted(os.fsync)
    os.open = counted(os.open)
    import builtins

    real_open = open

    def opening(*arguments: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == die_at:
            os._exit(9)
        file = real_open(*arguments, **options)
        if "w" in str(arguments[1:]) and str(arguments[0]).startswith(str(folder)):
            file = _Halting(file, counted)
        return file

    builtins.open = opening  # type: ignore[assignment]
    for number in (1, 2, 3):
        checkpoint.save(folder, {"number": number, "ballast": "x" * 100_000})
        descriptor = os.open(acknowledged, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        calls -= 1  # not part of the write under test
        os.write(descriptor, str(number).encode())
        os.close(descriptor)
    return calls


class _Halting:
    """A file whose writes can be cut in the middle."""

    def __init__(self, file: Any, counted: Callable[..., Any]) -> None:
        self._file = file
        self._half = counted(lambda: None)

    def write(self, body: bytes) -> int:
        self._file.write(body[: len(body) // 2])
        self._file.flush()
        self._half()
        return len(body[: len(body) // 2]) + int(self._file.write(body[len(body) // 2 :]))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __enter__(self) -> _Halting:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()


def main() -> None:
    """Die once at every call."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    die_at = 0
    while True:
        die_at += 1
        with tempfile.TemporaryDirectory() as temporary:
            folder, acknowledged = Path(temporary, "checkpoint"), Path(temporary, "saved")
            pid = os.fork()
            if pid == 0:
                child(folder, die_at, acknowledged)
                os._exit(0)
            _, status = os.waitpid(pid, 0)
            saved = int(acknowledged.read_text()) if acknowledged.exists() else 0
            found = checkpoint.load(folder)
            number = 0 if found is None else found[0]["number"]
            if number < saved:
                sys.exit(f"death at call {die_at}: {saved} was saved, {number} was found")
            if os.waitstatus_to_exitcode(status) == 0:
                break
    print(f"{die_at - 1} places to die, a whole checkpoint after each")


if __name__ == "__main__":
    main()
