"""Numbers as a reader wants them: rounded to what they mean."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

UNKNOWN = "–"

# Rounding of a zero: no quantity of a robot is that small in SI units.
_NOTHING = 1e-14


def rounded(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, "–" where it is not known; no exponent between 1e-4 and 1e6."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if abs(value) < _NOTHING:
        return "0"
    place = digits - 1 - _magnitude(value, digits)
    if not -7 < _magnitude(value, digits) < 6 or place > 9:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    return f"{round(value, place):.{max(place, 0)}f}".replace("-", "−")


def with_sigma(value: float | None, sigma: float | None) -> tuple[str, str]:
    """Value and standard deviation as texts: σ with two significant digits, the value to the same place."""
    if value is None or not math.isfinite(value):
        return UNKNOWN, UNKNOWN
    if sigma is None or not math.isfinite(sigma) or sigma <= 0.0:
        return rounded(value, 4), UNKNOWN
    place = 1 - _magnitude(sigma, 2)
    if place > 9 or place < -6:
        return rounded(value, 4), rounded(sigma, 2)
    texts = (f"{round(number, place):z.{max(place, 0)}f}" for number in (value, sigma))
    first, second = (text.replace("-", "−") for text in texts)
    return first, second


def row_of(values: Iterable[float | None], digits: int = 3) -> tuple[str, ...]:
    """One text per number."""
    return tuple(rounded(value, digits) for value in values)


def joint_heads(count: int) -> tuple[str, ...]:
    """Column heads "1" … "n" of a table by joint."""
    return tuple(str(joint + 1) for joint in range(count))


def listed(items: Sequence[str]) -> str:
    """Items as in a sentence: "1, 2 and 5"."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}" if items else ""


def chance(probability: float) -> str:
    """A probability; how far below one in a million it is, nobody needs."""
    return "below 1e−6" if probability < 1e-6 else rounded(probability, 2)


def unit_of(text: str) -> str:
    """A unit as it is printed: "kg m²" for "kg m^2"."""
    return text.replace("^2", "²")


def _magnitude(value: float, digits: int) -> int:
    """Decimal exponent of a number after rounding: 0.0996 with two digits is 0.10, so −1."""
    return int(f"{value:.{digits - 1}e}".split("e")[1])
