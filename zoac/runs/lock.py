"""Locks on files that the system releases when their holder ends, however it ends."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from zoac.core.errors import RunFolderError


class HeldError(RunFolderError):
    """Another process holds the lock."""


@contextmanager
def locked(
    path: Path, wait: bool = False, poll: float = 0.02, held: str = "another process holds it"
) -> Iterator[None]:
    """Hold the lock on a file, which is made if it is missing.

    Args:
        path: The file.
        wait: Until nobody else holds it.
        poll: Seconds between two looks while it waits.
        held: What is wrong if another process holds it.

    Raises:
        HeldError: If another process holds it, unless told to wait.
        RunFolderError: If the file system has no locks.
    """
    with open(path, "a+") as file:
        while not _acquired(file):
            if not wait:
                raise HeldError(f"{path.parent}: {held}")
            time.sleep(poll)
        yield


def _acquired(file: IO[str]) -> bool:
    try:
        if os.name == "posix":
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    except (BlockingIOError, PermissionError):  # the two ways in which systems say "held"
        return False
    except OSError as error:
        raise RunFolderError(
            f"{file.name}: this file system has no locks ({error.strerror}); choose another folder"
        ) from None
    return True
