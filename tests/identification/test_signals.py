"""Claims about averaging, derivatives and filters. Truth: closed forms, and SciPy on long unwrapped signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfilt, sosfiltfilt

from identification.errors import RecordingError
from identification.recordings import Recording
from identification.signals.aperiodic import process_aperiodic, sixth_order_difference, standstill, uniform_grid
from identification.signals.filter_ends import cutoff_hz
from identification.signals.gaps import median_over_periods
from identification.signals.outliers import clean_across_periods
from identification.signals.paper_chain import (
    process_as_in_paper,
    wrapped_central_difference,
    wrapped_zero_phase_filter,
)
from identification.signals.periodic import PeriodicSettings, differentiate_harmonics, process_periodic, to_lines
from identification.signals.periods import average_periods, period_table
from tests.identification.synthetic import coloured_noise, fourier_motion, recording_of

PERIOD_S, SAMPLES, JOINTS = 4.0, 800, 2


def _recording(periods: int = 6, *, noise: float = 0.0, correlation: float = 0.0, seed: int = 3) -> Recording:
    position, velocity, acceleration = fourier_motion(JOINTS, period_s=PERIOD_S, samples=SAMPLES, seed=seed)
    torque = np.tile(3.0 * acceleration + np.sign(velocity) + 0.5, (periods, 1))
    if noise:
        torque = torque + coloured_noise(torque.shape, deviation=noise, correlation=correlation, seed=seed)
    return recording_of(np.tile(position, (periods, 1)), torque, period_s=PERIOD_S, periods=periods)


def _without(recording: Recording, rows: np.ndarray) -> Recording:
    keep = np.ones(recording.samples, dtype=np.bool_)
    keep[rows] = False
    return recording.rows(keep)


def test_a_recordings_periods_are_laid_out_and_averaged_once() -> None:
    """Faults of the data, the fit and the evidence ask for them in turn; another recording has its own."""
    recording = _recording()
    assert period_table(recording) is period_table(recording)
    assert average_periods(period_table(recording)) is average_periods(period_table(recording))
    other = replace(recording, torque=-recording.torque)
    assert np.array_equal(period_table(other).torque, -period_table(recording).torque)


def test_mean_leaves_missing_samples_out_and_counts_them() -> None:
    recording = _recording(periods=4)
    missing = np.array([10, 11, SAMPLES + 10, 3 * SAMPLES + 700])
    average = average_periods(period_table(_without(recording, missing)))
    assert average.counts[10] == 2
    assert average.counts[11] == 3
    assert average.counts[700] == 3
    assert average.counts.sum() == 4 * SAMPLES - missing.size
    assert not average.filled.any()
    np.testing.assert_allclose(average.torque, recording.torque[:SAMPLES], atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.sets(st.integers(0, 3 * SAMPLES - 1), max_size=400))
def test_mean_of_equal_periods_is_the_period_whatever_is_missing(rows: set[int]) -> None:
    recording = _recording(periods=3)
    lost_everywhere = [
        sample for sample in {row % SAMPLES for row in rows} if {sample, sample + SAMPLES, sample + 2 * SAMPLES} <= rows
    ]
    missing = np.array(sorted(rows - set(lost_everywhere)), dtype=np.int64)
    average = average_periods(period_table(_without(recording, missing)))
    np.testing.assert_allclose(average.position, recording.position[:SAMPLES], atol=1e-12)
    assert average.counts.min() >= 1


def test_a_sample_missing_in_every_period_is_interpolated_and_said() -> None:
    recording = _recording(periods=3)
    average = average_periods(period_table(_without(recording, np.array([5, SAMPLES + 5, 2 * SAMPLES + 5]))))
    assert average.filled.sum() == 1
    assert average.filled[5]
    assert any("missing in every period" in note for note in average.notes)
    np.testing.assert_allclose(average.position[5], recording.position[5], atol=1e-4)


def test_a_long_hole_in_every_period_is_refused() -> None:
    recording = _recording(periods=2)
    hole = np.arange(100, 200)
    with pytest.raises(RecordingError, match="missing in every period"):
        average_periods(period_table(_without(recording, np.concatenate([hole, hole + SAMPLES]))))


def test_noise_from_period_differences_ignores_misfit_and_drift() -> None:
    """White noise of 0.3 Nm over a strong repeatable signal and a drift of 2 Nm: the estimate is 0.3 Nm."""
    recording = _recording(periods=20, noise=0.3)
    drift = np.linspace(0.0, 2.0, recording.samples)[:, None]
    average = average_periods(period_table(replace(recording, torque=recording.torque + drift)))
    np.testing.assert_allclose(average.torque_noise_nm, 0.3, rtol=0.05)
    assert average.torque_spectrum is not None
    np.testing.assert_allclose(np.sqrt(average.torque_spectrum[1:].mean(axis=0)), 0.3, rtol=0.05)


def test_noise_spectrum_follows_the_colour_of_the_noise() -> None:
    """First-order noise: power density σ²(1−a²)/|1 − a e^{−iω}|², the textbook formula."""
    correlation = 0.9
    average = average_periods(period_table(_recording(periods=40, noise=0.5, correlation=correlation)))
    assert average.torque_spectrum is not None
    line = np.arange(1, SAMPLES // 2)
    omega = 2.0 * np.pi * line / SAMPLES
    expected = 0.25 * (1.0 - correlation**2) / np.abs(1.0 - correlation * np.exp(-1j * omega)) ** 2
    measured = average.torque_spectrum[line].mean(axis=1)
    np.testing.assert_allclose(np.log(measured[10:] / expected[10:]), 0.0, atol=0.35)


def test_single_period_knows_no_noise() -> None:
    average = average_periods(period_table(_recording(periods=1)))
    assert average.torque_spectrum is None
    assert np.isnan(average.torque_noise_nm).all()


def test_start_transient_of_a_foreign_recording_is_left_out() -> None:
    recording = _recording(periods=6)
    position = recording.position + np.where(recording.period_index == 0, 0.05, 0.0)[:, None]
    position = position + np.random.default_rng(5).normal(scale=1e-4, size=position.shape)
    foreign = replace(recording, position=position, source=replace(recording.source, kind="npz"))
    table = period_table(foreign)
    assert table.periods.tolist() == [1, 2, 3, 4, 5]
    assert any("transient" in note for note in table.notes)


def test_a_period_that_is_not_one_is_refused() -> None:
    position, _, _ = fourier_motion(JOINTS, period_s=6.0 * PERIOD_S, samples=6 * SAMPLES, seed=3)
    recording = recording_of(position, position, period_s=PERIOD_S, periods=6)
    with pytest.raises(RecordingError, match="does not repeat") as caught:
        period_table(recording)
    assert caught.value.field == "period_s"


def test_stamps_off_the_grid_are_moved_onto_it() -> None:
    """Samples taken up to 40 % of a step late: the table holds the values at the grid's times."""
    generator = np.random.default_rng(8)
    step = PERIOD_S / SAMPLES
    late = generator.uniform(0.0, 0.4 * step, 3 * SAMPLES)
    w = 2.0 * np.pi / PERIOD_S
    time = np.arange(3 * SAMPLES) * step + late
    position = np.column_stack([np.sin(w * time), np.cos(2.0 * w * time)])
    recording = recording_of(position, position, period_s=PERIOD_S, periods=3)
    recording = replace(recording, time=time, source=replace(recording.source, kind="npz"))
    average = average_periods(period_table(recording))
    shift = np.median(late)
    grid = np.arange(SAMPLES) * step + shift
    exact = np.column_stack([np.sin(w * grid), np.cos(2.0 * w * grid)])
    assert np.abs(average.position - exact).max() < 0.1 * np.abs(position[:SAMPLES] - exact).max()


def test_derivatives_from_harmonics_are_exact() -> None:
    position, velocity, acceleration = fourier_motion(3, period_s=PERIOD_S, samples=SAMPLES, seed=4)
    smooth, first, second = differentiate_harmonics(position, PERIOD_S, 5)
    np.testing.assert_allclose(smooth, position, atol=1e-12)
    np.testing.assert_allclose(first, velocity, atol=1e-11)
    np.testing.assert_allclose(second, acceleration, atol=1e-10)


def test_harmonics_follow_the_motion_not_the_noise() -> None:
    recording = _recording(periods=8)
    noisy = recording.position + np.random.default_rng(2).normal(scale=2e-5, size=recording.position.shape)
    for position in (recording.position, noisy):
        facts = process_periodic(replace(recording, position=position)).facts
        assert facts["motion_harmonics"] == 5


def test_lines_keep_the_squares_and_are_linear() -> None:
    generator = np.random.default_rng(1)
    first, second = generator.normal(size=(2, 301, 4))
    lines = to_lines(first, 150)
    np.testing.assert_allclose((lines**2).sum(), (first**2).sum())
    np.testing.assert_allclose(to_lines(2.0 * first - second, 150), 2.0 * lines - to_lines(second, 150), atol=1e-12)


def test_periodic_projection_treats_columns_like_torque() -> None:
    signals = process_periodic(_recording(), PeriodicSettings(torque_bandwidth_hz=5.0))
    column = 3.0 * signals.acceleration + np.sign(signals.velocity) + 0.5
    np.testing.assert_allclose(signals.project(column), signals.project(signals.torque), atol=1e-9)


@pytest.mark.parametrize(("order", "cutoff_hz"), [(20, 2.0), (12, 1.6)])
def test_wrapped_filter_equals_scipy_far_inside_a_long_repetition(order: int, cutoff_hz: float) -> None:
    position, _, _ = fourier_motion(JOINTS, period_s=PERIOD_S, samples=SAMPLES, seed=6)
    values = position + np.sign(position)
    sections = butter(order, cutoff_hz, fs=SAMPLES / PERIOD_S, output="sos")
    long = sosfiltfilt(sections, np.tile(values, (31, 1)), axis=0)[15 * SAMPLES : 16 * SAMPLES]
    wrapped = wrapped_zero_phase_filter(values, PERIOD_S / SAMPLES, order, cutoff_hz)
    np.testing.assert_allclose(wrapped, long, atol=1e-9)


def test_paper_chain_differentiates_centrally_around_the_period() -> None:
    signals = process_as_in_paper(_recording())
    step = PERIOD_S / SAMPLES
    expected = (signals.position[1] - signals.position[-1]) / (2.0 * step)
    np.testing.assert_allclose(signals.velocity[0], expected)
    np.testing.assert_allclose(wrapped_central_difference(signals.velocity, step), signals.acceleration)


def test_sixth_order_difference_is_exact_for_polynomials_of_degree_six() -> None:
    time = np.linspace(-1.0, 1.0, 41)
    step = float(time[1] - time[0])
    values = (time**6 - 2.0 * time**5 + time)[:, None]
    derivative = (6.0 * time**5 - 10.0 * time**4 + 1.0)[:, None]
    np.testing.assert_allclose(sixth_order_difference(values, step)[3:-3], derivative[3:-3], atol=1e-11)


def test_even_stamps_are_taken_as_they_are_and_uneven_ones_resampled() -> None:
    time = np.arange(200) * 0.01
    values = np.sin(3.0 * time)[:, None]
    grid, position, _ = uniform_grid(time, values, values, 0.01)
    assert position is values
    generator = np.random.default_rng(4)
    uneven = time + generator.uniform(-0.003, 0.003, time.size)
    grid, position, _ = uniform_grid(uneven, np.sin(3.0 * uneven)[:, None], values, 0.01)
    np.testing.assert_allclose(position[:, 0], np.sin(3.0 * grid), atol=1e-6)


def test_gaps_split_a_recording_into_stretches() -> None:
    recording = replace(_recording(periods=6), period_index=None, sample_in_period=None, period_s=None)
    holes = np.concatenate([np.arange(1500, 1560), np.arange(3000, 3040)])
    pieces = process_aperiodic(_without(recording, holes), 8.0)
    assert len(pieces) == 3
    assert all(np.allclose(np.diff(piece.time), recording.sampling_period_s) for piece in pieces)


def test_aperiodic_projection_is_one_filter_for_every_side() -> None:
    recording = _recording(periods=2)
    (piece,) = process_aperiodic(recording, 8.0)
    generator = np.random.default_rng(9)
    first, second = generator.normal(size=(2, piece.time.size, 3))
    combined = piece.project(first + 2.0 * second)
    np.testing.assert_allclose(combined, piece.project(first) + 2.0 * piece.project(second), atol=1e-12)
    assert piece.used.shape[0] == combined.shape[0] == piece.evaluation_time.size


def test_standstill_is_a_stretch_of_rest_and_not_a_reversal() -> None:
    time = np.arange(4000) * 1e-3
    velocity = np.where(time < 1.0, 1e-5, np.sin(2.0 * np.pi * (time - 1.0)))[:, None]
    resting = standstill(velocity, np.array([0.01]), shortest=100, margin=50)[:, 0]
    assert resting[:1000].all()
    assert not resting[1100:].any()


@pytest.mark.filterwarnings("error")
def test_a_sample_that_no_period_has_is_passed_over_in_silence_by_every_median() -> None:
    whole = _recording(noise=0.1)
    table = period_table(_without(whole, np.arange(6) * SAMPLES + 100))
    cleaned, beyond, replaced = clean_across_periods(table)
    expected, *shares = clean_across_periods(period_table(whole))
    assert not np.isfinite(cleaned.torque[:, 100]).any()
    np.testing.assert_allclose([beyond, replaced], shares, atol=1e-3)
    kept = np.arange(SAMPLES) != 100
    np.testing.assert_allclose(cleaned.torque[:, kept], expected.torque[:, kept], atol=0.1)


@pytest.mark.filterwarnings("error")
def test_a_median_over_periods_is_of_what_there_is_joint_by_joint() -> None:
    values = np.arange(24.0).reshape(4, 3, 2)
    values[:, 1, 0] = np.nan
    values[0, 2, 1] = np.nan
    expected = np.array([[9.0, 10.0], [np.nan, 12.0], [13.0, 17.0]])
    np.testing.assert_array_equal(median_over_periods(values), expected)


def test_a_low_pass_above_the_sampling_rate_is_refused() -> None:
    with pytest.raises(RecordingError, match="does not fit"):
        process_aperiodic(_recording(), 190.0)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("lost", ["nothing", "one sample of every period", "single samples", "half of one period"])
@pytest.mark.parametrize("hertz", [None, 5.0, 10.0, 20.0])
def test_the_noise_shows_which_filter_a_record_went_through(hertz: float | None, lost: str) -> None:
    periods, samples, rate = 10, 1250, 125.0
    noise = np.random.default_rng(5).normal(size=(periods * samples, 3))
    torque = 50.0 * np.sin(2.0 * np.pi * np.arange(periods * samples) / samples)[:, None] + 0.1 * noise
    if hertz is not None:
        torque = sosfilt(butter(4, hertz, fs=rate, output="sos"), torque, axis=0)
    torque = torque.reshape(periods, samples, 3)
    if lost == "one sample of every period":
        torque[:, 300] = np.nan
    elif lost == "single samples":
        torque[np.random.default_rng(6).random((periods, samples)) < 0.01] = np.nan
    elif lost == "half of one period":
        torque[4, 200:825] = np.nan
    found = cutoff_hz(torque, 1.0 / rate)
    assert found == (None if hertz is None else pytest.approx(hertz, rel=0.15))
