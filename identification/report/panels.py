"""One small plot as SVG text for a page: readable in print, in dark and light, and on a phone.

Here: the drawing, with matplotlib's SVG writer, and what makes its output fit into an HTML page: colours that the
page's style sheet decides, no addresses, no names that two plots share. Not here: what is drawn.
"""

from __future__ import annotations

import io
import re
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from identification.arrays import FloatArray
from identification.report.document import Line, Panel

MOST_POINTS = 600
"""Points of one line: a panel is some 400 pixels wide."""

FEWEST_NUMBERS, MOST_NUMBERS = 3, 6
"""On an axis: two do not tell whether it is linear or logarithmic."""
ALIKE = 1e-9
"""Share of a number by which two of them may differ by rounding."""

# Colours that stand for a variable of the page's style sheet; the values here are never seen.
_INK, _FAINT = "#010101", "#020202"
_COLOURS = {"measured": "#030303", "before": "#040404", "after": "#050505", "noise": "#060606", "fitted": "#070707"}
_LINES: dict[str, dict[str, Any]] = {
    "measured": {"linewidth": 0.9},
    "before": {"linewidth": 1.0, "linestyle": (0, (4, 1.5))},
    "after": {"linewidth": 1.0},
    "noise": {"linewidth": 1.2, "linestyle": (0, (1, 1.2))},
    "fitted": {"linewidth": 1.6, "linestyle": (0, (6, 1.5, 1, 1.5))},
}
_VARIABLES = {_INK: "currentColor", _FAINT: "var(--faint)"} | {
    colour: f"var(--{style})" for style, colour in _COLOURS.items()
}
_SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",
    "text.parse_math": False,
    "font.size": 8.0,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "axes.unicode_minus": True,
    "text.color": _INK,
    "axes.labelcolor": _INK,
    "axes.edgecolor": _FAINT,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "grid.color": _FAINT,
    "grid.linewidth": 0.4,
    "axes.linewidth": 0.6,
    "path.simplify": True,
}


Sheets = dict[tuple[bool, bool], Axes]
"""Axes to draw on again, by what their scales are: most of the time goes into making axes and their ticks."""


def draw_panel(panel: Panel, name: str, sheets: Sheets | None = None) -> str:
    """The panel as an `<svg>` element without width and height; name: unique on the page.

    sheets: kept between the panels of a page; the drawing does not depend on them.
    """
    sheets = {} if sheets is None else sheets
    with matplotlib.rc_context({**_SETTINGS, "svg.hashsalt": name}):
        logarithmic = _is_logarithmic(panel)
        # Equal scales change the limits while they are drawn.
        axes = sheets.pop((panel.equal, logarithmic), None) or _new_axes(panel.equal)
        _draw(axes, panel)
        text = io.StringIO()
        axes.figure.canvas.print_figure(
            text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None}
        )
        if not panel.equal:
            for container in tuple(axes.containers):
                container.remove()
            for artist in (*axes.lines, *axes.collections):
                artist.remove()
            axes.relim()
            axes.set_prop_cycle(None)
            sheets[panel.equal, logarithmic] = axes
    return _for_page(text.getvalue())


def _new_axes(equal: bool) -> Axes:
    canvas = Canvas(figsize=(3.5, 3.0 if equal else 2.15))
    canvas.patch.set_visible(False)
    return canvas.add_axes((0.205, 0.15 if equal else 0.2, 0.765, 0.75 if equal else 0.67))


def _is_logarithmic(panel: Panel) -> bool:
    """Nothing above zero has no logarithm, and nothing to show either: such a panel stays empty."""
    shown = [line.y[line.y > 0.0] for line in panel.lines if (line.y > 0.0).any()]
    if not panel.logarithmic or not shown:
        return False
    low, high = min(float(y.min()) for y in shown), max(float(y.max()) for y in shown)
    # The labels of a logarithmic axis that spans next to nothing read alike.
    return high == low or high / low > 1.001


def decimate(x: FloatArray, y: FloatArray, most: int = MOST_POINTS) -> tuple[FloatArray, FloatArray]:
    """No more than `most` points of a line, with the lowest and the highest of every stretch among them."""
    if len(y) <= most:
        return x, y
    edges = np.linspace(0, len(y), most // 2 + 1).astype(int)
    # Every stretch as a row, filled up with its first point.
    places = edges[:-1, None] + np.arange(np.diff(edges).max())
    places = np.where(places < edges[1:, None], places, edges[:-1, None])
    part, rows = y[places], np.arange(len(places))
    lowest = places[rows, np.where(np.isnan(part), np.inf, part).argmin(axis=1)]
    highest = places[rows, np.where(np.isnan(part), -np.inf, part).argmax(axis=1)]
    chosen = np.unique(np.concatenate([lowest, highest]))
    return x[chosen], y[chosen]


def _draw(axes: Axes, panel: Panel) -> None:
    axes.patch.set_visible(False)
    if panel.floor is not None and np.isfinite(panel.floor):
        for level in (-panel.floor, panel.floor):
            axes.axhline(level, color=_COLOURS["noise"], zorder=3, **_LINES["noise"])
    for line in panel.lines:
        _draw_line(axes, line)
    # Its place given, or all ticks are laid out twice; minor ticks alone would be three quarters of the drawing.
    axes.set_title(panel.title, loc="left", fontsize=8.5, fontweight="bold", pad=4, y=1.0)
    axes.set_xlabel(panel.x_label, labelpad=2)
    axes.set_ylabel(panel.y_label, labelpad=2)
    axes.grid(visible=True, alpha=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
    else:
        axes.margins(x=0.03 if any(line.marks == "dots" for line in panel.lines) else 0.0)
    if _is_logarithmic(panel):
        axes.set_xscale("log")
        axes.set_yscale("log")
        for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            axis.set_major_locator(_logarithmic_ticks(*limits))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.set_minor_locator(NullLocator())
    elif panel.chances:
        axes.set_ylim(-0.05, 1.05)
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True, min_n_ticks=1))
        axes.yaxis.set_major_locator(FixedLocator([0.0, 0.5, 1.0]))
    else:
        low, high = axes.get_ylim()
        if high - low < ALIKE * max(abs(low), abs(high)):
            # Numbers that differ by rounding alone would all read alike.
            axes.set_ylim(*sorted((0.475 * (low + high), 0.525 * (low + high))))
        for axis, most in ((axes.xaxis, 6), (axes.yaxis, 5)):
            axis.set_major_locator(MaxNLocator(most, steps=[1, 2, 2.5, 5, 10], min_n_ticks=FEWEST_NUMBERS))


def _logarithmic_ticks(low: float, high: float) -> FixedLocator:
    """The fewest of 1, 1-3, 1-2-5 or nine numbers a decade that give three, else even steps; of many, every other."""
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    inside = np.zeros(0)
    candidates = [np.outer(10.0**decades, digits).ravel() for digits in ((1,), (1, 3), (1, 2, 5), range(1, 10))]
    candidates.append(np.asarray(MaxNLocator(MOST_NUMBERS, min_n_ticks=FEWEST_NUMBERS).tick_values(low, high)))
    for ticks in candidates:
        inside = ticks[(ticks >= low * (1.0 - 1e-9)) & (ticks <= high * (1.0 + 1e-9))]
        if inside.size >= FEWEST_NUMBERS:
            break
    return FixedLocator(np.sort(inside)[:: -(-inside.size // MOST_NUMBERS)].tolist())


def _draw_line(axes: Axes, line: Line) -> None:
    colour = _COLOURS[line.style]
    if line.marks == "star":
        axes.plot(line.x, line.y, "*", color=colour, markersize=9)
    elif line.marks == "dots":
        axes.errorbar(
            line.x, line.y, yerr=line.band, color=colour, ecolor=colour, elinewidth=0.6, linestyle="none",
            marker="o" if line.style == "after" else "s", markersize=2.4,
            markerfacecolor=colour if line.style == "after" else "none", markeredgewidth=0.7,
        )  # fmt: skip
    else:
        if line.band is not None:
            axes.fill_between(line.x, line.y - line.band, line.y + line.band, color=colour, alpha=0.25, linewidth=0.0)
        x, y = decimate(line.x, line.y)
        axes.plot(x, y, color=colour, solid_joinstyle="round", **_LINES[line.style])


def _for_page(svg: str) -> str:
    """Only the element itself, sized by the page, without addresses and names that nothing refers to."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<(metadata|style)\b.*?</\1>", "", svg, flags=re.DOTALL)
    opening, rest = svg.split(">", 1)
    box = re.search(r'viewBox="[^"]*"', opening)
    svg = f'<svg {box.group() if box else ""} aria-hidden="true" focusable="false">{rest}'.replace("xlink:href", "href")
    referred = set(re.findall(r"#([A-Za-z][\w-]*)", svg))
    svg = re.sub(r' id="([^"]*)"', lambda match: match.group() if match.group(1) in referred else "", svg)
    svg = re.sub(r"#0[1-7]0[1-7]0[1-7]", lambda match: _VARIABLES.get(match.group(), match.group()), svg)
    return re.sub(r"\n\s*", "\n", svg).strip()
