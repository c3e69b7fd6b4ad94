"""Stops along the path, held against scipy's spline, against the true motion and against differences taken here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from safety.limits import IIWA14_R820, JointLimits
from safety.path_stop import PathStops, spline_curvature
from tests.safety.motions import random_fourier_table

PERIOD = 0.001


def gentle_limits() -> JointLimits:
    """What random tables are made for here: a stop needs some room beyond the motion itself."""
    return replace(IIWA14_R820, velocity=0.7 * IIWA14_R820.velocity, acceleration=0.6 * IIWA14_R820.acceleration)


def positions_of(stops: PathStops, row: int, period: float = PERIOD) -> np.ndarray:
    stop = stops.plan(row)
    assert stop is not None
    return np.array([stop.position_at((k + 1) * period) for k in range(round(stop.duration_s / period) + 3)])


def test_the_spline_is_the_periodic_one() -> None:
    table = random_fourier_table(np.random.default_rng(1), IIWA14_R820)
    closed = CubicSpline(np.arange(len(table) + 1), np.vstack([table, table[:1]]), bc_type="periodic")
    assert spline_curvature(table) == pytest.approx(closed(np.arange(len(table)), 2), abs=1e-12)
    assert spline_curvature(table[::1000]).shape == (10, 7)


def test_every_position_of_a_stop_lies_on_the_curve_that_the_preflight_checked() -> None:
    """Nearest place on the curve, from a hundred times finer samples of the true Fourier series."""
    t = np.arange(200_000) * 1e-5
    harmonics = np.arange(1, 8)
    fine = 0.1 * np.sin(np.pi * np.outer(t, harmonics)) / harmonics**2 + 0.05 * np.cos(np.pi * t)[:, None]
    table = fine[::100]
    stops, tree = PathStops(table, PERIOD, 1, IIWA14_R820), KDTree(fine)
    spacing = np.linalg.norm(np.diff(fine, axis=0), axis=1).max()
    kept = 0
    for row in range(0, 2000, 100):
        if stops.plan(row) is not None:
            distance, _ = tree.query(positions_of(stops, row))
            assert distance.max() <= spacing
            kept += 1
    assert kept > 5


@pytest.mark.parametrize("seed", range(6))
def test_a_stop_goes_forward_along_the_path_and_stays_inside_every_limit(seed: int) -> None:
    generator = np.random.default_rng(seed)
    table = random_fourier_table(generator, gentle_limits())
    stops = PathStops(table, PERIOD, 1, IIWA14_R820)
    kept = 0
    for row in generator.integers(0, len(table), 60).tolist():
        if stops.plan(row) is None:
            continue
        kept += 1
        whole = np.vstack([table[np.arange(row - 3, row + 1) % len(table)], positions_of(stops, row)])
        for order, limit in ((1, IIWA14_R820.velocity), (2, IIWA14_R820.acceleration), (3, IIWA14_R820.jerk)):
            peak = np.abs(np.diff(whole, order, axis=0)).max(axis=0) / PERIOD**order
            assert np.all(peak <= limit * 1.02), (order, peak / limit)
        assert np.all(whole[-1] == whole[-3])
    assert kept > 30


@pytest.mark.parametrize("stride", [1, 2, 5])
def test_the_first_command_of_a_stop_is_hardly_behind_the_next_row_and_none_is_ahead(stride: int) -> None:
    """The path is walked at most as fast as in motion: after k commands a stop is at most k strides further."""
    line = np.linspace(0.0, 1.0, 4000)[:, None] * np.full(7, 1e-3)
    table = np.vstack([line, line[::-1]])
    stops = PathStops(table, PERIOD, stride, IIWA14_R820)
    stop = stops.plan(100)
    assert stop is not None
    positions = positions_of(stops, 100, PERIOD * stride)[:, 0]
    rows = (positions - table[100, 0]) / (line[1, 0] - line[0, 0])
    ticks = np.arange(1, len(rows) + 1)
    assert np.all(rows <= ticks * stride + 1e-6)
    assert rows[0] > 0.99 * stride
    assert np.all(np.diff(rows) >= -1e-6)
    assert rows[-1] == pytest.approx(stop.rows, abs=1e-6)


def test_the_end_of_the_table_is_followed_by_its_beginning() -> None:
    table = random_fourier_table(np.random.default_rng(3), gentle_limits())
    stops, shifted = (PathStops(np.roll(table, by, axis=0), PERIOD, 1, IIWA14_R820) for by in (0, 5000))
    last = len(table) - 1
    assert positions_of(stops, last) == pytest.approx(positions_of(shifted, last + 5000), abs=1e-12)


def test_there_is_none_where_the_path_leaves_no_room() -> None:
    """A sawtooth of accelerations at the limit: whatever slows the parameter adds to an acceleration at its limit."""
    table = random_fourier_table(np.random.default_rng(4), IIWA14_R820)
    speed = np.abs(np.diff(table[:, 0], append=table[0, 0])) / PERIOD
    tight = replace(IIWA14_R820, acceleration=0.02 * IIWA14_R820.acceleration)
    assert PathStops(table, PERIOD, 1, tight).plan(int(speed.argmax())) is None


def test_a_shorter_table_than_its_stop_is_walked_more_than_once() -> None:
    angle = 2 * np.pi * np.arange(100) / 100
    table = 1e-3 * np.sin(angle)[:, None] * np.ones(7)
    stops = PathStops(table, PERIOD, 1, IIWA14_R820)
    whole = positions_of(stops, 20)
    assert np.abs(whole).max() <= 1e-3 * 1.001
