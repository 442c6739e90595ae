"""Functions compiled by Numba, kept on disk where there is a place for it."""

import sys
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event

_said: set[str] = set()


def _say_once(about: str, text: str) -> None:
    """Say something on standard error, once a process."""
    if about not in _said and sys.stderr is not None:
        _said.add(about)
        print(text, file=sys.stderr)


class _Announcement(event.Listener):
    """Say that zoac's functions are being compiled."""

    def on_start(self, event: event.Event) -> None:
        module = event.data["dispatcher"].py_func.__module__ or ""
        if module.startswith("zoac."):
            _say_once("start", "compiling, for up to a minute; later runs find it done...")

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
            _say_once(
                "no cache",
                f"compiled code cannot be kept on disk ({error}), so that every process "
                "compiles anew; set NUMBA_CACHE_DIR to a folder that can be written to",
            )
            return numba.njit(**options)(function)

    return decorate
