"""How a command line ends and prints, whoever reads it and in whatever encoding."""

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def reader_may_leave() -> Iterator[None]:
    """Exit with 1 and without a traceback where the reader has had enough (`| head`).

    Letters that the terminal's encoding lacks are written as escapes.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        try:
            yield
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        # Python flushes once more at its end; what is left goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def leave(number: int, frame: Any) -> None:
    """Exit as by Ctrl-C, without a traceback: the handler while a command line is imported."""
    os.write(sys.stderr.fileno(), b"interrupted\n")
    os._exit(130)
