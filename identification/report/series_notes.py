"""What is said beside a series: of its order, where dates do not tell it or tell another, and of a joint's warmth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.audit.trend import ODDS_SAID, JointTrend, Trend, date_of, hours_of
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


def notes_on_temperature(trend: Trend) -> tuple[str, ...]:
    """A sentence for each joint whose friction changed at once where its temperature did, too.

    It did where the two sides are farther apart than the temperatures of either are among themselves.
    """
    return tuple(filter(None, (_warmth(item, trend.names) for item in trend.joints)))


def _warmth(item: JointTrend, names: Sequence[str]) -> str:
    at = item.change.at
    sides = [side[np.isfinite(side)] for side in (item.temperature[:at], item.temperature[at:])]
    if item.change.odds < ODDS_SAID or not all(side.size for side in sides):
        return ""
    before, after = (float(side.mean()) for side in sides)
    if abs(after - before) <= max(float(np.ptp(side)) for side in sides):
        return ""
    return (
        f"Joint {item.joint} has {before:.3g} °C before {names[at]} and {after:.3g} °C from there on: friction "
        "goes with temperature, and this may be no change of the arm."
    )


def _named(names: Sequence[str]) -> str:
    more = len(names) - SHOWN
    return ", ".join(names[:SHOWN]) + (f" and {more} more" if more > 0 else "")
