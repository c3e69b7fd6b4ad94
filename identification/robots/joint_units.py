"""Units by the kind of joint: what is Nm, rad and Nm s/rad on a revolute joint is N, m and N s/m on a prismatic one.

Results are computed the same for both; here are only the words. Pure functions of text. Called where a result is said.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

_PREFIX = "(?P<prefix>[mkµ]?)"
_WORDS: tuple[tuple[re.Pattern[str], str], ...] = tuple(
    (re.compile(pattern), plain)
    for pattern, plain in (
        (rf"\b{_PREFIX}Nm s(?P<power>[²^2]*)/rad", r"\g<prefix>N s\g<power>/m"),
        (r"\bkg m(²|\^2)", "kg"),
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


_JOINTS = re.compile(r"\bjoints? (?P<first>\d+)(?: to (?P<last>\d+))?", re.IGNORECASE)
_SENTENCE_END = re.compile(r"(?<=[.;:]) +(?=[A-Z])")


def in_units(text: str, units: Sequence[str], joints: Sequence[int] = ()) -> str:
    """A text about a robot whose joints' torques are in `units`, sentence by sentence in those of the joints it names.

    joints: numbers from 1 that are spoken of where a sentence names none; without any it is all joints. What is said of
    both kinds together keeps its Nm, and says so.
    """
    if "N" not in units:
        return text
    parts = _SENTENCE_END.split(text)
    return " ".join(_sentence(part, units, joints) for part in parts)


def _sentence(text: str, units: Sequence[str], joints: Sequence[int]) -> str:
    named = [
        joint
        for match in _JOINTS.finditer(text)
        for joint in range(int(match["first"]), int(match["last"] or match["first"]) + 1)
    ]
    kinds = {units[joint - 1] for joint in named or joints if 0 < joint <= len(units)} or set(units)
    if kinds == {"N"}:
        return for_prismatic(text)
    return re.sub(r"\b([mk]?)Nm(?=$| RMS\b)", r"\1Nm (\1N of prismatic joints)", text) if len(kinds) > 1 else text
