"""The numbers of a row, as loggers want them: flat names and floats."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from zoac.core.types import is_number


def numbers(row: Mapping[str, Any]) -> dict[str, float]:
    """Return what is a number in `row`; of a mapping inside, `name/key`; lists are left out."""
    flat: dict[str, float] = {}
    for name, value in row.items():
        if isinstance(value, Mapping):
            flat.update({f"{name}/{k}": v for k, v in numbers(value).items()})
        elif is_number(value):
            flat[name] = value
    return flat
