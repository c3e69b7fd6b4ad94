"""What the figures of residual and motion draw: held against the fit's own table, an injected torque and geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.recordings import Recording
from identification.report.document import Figure
from identification.report.motion_sections import excitation_section, residual_section
from identification.report.stretches import Stretch, stretches_of_fit
from identification.robots import RobotModel
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

FloatArray = npt.NDArray[np.float64]

RIPPLE_NM, RIPPLE_HZ, JOINT, PERIODS = 0.2, 6.4, 3, 4
QUICK = FitSettings(physical=False)


@pytest.fixture(scope="module")
def recording(iiwa14: RobotModel, table3: PhysicalParameters) -> Recording:
    """Four periods with 0.1 Nm of white noise, and a torque of 6.4 Hz on joint 4 that no base parameter has."""
    state = fourier_motion(7, period_s=10.0, samples=2000, seed=5)
    torque = inverse_dynamics(iiwa14, table3, *state)
    torque[:, JOINT] += RIPPLE_NM * np.sin(2.0 * np.pi * RIPPLE_HZ * np.arange(2000) * 0.005)
    rows = np.tile(torque, (PERIODS, 1))
    noise = np.random.default_rng(8).normal(scale=0.1, size=rows.shape)
    return recording_of(np.tile(state[0], (PERIODS, 1)), rows + noise, period_s=10.0, periods=PERIODS)


@pytest.fixture(scope="module")
def fit(iiwa14: RobotModel, recording: Recording) -> FitResult:
    return fit_recordings([recording], iiwa14, QUICK)


@pytest.fixture(scope="module")
def stretch(fit: FitResult) -> Stretch:
    return stretches_of_fit(fit, 1)[0]


def test_residual_drawn_is_the_one_of_the_table(fit: FitResult, stretch: Stretch) -> None:
    # The table comes from triangular factors of the regressor, the figure from its torque over time.
    rms = np.sqrt(np.mean(stretch.residual**2, axis=0))
    assert rms == pytest.approx(fit.rms.row("fit, base").rms_nm, rel=1e-6)


def test_measured_torque_is_drawn_beside_the_modelled_one(recording: Recording, stretch: Stretch) -> None:
    mean = recording.torque.reshape(PERIODS, 2000, 7).mean(axis=0)
    assert stretch.measured == pytest.approx(mean, abs=1e-9)
    section = residual_section([stretch], "the base parameters")
    assert section is not None
    figure = next(block for block in section.blocks if isinstance(block, Figure))
    assert figure.legend == (("measured", "measured"), ("fitted", "modelled"))
    measured, modelled = figure.panels[JOINT].lines
    assert measured.y - modelled.y == pytest.approx(stretch.residual[:, JOINT], abs=1e-12)


def test_spectrum_shows_a_missing_torque_at_its_frequency_and_size(stretch: Stretch) -> None:
    line = int(stretch.spectrum[:, JOINT].argmax())
    assert stretch.frequency[line] == pytest.approx(RIPPLE_HZ)
    assert stretch.spectrum[line, JOINT] == pytest.approx(RIPPLE_NM / np.sqrt(2.0), rel=0.05)


def test_noise_of_the_spectrum_is_that_of_the_mean_period(stretch: Stretch) -> None:
    # White noise: variance 0.1² / periods spread evenly over 1000 lines of 2000 samples.
    expected = 0.1 / np.sqrt(PERIODS) * np.sqrt(2.0 / 2000)
    assert stretch.noise is not None
    assert np.median(stretch.noise[1:]) == pytest.approx(expected, rel=0.15)
    quiet = np.delete(stretch.spectrum[1:], JOINT, axis=1)
    assert np.sqrt(np.mean(quiet**2)) == pytest.approx(expected, rel=0.15)


def test_a_turned_sign_and_a_corrected_delay_are_drawn_as_they_were_fitted(
    iiwa14: RobotModel, recording: Recording, stretch: Stretch
) -> None:
    turned = replace(recording, torque=-recording.torque)
    settings = replace(QUICK, flip_torque=True, delay_correction="common")
    drawn = stretches_of_fit(fit_recordings([turned], iiwa14, settings), 1)[0]
    rms = np.sqrt(np.mean(drawn.residual**2, axis=0))
    assert rms == pytest.approx(np.sqrt(np.mean(stretch.residual**2, axis=0)), rel=0.05)


def test_without_periods_the_residual_keeps_its_gaps_and_no_noise_is_claimed(
    iiwa14: RobotModel, recording: Recording
) -> None:
    keep = (recording.time < 15.0) | (recording.time > 17.0)
    plain = replace(recording.rows(keep), period_index=None, sample_in_period=None, period_s=None)
    drawn = stretches_of_fit(fit_recordings([plain], iiwa14, replace(QUICK, low_pass_hz=10.0)), 1)[0]
    assert drawn.noise is None
    inside = (drawn.residual_time > 15.0) & (drawn.residual_time < 17.0)
    assert not np.isfinite(drawn.residual[inside]).any()
    assert np.isnan(drawn.residual_time).sum() == 1
    line = int(drawn.spectrum[:, JOINT].argmax())
    assert drawn.frequency[line] == pytest.approx(RIPPLE_HZ, abs=0.3)
    section = residual_section([drawn], "no effect")
    assert section is not None
    assert all(
        "noise" not in [style for style, _ in block.legend] for block in section.blocks if isinstance(block, Figure)
    )


def test_path_of_the_upright_arm_is_a_point_at_its_height(iiwa14: RobotModel, stretch: Stretch) -> None:
    upright = replace(stretch, position=np.zeros_like(stretch.position))
    section = excitation_section([upright], iiwa14)
    assert section is not None
    path = next(block for block in section.blocks if isinstance(block, Figure) and len(block.panels) == 3)
    side = path.panels[1].lines[0]
    # KUKA's drawing of the iiwa 14: 0.42 + 0.4 m from the shoulder, where the paper puts the base frame, to the wrist.
    assert np.allclose(side.x, 0.0, atol=1e-12)
    assert np.allclose(side.y, 0.82, atol=1e-9)
