"""Panels: small, valid, named apart, and with every extreme of a long line in them."""

from __future__ import annotations

import contextlib
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from identification.report.document import Line, Panel
from identification.report.panels import MOST_POINTS, decimate, draw_panel


def panel(lines: tuple[Line, ...], title: str = "Joint 1", *, logarithmic: bool = False) -> Panel:
    return Panel(title, "time (s)", "torque (Nm)", lines, "a line", None if logarithmic else 0.1, logarithmic)


@given(st.integers(0, 5000), st.integers(0, 2**32 - 1))
def test_thinned_line_is_short_in_order_and_keeps_both_extremes(count: int, seed: int) -> None:
    y = np.random.default_rng(seed).normal(size=count)
    x = np.arange(count, dtype=np.float64)
    few_x, few_y = decimate(x, y)
    assert len(few_x) <= MOST_POINTS
    assert (np.diff(few_x) > 0).all()
    assert set(few_y) <= set(y)
    if count:
        assert (few_y.min(), few_y.max()) == (y.min(), y.max())


def test_a_gap_stays_a_gap_in_a_thinned_line() -> None:
    y = np.sin(np.linspace(0.0, 60.0, 20_000))
    y[8_000:12_000] = np.nan
    few_x, few_y = decimate(np.arange(20_000.0), y)
    inside = (few_x > 8_100) & (few_x < 11_900)
    assert inside.any()
    assert np.isnan(few_y[inside]).all()


def test_drawing_is_well_formed_names_no_address_and_takes_its_colours_from_the_page() -> None:
    x = np.linspace(0.0, 1.0, 50)
    line = Line("before", x, np.sin(9 * x), np.full(50, 0.1), "dots")
    svg = draw_panel(panel((line, Line("after", x, np.cos(9 * x)))), "panel-1")
    root = ElementTree.fromstring(svg)
    assert root.tag == "svg"
    assert root.get("viewBox")
    assert "http" not in svg
    assert "var(--after)" in svg
    assert "var(--before)" in svg
    assert set(re.findall(r"#[0-9a-fA-F]{6}\b", svg)) <= {"#ffffff"}


def test_two_drawings_of_the_same_panel_share_no_name_and_refer_to_nothing_outside() -> None:
    x = np.linspace(0.0, 1.0, 50)
    drawings = [draw_panel(panel((Line("after", x, x),)), name) for name in ("panel-1", "panel-2")]
    names = [re.findall(r'\bid="([^"]+)"', svg) for svg in drawings]
    assert not set(names[0]) & set(names[1])
    for svg, own in zip(drawings, names, strict=True):
        assert len(own) == len(set(own))
        assert set(re.findall(r'url\(#([^)]+)\)|href="#([^"]+)"', svg)) <= {(n, "") for n in own} | {
            ("", n) for n in own
        }


def test_text_of_a_file_is_drawn_as_it_stands() -> None:
    title = r"<b>$\frac{1}{</b> & 'x' \u{1}"
    svg = draw_panel(panel((Line("after", np.arange(3.0), np.arange(3.0)),), title), "panel-1")
    texts = ["".join(item.itertext()) for item in ElementTree.fromstring(svg).iter("text")]
    assert title in texts


def test_logarithmic_ticks_are_plain_numbers() -> None:
    frequency = np.geomspace(0.1, 60.0, 40)
    svg = draw_panel(panel((Line("after", frequency, 1e-3 / frequency),), logarithmic=True), "panel-1")
    texts = {"".join(item.itertext()) for item in ElementTree.fromstring(svg).iter("text")}
    assert {"0.1", "1", "10", "0.001", "0.0001"} <= texts


def numbers_on_axes(svg: str) -> tuple[list[float], list[float]]:
    """Numbers along x and along y: the writer centres the former and ends the latter at the axis."""
    texts: dict[str, list[float]] = {"middle": [], "end": [], "start": []}
    for item in ElementTree.fromstring(svg).iter("text"):
        anchor = re.search(r"text-anchor: (\w+)", item.get("style") or "")
        with contextlib.suppress(ValueError):
            texts[anchor.group(1) if anchor else "start"].append(float("".join(item.itertext()).replace("−", "-")))
    return texts["middle"], texts["end"]


@settings(max_examples=30, deadline=None)
@example(0.0, 1.0, 0.0, 1.192092896e-07, 0.0, True)
@example(0.0, 1.0, 0.0, 1e-15, 0.0, True)
@given(
    st.floats(-5, 4), st.floats(0.01, 6), st.floats(-6, 4), st.floats(0.0, 6), st.floats(-1e4, 1e4), st.booleans()
)  # fmt: skip
def test_every_axis_has_three_numbers(
    start: float, decades: float, low: float, span: float, offset: float, logarithmic: bool
) -> None:
    x = np.geomspace(10.0**start, 10.0 ** (start + decades), 30)
    y = np.geomspace(10.0**low, 10.0 ** (low + span), 30)
    if not logarithmic:
        y = y + offset
    svg = draw_panel(panel((Line("after", x, y),), logarithmic=logarithmic), "panel-1")
    for numbers in numbers_on_axes(svg):
        assert len(set(numbers)) >= 3


def test_a_line_without_any_number_draws_an_empty_panel() -> None:
    nothing = np.full(10, np.nan)
    for logarithmic in (False, True):
        draw_panel(panel((Line("after", np.arange(10.0), nothing),), logarithmic=logarithmic), "panel-1")


def test_a_probability_is_drawn_from_0_to_1_over_whole_numbers() -> None:
    """A chance of 3 % that does not change must not fill the panel, and nobody made 2.4 recordings."""
    line = Line("fitted", np.array([2.0, 3.0]), np.array([0.033, 0.033]))
    svg = draw_panel(replace(panel((line,)), chances=True), "panel-1")
    texts = [text.split("<")[0] for text in svg.split(">") if text.split("<")[0].replace(".", "").isdigit()]
    assert sorted(map(float, texts)) == [0.0, 0.5, 1.0, 2.0, 3.0]
