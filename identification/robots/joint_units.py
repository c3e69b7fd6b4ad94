"""Units by the kind of joint: what is Nm, rad and Nm s/rad on a revolute joint is N, m and N s/m on a prismatic one.

Results are computed the same for both; here are only the words. Pure functions of text. Called where a result is said.
"""

from __future__ import annotations

import re

__all__ = ["for_prismatic"]

_PREFIX = "(?P<prefix>[mkµ]?)"
_WORDS: tuple[tuple[re.Pattern[str], str], ...] = tuple(
    (re.compile(pattern), plain)
    for pattern, plain in (
        (rf"\b{_PREFIX}Nm s(?P<power>[²^2]*)/rad", r"\g<prefix>N s\g<power>/m"),
        (rf"\b{_PREFIX}Nm/rad", r"\g<prefix>N/m"),
        (rf"\b{_PREFIX}rad/Nm", r"\g<prefix>m/N"),
        (rf"\b{_PREFIX}Nm\b", r"\g<prefix>N"),
        (rf"\b{_PREFIX}rad(?![A-Za-z_])", r"\g<prefix>m"),
        (r"\bs/rad(?![A-Za-z_])", "s/m"),
        (r"\btorque(?!_)", "force"),
        (r"\bTorque", "Force"),
    )
)


def for_prismatic(text: str) -> str:
    """A unit or a sentence about a revolute joint in the units of a prismatic one; names with underscores stay."""
    for pattern, plain in _WORDS:
        text = pattern.sub(plain, text)
    return text
