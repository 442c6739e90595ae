"""Functions compiled by Numba, kept on disk where there is a place for it."""

import sys
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event

_told: list[bool] = []


class _Announcement(event.Listener):
    """Say on standard error, once a process, that zoac's functions are being compiled."""

    told = False

    def on_start(self, event: event.Event) -> None:
        module = event.data["dispatcher"].py_func.__module__ or ""
        if not self.told and module.startswith("zoac.") and sys.stderr is not None:
            self.told = True
            print("compiling, for up to a minute; later runs find it done...", file=sys.stderr)

    def on_end(self, event: event.Event) -> None:
        pass


event.register("numba:compile", _Announcement())


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator like `numba.njit(cache=True, **options)`.

    Where no cache can be written (a read-only installation without a home folder), the function is
    compiled anew in every process, and one line says so.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        try:
            return numba.njit(cache=True, **options)(function)
        except RuntimeError as error:  # no place for a cache
            if not _told and sys.stderr is not None:
                print(
                    f"compiled code cannot be kept on disk ({error}), so that every process "
                    "compiles anew; set NUMBA_CACHE_DIR to a folder that can be written to",
                    file=sys.stderr,
                )
                _told.append(True)
            return numba.njit(**options)(function)

    return decorate
