"""Ranges of numbers that options declare; what counts as a number, and as a finite one."""

import math
import sys
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

Natural = Annotated[int, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]
NonNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
UnitInterval = Annotated[float, Field(ge=0, le=1)]
Fraction = Annotated[float, Field(gt=0, lt=1)]


def is_number(value: Any) -> bool:
    """Tell whether `value` is a real number of Python's or numpy's, no larger than floats can be.

    True and False are none.
    """
    if isinstance(value, int):
        return not isinstance(value, bool) and abs(value) <= sys.float_info.max
    return isinstance(value, float | np.integer | np.floating)


def all_finite(array: np.ndarray) -> bool:
    """Tell whether no number of a real array is infinite or NaN."""
    # The sum of squares is quickest, but may overflow where every number is finite.
    return math.isfinite(np.vdot(array, array)) or bool(np.isfinite(array).all())


def bad_is_infinite(costs: ArrayLike) -> np.ndarray:
    """Return costs, any shape, with plus infinity for what is not finite."""
    return np.where(np.isfinite(costs), costs, np.inf)
