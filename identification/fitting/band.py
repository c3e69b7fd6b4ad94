"""Which low-pass recordings without periods go through: chosen from the data, one for the fit and the diagnosis.

The rule: the narrowest band that holds ten harmonics of the motion, which friction at its reversals has, and that costs
no precision. What a wider one lets in besides is only what no column describes (resonances, noise); what costs
precision shows in the standard deviations of the parameters on coloured residuals. Nor does a wider one hold much
noise of the position, which grows in acceleration with the square of the frequency and makes torque by inertia: it is
in the columns, and a diagnosis would take it for a joint that is not rigid. That takes over what the fit chose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, starmap

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor, direction_of
from identification.errors import EstimationError
from identification.fitting.blocks import Block, RowsOverTime, build_block
from identification.fitting.estimate import estimate_parameters
from identification.fitting.processing import SMALLEST_MOTION
from identification.recordings.recording import Recording
from identification.signals.aperiodic import motion_cutoff, process_aperiodic, uniform_grid, zero_phase_low_pass
from identification.signals.periodic import to_lines

LOWEST_HZ = 10.0
WIDEST_HZ = 60.0
STEP = 2.0**0.5
"""Ratio of each band tried to the one before."""
MOTION_SHARE = 0.95
HARMONICS = 10.0
"""The band is never below this multiple of the frequency up to which a joint has that share of its velocity."""
ABOVE_NOISE = 10.0
"""Times the mean square of the noise that a line of the velocity has: by noise alone one of 20 000 has as much."""
NO_PRECISION = 1.01
"""Geometric mean of the parameters' standard deviations, over that of the best band, up to which a band costs none: a
hundredth is less than a deviation is known to from any residual of less than 5000 independent rows."""

MOST_POSITION_NOISE = 0.25
"""Share of the squares left of a joint's torque that noise of the position may make in a wider band: an eighth of the
RMS."""
INERTIA_SAMPLES = 200
"""Of a stretch, over which the square of the inertia matrix is averaged."""


@dataclass(frozen=True, slots=True)
class BandChoice:
    """low_pass_hz: the band taken. deviations: of each band tried, geometric mean of σ over the smallest such mean.

    noisy_hz: the first band that was not tried for the noise of the position in it, None where there was none.
    """

    low_pass_hz: float
    deviations: dict[float, float]
    noisy_hz: float | None = None

    @property
    def sentence(self) -> str:
        """What the reader is told."""
        if not self.deviations:
            return f"Compared up to {self.low_pass_hz:.3g} Hz, as wide as sampling and motion allow"
        tried = ", ".join(f"{value:.2f} at {band:.3g}" for band, value in self.deviations.items())
        wider = (
            "" if self.noisy_hz is None else f"; up to {self.noisy_hz:.3g} Hz noise of the position makes much torque"
        )
        return (
            f"Compared up to {self.low_pass_hz:.3g} Hz: the narrowest band that holds ten harmonics of the motion and "
            f"costs no precision (σ of the parameters against the best band: {tried} Hz{wider})"
        )


def choose_low_pass(recordings: Sequence[Recording], regressor: BaseRegressor) -> BandChoice:
    """The band for recordings of one robot, fitted together; regressor: with every option that may be wanted.

    Never above an eighth of the lowest sampling rate, where signs of velocity alias. The lowest candidate where no band
    determines the parameters. Raises RecordingError as `process_aperiodic` where a recording is too short for any.
    """
    highest = min(highest_band(recording) for recording in recordings)
    lowest = min(highest, max(band_of_motion(recording) for recording in recordings))
    wider = int(np.log(highest / lowest) / np.log(STEP) + 1e-9)
    bands = [lowest * STEP**number for number in range(wider + 1)]
    if len(bands) == 1:
        return BandChoice(bands[0], {})
    blocks, levels = [], []
    for recording in recordings:
        level = position_noise(recording)
        for signals in process_aperiodic(recording, bands[-1]):
            block = build_block(signals, regressor, None, float(recording.time[0]), recording.duration_s)
            if block is not None:
                blocks.append(_in_lines(block))
                levels.append(level)
    sizes: dict[float, float] = {}
    first: FloatArray | None = None
    found: FloatArray | None = None
    noisy: float | None = None
    for band in bands:
        if first is not None and found is not None:
            noise = _share_of_position_noise(blocks, levels, regressor, first, found, band)
            if np.any(noise > MOST_POSITION_NOISE):
                noisy = band
                break
        try:
            rows = [_below(_with_friction_of(block, regressor, band), band) for block in blocks]
            result = estimate_parameters(rows, regressor.names, "weighted")
        except EstimationError:
            continue
        found = result.least_squares.values
        first = found if first is None else first
        sizes[band] = float(np.exp(np.mean(np.log(result.least_squares.std))))
    if not sizes:
        return BandChoice(bands[0], {})
    smallest = min(sizes.values())
    deviations = {band: size / smallest for band, size in sizes.items()}
    return BandChoice(min(band for band, share in deviations.items() if share <= NO_PRECISION), deviations, noisy)


def highest_band(recording: Recording) -> float:
    """Hz above which signs of velocity alias, or nothing is looked for."""
    return within_rate(WIDEST_HZ, recording)


def within_rate(band_hz: float, recording: Recording) -> float:
    """A band that was chosen for other recordings, Hz, as far as the rate of this one allows: above, signs alias."""
    return min(band_hz, 1.0 / recording.sampling_period_s / 8.0)


def band_of_motion(recording: Recording) -> float:
    """Hz that hold ten harmonics of the motion: ten times the frequency below which every joint has its velocity.

    Noise of the position is none: in velocity it grows with the frequency, and a coarse encoder's is soon a twentieth.
    """
    step = recording.sampling_period_s
    position = _on_a_grid(recording)
    window = np.hanning(len(position))[:, None]
    lines = np.abs(np.fft.rfft(np.gradient(position, axis=0) * window, axis=0)) ** 2
    frequency = np.arange(len(lines)) / (len(position) * step)
    noise = position_noise(recording) * (window**2).sum() / (2.0 * step)
    noise = noise * np.sin(2.0 * np.pi * frequency * step)[:, None] ** 2
    looked_for = (lines > ABOVE_NOISE * noise) & (frequency <= highest_band(recording))[:, None]
    power = np.cumsum(np.where(looked_for, lines, 0.0), axis=0)
    line = np.array([np.searchsorted(column, MOTION_SHARE * column[-1]) for column in power.T])
    moving = np.ptp(position, axis=0) > SMALLEST_MOTION
    wanted = HARMONICS * float(line[moving].max(initial=0)) / (len(position) * step)
    return float(min(max(LOWEST_HZ, round(wanted, 1)), highest_band(recording)))


def position_noise(recording: Recording) -> FloatArray:
    """(n,) rad²/Hz (m²/Hz): level of the position's spectrum where no arm moves: above 60 Hz, or in the upper half.

    Median over the lines of one octave, which a resonance does not raise: what a coarse encoder rounds off lies mostly
    below the frequency of its steps, and a fast sampling leaves little of it in the upper half.
    """
    step = recording.sampling_period_s
    position = _on_a_grid(recording)
    window = np.hanning(len(position))[:, None]
    power = 2.0 * step * np.abs(np.fft.rfft(position * window, axis=0)) ** 2 / (window**2).sum()
    # Of a sum of two squares the median is log 2 of the mean.
    lowest = min(len(power) // 2, round(WIDEST_HZ * len(position) * step))
    return np.asarray(np.median(power[lowest : 2 * lowest], axis=0) / np.log(2.0))


def velocity_noise_of(recording: Recording, low_pass_hz: float) -> FloatArray:
    """(n,) rad/s (m/s), standard deviation of the velocity's noise in a band: `position_noise` differentiated."""
    highest = motion_cutoff(low_pass_hz, recording.sampling_period_s)
    return np.asarray(2.0 * np.pi * np.sqrt(position_noise(recording) * highest**3 / 3.0))


def _on_a_grid(recording: Recording) -> FloatArray:
    """Positions (N, n) at even times; the longest stretch's alone where gaps hold more time than rows do."""
    time, step, rows = recording.time, recording.sampling_period_s, slice(None)
    if time[-1] - time[0] > 2.0 * recording.samples * step:
        bounds = [0, *(np.flatnonzero(np.diff(time) > 3.0 * step) + 1).tolist(), recording.samples]
        rows = max(starmap(slice, pairwise(bounds)), key=lambda stretch: stretch.stop - stretch.start)
    return uniform_grid(time[rows], recording.position[rows], recording.torque[rows], step)[1]


def _share_of_position_noise(
    blocks: Sequence[Block],
    levels: Sequence[FloatArray],
    regressor: BaseRegressor,
    first: FloatArray,
    values: FloatArray,
    band_hz: float,
) -> FloatArray:
    """(n,) of the squares that parameters (p,) leave of each joint's torque up to a frequency.

    levels: of each block, as `position_noise`. first: the parameters of the narrowest band, whose inertias count; those
    of a wider one have shrunk by the very noise that is asked about.
    """
    left, expected = np.zeros(regressor.robot.n), np.zeros(regressor.robot.n)
    for block, level in zip(blocks, levels, strict=True):
        rows = _below(block, band_hz)
        left += ((rows.torque - rows.columns @ values) ** 2).sum(axis=0)
        growth = _inertia_squared(block, regressor, first) @ level * (2.0 * np.pi) ** 4
        expected += len(block.torque) * growth * band_hz**5 / 5.0
    return expected / np.maximum(left, 1e-300)


def _inertia_squared(block: Block, regressor: BaseRegressor, values: FloatArray) -> FloatArray:
    """(n, n) mean square over a stretch of each entry of the inertia matrix, kg² m⁴."""
    q = block.signals.position[:: max(1, len(block.signals.position) // INERTIA_SAMPLES)]
    still = np.zeros_like(q)
    rest = regressor.torque(values, q, still, still)
    columns = [regressor.torque(values, q, still, still + unit) - rest for unit in np.eye(q.shape[1])]
    return np.stack([(column**2).mean(axis=0) for column in columns], axis=1)


def _in_lines(block: Block) -> Block:
    """The block with spectral lines for rows; rows in which a joint stands still are zero on both sides."""
    lines = (len(block.torque) - 1) // 2
    return replace(
        block,
        columns=to_lines(np.where(block.fitted[..., None], block.columns, 0.0), lines),
        torque=to_lines(np.where(block.fitted, block.torque, 0.0), lines),
        signals=replace(block.signals, row_time=None, row_noise=None),
        evaluation=RowsOverTime(()),
        evaluation_held_out=None,
    )


def _with_friction_of(block: Block, regressor: BaseRegressor, band_hz: float) -> Block:
    """The lines with Coulomb friction's columns as a fit in that band has them: it smooths the velocity itself.

    In a wider one, noise of the position turns the sign of a slow velocity back and forth, on all lines.
    """
    signals, columns = block.signals, block.columns.copy()
    step = float(signals.time[1] - signals.time[0])
    velocity = zero_phase_low_pass(signals.velocity, step, motion_cutoff(band_hz, step))
    friction = signals.project(direction_of(velocity, regressor.options.coulomb_velocity))
    lines = to_lines(np.where(block.fitted, friction, 0.0), (len(friction) - 1) // 2)
    names = [regressor.full_names[position] for position in regressor.kept]
    for joint in range(regressor.robot.n):
        if f"FS_{joint + 1}" in names:
            columns[:, joint, names.index(f"FS_{joint + 1}")] = lines[:, joint]
    return replace(block, columns=columns)


def _below(block: Block, band_hz: float) -> Block:
    """The lines up to band_hz."""
    assert block.signals.evaluation_time.size > 1
    step = float(block.signals.evaluation_time[1] - block.signals.evaluation_time[0])
    rows = 2 * min(int(band_hz * len(block.torque) * step), (len(block.torque) - 1) // 2) + 1
    every = np.ones((rows, block.torque.shape[1]), dtype=np.bool_)
    return replace(
        block, columns=block.columns[:rows], torque=block.torque[:rows], fitted=every, held_out=~every,
        scale=np.ones(every.shape),
    )  # fmt: skip
