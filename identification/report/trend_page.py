"""The page of a series of recordings: friction of every joint by date, and by hours and temperature where known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from identification.audit.trend import ODDS_SAID, JointTrend, Trend
from identification.report.document import Block, Document, Figure, Line, Panel, Paragraph, Section, Style, Table
from identification.report.numbers import rounded, with_sigma
from identification.report.page import render
from identification.report.series_notes import notes_on_temperature
from identification.report.units import in_units_of_joints
from identification.whole_file import write_whole

_UNITS = (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0))
_LEAST_SPAN = 2.0
"""Of a unit of time, that a series lasts to be drawn in it."""


def trend_order(trend: Trend) -> str:
    """By what the recordings of a series are ordered: dates that are all one order nothing."""
    if trend.dates is not None and trend.dates[0] < trend.dates[-1]:
        return "by date"
    return "as given" if trend.hours is None or trend.dates is not None else "by hours of operation"


def trend_document(trend: Trend, robot: str, notes: Sequence[str] = ()) -> Document:
    """The trend as value objects: what changed in words, friction by date, hours, temperature, and as a table.

    notes: on the order of the recordings, before all else.
    """
    order = trend_order(trend)
    if trend.dates is None or order != "by date":
        place, label = np.arange(1.0, len(trend.names) + 1.0), f"recording, {order}"
    else:
        place = np.array([(date - trend.dates[0]).total_seconds() for date in trend.dates])
        unit, length = next((each for each in _UNITS if place[-1] >= _LEAST_SPAN * each[1]), _UNITS[-1])
        place, label = place / length, f"{unit} since {trend.dates[0]:%Y-%m-%d %H:%M}"
    keys: tuple[tuple[Style, str], ...] = (("measured", "friction of one recording ± one deviation"),)
    blocks: list[Block] = [Paragraph(sentence) for sentence in (*notes, *trend.sentences, *notes_on_temperature(trend))]
    by_date = tuple(_panel(item, place, label) for item in trend.joints)
    blocks.append(Figure("Friction of each recording", by_date, keys))
    if trend.hours is not None:
        worked = tuple(_panel(item, np.array(trend.hours), "hours of operation") for item in trend.joints)
        blocks.append(Figure("Friction by hours of operation", worked, keys))
    warm = [item for item in trend.joints if np.isfinite(item.temperature).all()]
    if warm:
        panels = tuple(_panel(item, item.temperature, "temperature (°C)") for item in warm)
        blocks.append(Figure("Friction by temperature", panels, keys))
    dated = trend.dates or ()
    head = ("recording", *(("date (UTC)",) if dated else ()), *(f"joint {item.joint}" for item in trend.joints))
    rows = tuple(
        (
            name,
            *(f"{date:%Y-%m-%d %H:%M}" for date in dated[row : row + 1]),
            *(" ± ".join(with_sigma(item.friction[row], item.std[row])) for item in trend.joints),
        )
        for row, name in enumerate(trend.names)
    )
    blocks.append(Table("Friction at each joint's usual speed ± one deviation of the fit, Nm", head, rows))
    changed = [item for item in trend.joints if item.change.odds >= ODDS_SAID]
    joints = ", ".join(str(item.joint) for item in changed)
    unsure = any(item.change.odds > 1.0 for item in trend.joints)
    none = f"No joint's friction changed at once{' for sure' if unsure else ''}."
    verdict = f"Friction changed at once on joint {joints}." if changed else none
    drifting = [item for item in trend.joints if item.change.drift_odds >= ODDS_SAID]
    if drifting:
        verdict += f" It drifts on joint {', '.join(str(item.joint) for item in drifting)}."
    document = Document(
        title=f"{len(trend.names)} recordings of {robot}",
        verdict=verdict,
        sections=(Section("trend", "Friction over the series", tuple(blocks)),),
        tone="attention" if changed or drifting else "good",
    )
    return in_units_of_joints(document, trend.units)


def _panel(item: JointTrend, place: np.ndarray, label: str) -> Panel:
    low, high = rounded(float(item.friction.min()), 3), rounded(float(item.friction.max()), 3)
    return Panel(
        f"Joint {item.joint}",
        label,
        f"friction at {item.speed:.2g} rad/s (Nm)",
        (Line("measured", place, item.friction, item.std, "dots"),),
        f"friction of joint {item.joint} between {low} and {high} Nm over {len(place)} recordings",
    )


def write_trend(path: Path, trend: Trend, robot: str, notes: Sequence[str] = ()) -> None:
    """One self-contained HTML file. Raises OSError where it cannot be written."""
    write_whole(path, render(trend_document(trend, robot, notes)))
