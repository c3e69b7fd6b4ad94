"""Counts in sentences ("1 period is", "2 periods are"), and what others wrote, fit to be repeated."""

from __future__ import annotations


def counted(count: int, noun: str, *, verb: bool = False) -> str:
    """The number with its noun, whose plural takes an s; verb: with "is" or "are" behind it."""
    return f"{count} {noun}{'s' * (count != 1)}" + (" is" if count == 1 else " are") * verb


def printable(text: str, longest: int = 120) -> str:
    """A text that a sentence may repeat, whatever was sent: its first letters, those that cannot be printed as "?"."""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:longest])
