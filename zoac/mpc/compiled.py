"""Functions compiled by Numba, kept on disk where there is a place for it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numba

_told: list[bool] = []


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
