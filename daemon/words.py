"""Counts in sentences: "1 period is", "2 periods are"."""

from __future__ import annotations


def counted(count: int, noun: str, *, verb: bool = False) -> str:
    """The number with its noun, whose plural takes an s; verb: with "is" or "are" behind it."""
    return f"{count} {noun}{'s' * (count != 1)}" + (" is" if count == 1 else " are") * verb
