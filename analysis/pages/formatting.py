"""Numbers as a table prints them."""

import math
from collections.abc import Sequence

from zoac.analysis.statistics.intervals import Interval, MeanStd

NOTHING = "--"
MAX_DIGITS = 6
"""After the point; an interval of small numbers that needs more has an exponent."""

PRECISION = 15
"""Significant digits of a float; more would show how it was rounded."""


def number(value: float, sign: bool = False) -> str:
    """Return `value` with two or more significant digits, in plain notation where that reads."""
    if not math.isfinite(value):
        return NOTHING
    plus = "+" if sign else ""
    if value == 0 or 1e-2 <= abs(value) < 1e6:
        return f"{value:{plus}.{_digits(value)}f}"
    mantissa, exponent = f"{value:{plus}.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def significant(value: float) -> str:
    """Return `value` with four significant digits."""
    if not math.isfinite(value):
        return "∞" if value > 0 else "-∞" if value < 0 else NOTHING
    if 1e3 <= abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.4g}"


def signed(value: float) -> str:
    """Return `value` likewise, with its sign."""
    return f"{'+' if value > 0 else ''}{significant(value)}"


def bounds(interval: Interval, sign: bool = False) -> str:
    """Return "[low, high]", with digits enough to tell the two apart, or "[3.0e-8, 3.1e-8]"."""
    if not interval.exists:
        return NOTHING
    low, _, high = _alike(interval, sign)
    return f"[{low}, {high}]"


def estimate(interval: Interval, sign: bool = False) -> str:
    """Return "estimate [low, high]", or the estimate alone."""
    if not interval.exists:
        return number(interval.estimate, sign)
    _, middle, _ = _alike(interval, sign)
    return f"{middle} {bounds(interval, sign)}"


def plus_minus(value: MeanStd) -> str:
    """Return "41.7 ± 3.8" or "(2.9 ± 1.4)e-4", as the paper prints; no ± for one seed."""
    if math.isnan(value.mean):
        return NOTHING
    if value.mean == 0 or 1e-2 <= abs(value.mean) < 1e4:
        if not math.isfinite(value.std):
            return f"{value.mean:.2f}"
        digits = _digits(value.mean)
        return f"{value.mean:.{digits}f} ± {value.std:.{digits}f}"
    exponent = int(f"{value.mean:.1e}".partition("e")[2])
    mean, std = value.mean / 10.0**exponent, value.std / 10.0**exponent
    return (
        f"({mean:.1f} ± {std:.1f})e{exponent}" if math.isfinite(std) else f"{mean:.1f}e{exponent}"
    )


def pipes(lines: Sequence[Sequence[str]]) -> str:
    """Return header and rows as a Markdown table."""
    header, *rows = lines
    rule = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (header, rule, *rows))


def without_empty_columns(lines: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return header and rows less the columns in which no row has anything."""
    columns = [c for c in zip(*lines, strict=True) if any(cell != NOTHING for cell in c[1:])]
    return [list(line) for line in zip(*columns, strict=True)]


def _digits(value: float) -> int:
    return 0 if abs(value) >= 1000 else 1 if abs(value) >= 10 else 2


def _alike(interval: Interval, sign: bool) -> list[str]:
    """Return low, estimate and high with the same digits and, where plain ones are too many, `e`.

    The digits show the estimate as usual and tell the bounds apart if more than rounding does.
    """
    low, middle, high = numbers = interval.low, interval.estimate, interval.high
    largest, width = max(map(abs, numbers)), high - low
    digits = max(1 - math.floor(math.log10(width)) if width > 0 else 0, _digits(middle))
    exponent = 0
    if digits > MAX_DIGITS or (width == 0 and 0 < largest < 1e-2):
        magnitude = math.floor(math.log10(largest))
        exponent = min(0, magnitude)
        digits = max(1, min(digits + exponent, PRECISION - max(0, magnitude)))
    plus, end = "+" if sign else "", f"e{exponent}" if exponent else ""
    return [f"{value / 10.0**exponent:{plus}.{digits}f}{end}" for value in numbers]
