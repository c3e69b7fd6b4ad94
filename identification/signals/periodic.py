"""The periodic pipeline: exact derivatives from the harmonics of the mean period, both sides on the same lines.

Position: its first H harmonics, differentiated exactly (q̇_h = i ω h q_h); H is the last line, below a cap, on which
the joint's mean position stands clearly above its noise, or the last of an unbroken run of such lines beyond the cap.
Torque and regressor columns: computed on the full time grid and taken to the same spectral lines 0 … B. Choosing lines
is the filter; it is the same on both sides, it wraps, and nothing is padded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.fft import rfft

from identification.arrays import FloatArray, IntArray
from identification.recordings.recording import Recording
from identification.signals.outliers import FEWEST_PERIODS, clean_across_periods
from identification.signals.periods import PeriodAverage, average_periods, period_table, smooth_over_lines
from identification.signals.processed import LinearOperator, ProcessedSignals
from identification.signals.standstill import over_standstills

# A line counts as motion when its power is this many times the noise power of the mean (chance of a noise line: 4e-6).
MOTION_OVER_NOISE = 12.0
# Below this amplitude (rad) a line is rounding, whatever the noise estimate says.
SMALLEST_AMPLITUDE = 1e-9
# Share of the largest velocity below which a velocity is rounding of zero.
ROUNDING = 1e-12
FEWEST_LINES = 30
LOWEST_BAND_HZ = 10.0
# Deviations of the ratio of two powers by which a torque line must stand above the noise.
TORQUE_OVER_NOISE = 4.0
PASSED = 0.5
"""Share of a cutoff up to which a low-pass leaves torque as it is: 0.2 % lost with order four, run once."""


@dataclass(frozen=True, slots=True)
class PeriodicSettings:
    """Largest bandwidths in Hz. motion: of the position's single harmonics (`motion_harmonics` has those beyond);
    torque: of the lines compared on both sides.

    Within them the data decide: harmonics of the position that stand above their noise, lines of the torque that do.
    Standstills are bridged (`standstill`): without that, lines above 10 Hz bias Coulomb friction by 5 σ, because a
    joint held by its friction takes any torque. A short period keeps at least 30 lines, any period those up to 10 Hz.
    """

    motion_bandwidth_hz: float = 20.0
    torque_bandwidth_hz: float = 60.0


def process_periodic(
    recording: Recording, settings: PeriodicSettings | None = None, *, bound_outliers: bool = False
) -> ProcessedSignals:
    """The mean period of a recording with exact derivatives, and the projection onto spectral lines.

    Rows of `project` are the orthonormal real Fourier coefficients: line 0, then cosine and sine of lines 1 … B; the
    squares of white noise are as large there as in time. Raises RecordingError as `period_table` does.
    """
    settings = settings if settings is not None else PeriodicSettings()
    table = period_table(recording)
    bounded: dict[str, Any] = {}
    if bound_outliers and len(table.periods) >= FEWEST_PERIODS:
        table, beyond, replaced = clean_across_periods(table)
        bounded = {"share_beyond_bound": beyond.round(5).tolist(), "share_replaced": replaced.round(5).tolist()}
    average = average_periods(table)
    finer, samples = average.finer, average.position.shape[0] * average.finer.factor
    position, velocity, acceleration = smooth_motion(average, settings)
    lines = torque_lines(average, settings)
    rows = 2 * lines + 1
    counts = np.maximum(average.counts, 1)[:, None]
    noise = None
    if average.torque_spectrum is not None:
        of_mean = np.sqrt(average.torque_spectrum[: lines + 1] / average.periods)
        noise = np.concatenate([of_mean[:1], np.repeat(of_mean[1:], 2, axis=0)]) * np.sqrt(finer.factor)
    time = np.arange(samples, dtype=np.float64) * (average.sampling_period_s / finer.factor)
    return ProcessedSignals(
        pipeline="periodic",
        time=time,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        torque=finer.refined(average.torque),
        project=projection_of(velocity, average, lines),
        used=np.ones((rows, recording.n), dtype=np.bool_),
        row_time=None,
        row_noise=noise,
        evaluate=finer.sampled,
        evaluated=np.repeat(~average.filled[:, None], recording.n, axis=1),
        evaluation_time=time[:: finer.factor],
        noise_floor_nm=average.torque_noise_nm * np.sqrt(np.mean(1.0 / counts)),
        facts={
            "periods": average.periods,
            "samples_per_period": samples,
            "period_s": average.period_s,
            "motion_harmonics": int(motion_harmonics(average, settings).max(initial=0)),
            "torque_lines": lines,
            "band_hz": lines / average.period_s,
            "notes": list(average.notes),
            **bounded,
        },
        noise_freedom=average.noise_freedom,
        outliers_bounded=bool(bounded),
    )


def projection_of(velocity: FloatArray, average: PeriodAverage, lines: int) -> LinearOperator:
    """The operator from a period of torque or of a column to its lines 0 … `lines`, with standstills bridged.

    velocity: (S, n) of `smooth_motion`, on the grid of the values. Where that is finer than the rows, the values
    are sampled as the rows were first; the lines are orthonormal on the finer grid.
    """
    finer = average.finer
    bridge = over_standstills(velocity[:: finer.factor], average.sampling_period_s)
    return lambda values: np.sqrt(finer.factor) * to_lines(bridge(finer.sampled(values)), lines)


def widest_lines(samples: int, period_s: float, settings: PeriodicSettings) -> int:
    """Largest number of lines that may be compared for one period of so many samples: above, signs of q̇ alias."""
    wanted = max(FEWEST_LINES, int(settings.torque_bandwidth_hz * period_s))
    return min(wanted, (samples - 1) * 4 // 10)


def torque_lines(average: PeriodAverage, settings: PeriodicSettings) -> int:
    """Number B of lines compared on both sides: up to the last on which any joint's mean torque stands above its noise.

    Power of the mean and of the noise are averaged over the same neighbouring lines; above the noise means by more
    than four of the deviations that such a ratio has. A single period, whose noise is not known, has all of them. Of a
    torque that was filtered before, up to half of the cutoff: what is above has lost a part that the model has, and
    where the filter left nothing stands the leakage of the periods' ends, alike on all lines.
    """
    samples = average.torque.shape[0]
    widest = widest_lines(samples, average.period_s, settings)
    if average.filtered_hz is not None:
        return min(widest, max(FEWEST_LINES, int(PASSED * average.filtered_hz * average.period_s)))
    if average.torque_spectrum is None:
        return widest
    power = smooth_over_lines(np.abs(np.fft.rfft(average.torque, axis=0)) ** 2 / samples)[: widest + 1]
    noise = average.torque_spectrum[: widest + 1] / average.periods
    number = np.arange(widest + 1)
    averaged = 2.0 * np.maximum(3, number // 10) + 1.0
    spread = np.sqrt(1.0 / averaged + 2.0 / (average.noise_freedom / 7.0 * averaged))
    above = (power > (1.0 + TORQUE_OVER_NOISE * spread[:, None]) * noise).any(axis=1)
    last = int(np.flatnonzero(above)[-1]) if above.any() else 0
    return min(widest, max(last, FEWEST_LINES, int(LOWEST_BAND_HZ * average.period_s)))


def motion_harmonics(average: PeriodAverage, settings: PeriodicSettings) -> IntArray:
    """(n,) harmonics of each joint up to the last in the motion's bandwidth on which its mean is above its noise.

    A motion that does not end there is followed on, up to the torque's, as long as the lines around each
    (`smooth_over_lines`) stand above the noise: a single one out there is no motion, and all up to it would be let in.
    One number for all joints would let the noise of the slowest joint into its acceleration. A joint that shows none
    stands still (0): from the noise of its encoder, parameters would be fitted that no motion determines.
    """
    samples = average.position.shape[0]
    cap, widest = (
        max(1, min(int(hertz * average.period_s), (samples - 1) // 2))
        for hertz in (settings.motion_bandwidth_hz, max(settings.motion_bandwidth_hz, settings.torque_bandwidth_hz))
    )
    # Same units as the noise spectrum: |line|² / M, white noise of variance s² gives s².
    power = np.abs(np.fft.rfft(average.position, axis=0)) ** 2 / samples
    noise = np.zeros_like(power) if average.position_spectrum is None else average.position_spectrum / average.periods
    # Quantisation repeats with the motion: period differences do not show it, the lines above the band do.
    if widest + 1 < len(power):
        noise = np.maximum(noise, np.median(power[widest + 1 :], axis=0) / np.log(2.0))
    floor = SMALLEST_AMPLITUDE**2 * samples / 4.0
    above = power[1 : cap + 1] > np.maximum(MOTION_OVER_NOISE * noise[1 : cap + 1], floor)
    last = np.where(above.any(axis=0), cap - np.argmax(above[::-1], axis=0), 0)
    around = smooth_over_lines(power)[cap : widest + 1] > np.maximum(MOTION_OVER_NOISE * noise[cap : widest + 1], floor)
    further = np.cumprod(around, axis=0).sum(axis=0)
    return np.where(further > 0, cap + further - 1, last).astype(np.int64)


def smooth_motion(average: PeriodAverage, settings: PeriodicSettings) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean position (S, n) of each joint's own harmonics with its first and second derivative, exact for these.

    On the grid of the rows, S = M, or on the finer one that their model asks for (`finer_grid`).
    """
    parts = [
        differentiate_harmonics(
            average.finer.refined(average.position[:, joint : joint + 1]), average.period_s, int(harmonics)
        )
        for joint, harmonics in enumerate(motion_harmonics(average, settings))
    ]
    position, velocity, acceleration = (np.concatenate(values, axis=1) for values in zip(*parts, strict=True))
    return position, velocity, acceleration


def differentiate_harmonics(
    position: FloatArray, period_s: float, harmonics: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The first harmonics of a periodic position (M, n) with first and second derivative, exact for that band."""
    samples = position.shape[0]
    spectrum = np.fft.rfft(position, axis=0)
    spectrum[harmonics + 1 :] = 0.0
    rotation = 2.0j * np.pi / period_s * np.arange(spectrum.shape[0])[:, None]
    smooth, velocity, acceleration = (
        np.fft.irfft(spectrum * rotation**order, n=samples, axis=0) for order in (0, 1, 2)
    )
    # A rest that is exact in the motion (its start, say) must not get a friction sign from rounding.
    velocity[np.abs(velocity) < ROUNDING * np.abs(velocity).max(axis=0)] = 0.0
    return smooth, velocity, acceleration


def to_lines(values: FloatArray, lines: int) -> FloatArray:
    """Orthonormal real Fourier coefficients of lines 0 … lines along axis 0: (M, …) → (2 lines + 1, …)."""
    samples = values.shape[0]
    spectrum = rfft(values, axis=0)[: lines + 1]
    rows = np.empty((2 * lines + 1, *values.shape[1:]))
    rows[0] = spectrum[0].real / np.sqrt(samples)
    scale = np.sqrt(2.0 / samples)
    rows[1::2] = scale * spectrum[1:].real
    rows[2::2] = scale * spectrum[1:].imag
    return rows
