"""Claims about rows of an even clock whose stamps tremble, as those of most loggers of another computer.

Truth: the times at which the motion here was sampled, in closed form.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import identification as ident
from identification.recordings import read_recording
from identification.recordings.row_clock import row_clock

EMPS = Path(__file__).parents[2] / "fixtures" / "recordings" / "emps.urdf"
CYCLE_S = 0.004


def _motion(time: np.ndarray) -> np.ndarray:
    waves = [0.6 * np.sin(2.1 * time) + 0.2 * np.sin(5.3 * time), 0.4 * np.cos(1.7 * time) + 0.3 * np.sin(3.9 * time)]
    return np.column_stack(waves)


def _late(true: np.ndarray, random: np.random.Generator, tremble: float) -> np.ndarray:
    """Stamps of arrival: never early, some held up so long that others arrive with them."""
    stamps = true + np.abs(random.normal(scale=tremble * CYCLE_S, size=true.size))
    stamps[:: random.integers(60, 140)] += 2.5 * CYCLE_S
    return np.maximum.accumulate(stamps) + 1e-9 * np.arange(true.size)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 0.25), st.floats(0.0, 0.03), st.floats(0.0, 0.05))
def test_the_times_are_those_of_the_clock(seed: int, tremble: float, lost: float, again: float) -> None:
    """Rows may be lost, and written once more before the next one comes."""
    random = np.random.default_rng(seed)
    cycle = np.flatnonzero(random.random(5000) >= lost)
    stale = np.concatenate([[False], random.random(cycle.size - 1) < again])
    held = np.where(stale, np.concatenate([[0], cycle[:-1]]), cycle)
    stale &= held == np.concatenate([[-1], held[:-1]])
    position = _motion(CYCLE_S * held) + random.normal(scale=1e-6, size=(held.size, 2))
    found = row_clock(_late(CYCLE_S * cycle, random, tremble), position)
    assert found is not None
    assert found.period_s == pytest.approx(CYCLE_S, rel=1e-3)
    cycles = np.rint((found.time - found.time[0]) / found.period_s).astype(int)
    way = np.abs(np.diff(position, axis=0)).max(axis=1)
    moving = way > 0.1 * way.mean()
    # Beside a moment in which the joints stand a row may be taken for the one before: it is nearly at the same place.
    assert (np.diff(cycles) != np.diff(held))[moving].mean() < 0.002
    assert np.abs(cycles - cycles[0] - (held - held[0])).max() <= 2
    assert (found.again != stale).mean() < 0.003


@pytest.mark.parametrize(
    ("stamps", "grain"),
    [("even", 0.0), ("lost", 0.0), ("sampled when stamped", 0.0), ("trembling", 3e-2), ("at rest", 0.0)],
)
def test_stamps_that_are_right_or_that_the_positions_cannot_judge_stay(stamps: str, grain: float) -> None:
    random = np.random.default_rng(5)
    time = CYCLE_S * np.flatnonzero(random.random(4000) >= (0.02 if stamps == "lost" else 0.0))
    trembling = time + 0.2 * CYCLE_S * random.uniform(-1.0, 1.0, time.size)
    sampled = trembling if stamps == "sampled when stamped" else time
    position = _motion(0.0 * sampled if stamps == "at rest" else sampled) + random.normal(
        scale=1e-6, size=(time.size, 2)
    )
    if grain:
        position = grain * np.round(position / grain)  # a coarse encoder: neighbours foretell no better by any time
    assert row_clock(time if stamps in ("even", "lost") else trembling, position) is None


def test_late_stamps_do_not_spoil_a_fit(tmp_path: Path) -> None:
    """Mass, viscous and Coulomb friction were far off, with a torque that came late; exit code 0."""
    random = np.random.default_rng(7)
    true = np.arange(10_000) * CYCLE_S
    turns = np.array([[0.9], [2.3], [4.1], [6.2]]) * true + np.array([[0.0], [1.0], [2.5], [4.0]])
    rates, sizes = np.array([0.9, 2.3, 4.1, 6.2]), np.array([0.1, 0.05, 0.03, 0.02])
    position, velocity = sizes @ np.sin(turns), (sizes * rates) @ np.cos(turns)
    acceleration = -(sizes * rates**2) @ np.sin(turns)
    force = 95.0 * acceleration + 200.0 * velocity + 20.0 * np.sign(velocity) + random.normal(scale=0.3, size=true.size)
    file = tmp_path / "measured.npz"
    np.savez(file, t=_late(true, random, 0.1), q=position[:, None], tau=force[:, None], robot=str(EMPS))
    recording = read_recording(file)
    assert recording.report.of_kind("trembling_stamps")
    assert recording.sampling_period_s == pytest.approx(CYCLE_S, rel=1e-3)
    fit = ident.fit(recording).result
    found = dict(zip(fit.names, zip(fit.values, fit.std, strict=True), strict=True))
    for name, truth in (("M_1", 95.0), ("FV_1", 200.0), ("FS_1", 20.0)):
        value, std = found[name]
        assert abs(value - truth) < 4.0 * std
        assert std < 0.01 * truth
    assert fit.rms.rows[0].rms_nm[0] < 0.3


def test_rows_that_arrive_together_are_left_out(tmp_path: Path) -> None:
    """Of an arm that stands nobody can say when they were measured: a speed between them is none."""
    time = np.arange(1000) * CYCLE_S
    time[100::50] = time[99:-1:50] + 1e-6
    position = np.full((1000, 1), 0.3) + np.random.default_rng(2).normal(scale=1e-5, size=(1000, 1))
    np.savez(tmp_path / "a.npz", t=time, q=position, tau=100.0 * position)
    recording = read_recording(tmp_path / "a.npz")
    (finding,) = recording.report.of_kind("crowded_rows")
    assert "right behind another" in finding.sentence
    assert recording.samples == 982
