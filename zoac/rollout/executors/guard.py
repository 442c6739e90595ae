"""A process that ends, with the processes it started, when the one that started it does.

On Linux the program that `guarded` starts leads a process group with a small watcher in it. The
watcher sees the starting process or the program itself end, however that happens, and kills the
group. So no simulator is left behind by a SIGKILL. The jobs of a sweep, which may run on other
machines, follow a file instead: `zoac.runs.training.lifeline`.

This file is also that program, and is read by an interpreter without zoac.
"""

from __future__ import annotations

import os
import select
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import subprocess

IS_POSSIBLE = sys.platform == "linux" and hasattr(os, "pidfd_open")
"""Whether programs can be guarded."""


def started(words: Sequence[str], **options: Any) -> subprocess.Popen[bytes]:
    """Start a program in a process group of its own, guarded where that is possible.

    Args:
        words: The program and its arguments.
        options: Of `subprocess.Popen`.

    Raises:
        OSError: If it cannot be started.
    """
    import subprocess

    if IS_POSSIBLE:
        guard = [sys.executable, "-I", "-S", __file__, str(os.getpid())]
        words = [*guard, *words]
    # Ctrl-C is for this process to handle.
    return subprocess.Popen(words, start_new_session=os.name == "posix", **options)


def kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a program that `started` returned and its children, whether or not it has ended."""
    if os.name == "posix":
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)  # it leads a group of its own
    elif process.poll() is None:
        import subprocess

        words = ["taskkill", "/F", "/T", "/PID", str(process.pid)]
        subprocess.run(words, capture_output=True, check=False)


def main(parent: int, words: Sequence[str]) -> None:
    """Become the program, beside a watcher that kills this group with the process `parent`."""
    ends = []
    with suppress(OSError):  # an old kernel or a container may forbid it: then without a watcher
        ends = [os.pidfd_open(process) for process in (parent, os.getpid())]
    if os.getppid() != parent:  # it has ended already
        return
    if ends:
        _start_watcher(ends)
    for ignored in (signal.SIGPIPE, signal.SIGXFSZ):  # by Python, for itself
        signal.signal(ignored, signal.SIG_DFL)
    try:
        os.execvp(words[0], list(words))
    except OSError as error:
        sys.exit(f"cannot start {words[0]!r}: {error.strerror}")


def _start_watcher(ends: Sequence[int]) -> None:
    """Start the watcher as a grandchild, so that the program has no child it does not know."""
    if (child := os.fork()) == 0:
        if os.fork() == 0:
            _watch(ends)
        os._exit(0)
    os.waitpid(child, 0)


def _watch(ends: Sequence[int]) -> None:
    """Wait until one of the processes ends, and kill this process group."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):  # what reads the program's output waits for its end
        os.dup2(nothing, stream)
    select.select(ends, [], [])
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
