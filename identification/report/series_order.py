"""What is said of the order of recordings that are compared, where their dates do not tell it or tell another."""

from __future__ import annotations

from collections.abc import Sequence

from identification.audit.trend import date_of, hours_of
from identification.recordings.independence import recording_names
from identification.recordings.recording import Recording

SHOWN = 4
"""Names in a sentence."""


def notes_on_the_first(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence where recordings are older than the first, with which each of them is compared; else none."""
    names, (first, *dates) = recording_names(recordings), map(date_of, recordings)
    older = [name for name, date in zip(names[1:], dates, strict=True) if first and date and date < first]
    return (f"{_named(older)}: made before {names[0]}. What is called 'before' is the later one.",) if older else ()


def notes_on_order(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Sentences on a series in the order in which it was given, which goes by dates, by hours of operation where one
    has no date, or as it was given; none where nobody could be misled.
    """
    names, dates = recording_names(recordings), [date_of(item) for item in recordings]
    undated = [name for name, date in zip(names, dates, strict=True) if date is None]
    known = [date for date in dates if date is not None]
    if undated and known:
        if all(hours_of(item) is not None for item in recordings):
            return (f"{_named(undated)}: no date, so the series stands by hours of operation.",)
        contradicted = "; the dates of the others are in another order. Give them in the order of time"
        other = contradicted if known != sorted(known) else ""
        return (f"{_named(undated)}: no date, so the series stands as it was given{other}.",)
    alike = [name for name, date in zip(names, dates, strict=True) if date and known.count(date) > 1]
    return (f"{_named(alike)}: not alone with their date. Those of one date stand as given.",) if alike else ()


def _named(names: Sequence[str]) -> str:
    more = len(names) - SHOWN
    return ", ".join(names[:SHOWN]) + (f" and {more} more" if more > 0 else "")
