"""Claims about rows that slide along the period, as those of every logger that does not count the robot's own cycles.

Truth: the motion and the friction, in closed form, at each row's own time.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import identification as ident
from identification.recordings import read_recording
from identification.signals.finer_grid import FinerGrid, slides
from identification.signals.periods import average_periods, period_table

PERIOD_S, PERIODS = 4.0, 8
MASS, VISCOUS, COULOMB = 95.0, 200.0, 20.0
EMPS = Path(__file__).parents[2] / "fixtures" / "recordings" / "emps.urdf"


def _motion(time: np.ndarray) -> np.ndarray:
    """Position, velocity and acceleration (3, N)."""
    turn = 2.0j * np.pi / PERIOD_S
    lines = {1: 0.02 - 0.1j, 2: -0.05 - 0.03j, 3: 0.03 + 0.02j, 5: 0.015 - 0.01j}
    return np.array(
        [
            np.real(sum(size * (k * turn) ** order * np.exp(k * turn * time) for k, size in lines.items()))
            for order in range(3)
        ]
    )


def _record(folder: Path, rate_hz: float, *, noise: float = 0.1, lost: slice = slice(0)) -> Path:
    time = np.arange(round(PERIODS * PERIOD_S * rate_hz)) / rate_hz
    position, velocity, acceleration = _motion(time)
    force = MASS * acceleration + VISCOUS * velocity + COULOMB * np.sign(velocity)
    force += np.random.default_rng(3).normal(scale=noise, size=time.size)
    kept = np.delete(np.arange(time.size), np.r_[lost])
    file = folder / "measured.npz"
    np.savez(file, t=time[kept], q=position[kept, None], tau=force[kept, None], period_s=PERIOD_S, robot=str(EMPS))
    return file


@pytest.mark.parametrize(
    ("rate_hz", "lost"), [(250.0, slice(0)), (249.87, slice(0)), (125.02, slice(0)), (500.11, slice(4000, 4030))]
)
def test_sharp_friction_is_no_gradual_one_and_no_mismatch_where_rows_slide(
    tmp_path: Path, rate_hz: float, lost: slice
) -> None:
    """A mean over periods of such rows holds no sample's own step: the model on one grid said there was more."""
    fit = ident.fit(_record(tmp_path, rate_hz, lost=lost)).result
    found = {name: (value, std) for name, value, std in zip(fit.names, fit.values, fit.std, strict=True)}
    for name, truth in (("FV_1", VISCOUS), ("FS_1", COULOMB)):
        value, std = found[name]
        assert abs(value - truth) < 4.0 * std
        assert std < 0.01 * truth
    assert not fit.misfit.detected.any()
    assert not any("turns over between" in note for note in fit.notes)


@pytest.mark.parametrize(
    ("rate_hz", "finer", "tolerance"), [(250.0, 1, 1e-12), (250.005, 1, 3e-7), (250.06, 16, 1e-9), (999.9, 4, 1e-9)]
)
def test_rows_are_read_at_the_moments_of_one_grid(tmp_path: Path, rate_hz: float, finer: int, tolerance: float) -> None:
    recording = read_recording(_record(tmp_path, rate_hz, noise=0.0))
    assert slides(recording) == (finer > 1)
    average = average_periods(period_table(recording))
    assert average.finer.factor == finer
    time = average.sampling_period_s * np.arange(len(average.position))
    # Of all stamps together: the grid begins up to a sample before or behind the first one.
    ahead = np.angle(np.fft.fft(average.position[:, 0])[1] / np.fft.fft(_motion(time)[0])[1]) * PERIOD_S / (2.0 * np.pi)
    assert abs(ahead) < 1.0 / rate_hz
    assert np.abs(average.position[:, 0] - _motion(time + ahead)[0]).max() < tolerance


@given(st.integers(4, 40), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_a_finer_grid_holds_the_samples_and_gives_them_back(samples: int, factor: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    values, shares = random.normal(size=(samples, 2)), random.normal(size=factor // 2 + 1)
    finer = FinerGrid(factor, np.concatenate([[1.0], shares[1:]]).astype(np.complex128))
    fine = finer.refined(values)
    assert fine.shape == (factor * samples, 2)
    assert fine[::factor] == pytest.approx(values, abs=1e-12)
    assert finer.sampled(fine) == pytest.approx(values, abs=1e-12)


@pytest.mark.parametrize("offset", [0.0, 0.25, -0.5])
def test_lines_that_the_rows_cannot_show_come_back_as_the_rows_show_them(offset: float) -> None:
    """Truth: rows beside the grid hold the 17th line of 20 samples as the third, and are read on the grid as that."""
    time, there = np.arange(80) / 80.0, np.arange(20) / 20.0 + offset / 20.0
    kept = np.exp(2.0j * np.pi * offset * np.arange(3))
    fine = np.cos(2.0 * np.pi * 17.0 * time + 0.4)
    rows = np.cos(2.0 * np.pi * 17.0 * there + 0.4)
    on_the_grid = np.fft.irfft(np.fft.rfft(rows) * np.exp(-2.0j * np.pi * np.arange(11) * offset / 20.0), n=20)
    assert FinerGrid(4, kept).sampled(fine[:, None])[:, 0] == pytest.approx(on_the_grid, abs=1e-12)
