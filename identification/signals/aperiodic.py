"""The pipeline for recordings without a period: uneven time stamps, gaps, standstill, high rates.

1. Gaps longer than a quarter of the low-pass's period split the recording into segments; very long segments are cut
   into overlapping pieces. 2. Within a piece, uneven time stamps are brought onto a uniform grid with a cubic spline;
   even ones are taken as they are. 3. The position passes a wide zero-phase Butterworth low-pass and is differentiated
   with a sixth-order central difference. 4. `project` sends the torque and every regressor column (signs of friction
   included) through the same low-pass, cuts the ends where it rings, and keeps every k-th row (about 2.5 rows per
   period of the cutoff frequency). 5. Rows in which a joint stands still are not used for that joint: its friction
   may have any value there.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np

from identification.arrays import BoolArray, FloatArray, runs_of
from identification.errors import RecordingError
from identification.recordings.recording import Recording
from identification.signals.processed import ProcessedSignals

FILTER_ORDER = 4
# The position passes a low-pass this many times wider than `project`, which q̈ and q̇ pass as well: at the same cutoff
# they would be filtered twice where the torque is once (5 % of an inertia on a motion with content near 10 Hz).
MOTION_OVER_CUTOFF = 2.0
STANDSTILL_SHARE = 0.01
"""A joint slower than this share of its own largest speed, for at least one period of the cutoff, stands still."""
EDGE_PERIODS = 2.0
"""Of the cutoff frequency, cut off at both ends of a segment: after one the ringing leaves 1 % of the acceleration,
after two 0.1 %.
"""
LONGEST_PIECE = 30_000
ROWS_PER_CUTOFF_PERIOD = 2.5
MIRRORED_PERIODS = 3.0
"""Of the cutoff frequency, by which the ends are prolonged: there the filter's memory has faded to 1e-3."""
EVEN_STAMPS = 0.01
_DIFFERENCE = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0


def cutoff_of(low_pass_hz: float | None, sampling_period_s: float) -> float:
    """Cutoff of the zero-phase low-pass in Hz: what is asked for, or 10 Hz, lowered to an eighth of the sampling rate.

    Raises RecordingError when the rate is too low for the one asked.
    """
    rate = 1.0 / sampling_period_s
    if low_pass_hz is None:
        return min(10.0, rate / 8.0)
    if not 0.0 < low_pass_hz < rate / 2.5:
        raise RecordingError(
            f"A low-pass at {low_pass_hz:g} Hz does not fit a recording at {rate:.4g} Hz; "
            f"choose one between 0 and {rate / 2.5:.4g} Hz"
        )
    return low_pass_hz


def motion_cutoff(cutoff_hz: float, sampling_period_s: float) -> float:
    """The cutoff in Hz that the position is smoothed with before it is differentiated, for a cutoff of the rows."""
    return min(MOTION_OVER_CUTOFF * cutoff_hz, 0.4 / sampling_period_s)


def cutoff_as_far_as(low_pass_hz: float | None, sampling_period_s: float) -> float | None:
    """The cutoff that other recordings had, Hz; an eighth of the sampling rate where this rate is too low for it."""
    rate = 1.0 / sampling_period_s
    return low_pass_hz if low_pass_hz is None or low_pass_hz < rate / 2.5 else rate / 8.0


def process_aperiodic(recording: Recording, low_pass_hz: float | None = None) -> list[ProcessedSignals]:
    """Every usable piece of a recording, filtered alike on both sides. low_pass_hz: as in `cutoff_of`.

    Raises RecordingError when no piece is long enough for the filter.
    """
    step = recording.sampling_period_s
    cutoff = cutoff_of(low_pass_hz, step)
    edge = round(EDGE_PERIODS / cutoff / step)
    fastest = _fastest(recording, cutoff)
    pieces = [
        _process_piece(recording, rows, cutoff, edge, STANDSTILL_SHARE * fastest)
        for rows in _pieces(recording, cutoff, edge)
    ]
    if not pieces:
        raise RecordingError.at(
            recording.source.path,
            f"no stretch without gaps is longer than {4 * EDGE_PERIODS / cutoff:.3g} "
            f"s, which a low-pass at {cutoff:g} Hz needs",
        )
    return pieces


def _pieces(recording: Recording, cutoff_hz: float, edge: int) -> list[slice]:
    step = recording.sampling_period_s
    splits = np.flatnonzero(np.diff(recording.time) > max(0.25 / cutoff_hz, 3.0 * step)) + 1
    bounds = [0, *splits.tolist(), recording.samples]
    pieces = []
    for start, stop in pairwise(bounds):
        if stop - start < max(4 * edge, 16):
            continue
        if stop - start <= LONGEST_PIECE:
            pieces.append(slice(start, stop))
            continue
        # Neighbours overlap by both their edges, so that what is kept joins without a hole.
        count = int(np.ceil((stop - start) / LONGEST_PIECE))
        cuts = np.linspace(start, stop, count + 1).astype(int)
        pieces.extend(slice(max(start, int(low) - edge), min(stop, int(high) + edge)) for low, high in pairwise(cuts))
    return pieces


def _process_piece(
    recording: Recording, rows: slice, cutoff_hz: float, edge: int, slowest: FloatArray
) -> ProcessedSignals:
    step = recording.sampling_period_s
    time, position, torque = uniform_grid(recording.time[rows], recording.position[rows], recording.torque[rows], step)
    position = zero_phase_low_pass(position, step, motion_cutoff(cutoff_hz, step))
    velocity = sixth_order_difference(position, step)
    acceleration = sixth_order_difference(velocity, step)
    stride = max(1, int(1.0 / step / (ROWS_PER_CUTOFF_PERIOD * cutoff_hz)))
    kept = slice(edge, time.size - edge, stride)
    moving = ~standstill(
        velocity, slowest, shortest=round(1.0 / cutoff_hz / step), margin=round(0.5 / cutoff_hz / step)
    )
    project = partial(low_pass_and_thin, step=step, cutoff_hz=cutoff_hz, kept=kept)
    return ProcessedSignals(
        pipeline="aperiodic",
        time=time,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        torque=torque,
        project=project,
        used=moving[kept],
        row_time=time[kept],
        row_noise=None,
        evaluate=project,
        evaluated=moving[kept],
        evaluation_time=time[kept],
        noise_floor_nm=np.full(recording.n, np.nan),
        facts={
            "low_pass_hz": cutoff_hz,
            "start_s": float(time[0]),
            "stop_s": float(time[-1]),
            "standstill_share": (1.0 - moving.mean(axis=0)).round(3).tolist(),
        },
    )


def low_pass_and_thin(values: FloatArray, *, step: float, cutoff_hz: float, kept: slice) -> FloatArray:
    """Some of the rows of values along axis 0 after the low-pass."""
    return zero_phase_low_pass(values, step, cutoff_hz)[kept]


def uniform_grid(
    time: FloatArray, position: FloatArray, torque: FloatArray, step: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time, position and torque on a uniform grid of about that step; values as they are where stamps are even."""
    count = round((time[-1] - time[0]) / step) + 1
    grid = np.linspace(time[0], time[-1], count)
    if count == time.size and np.abs(time - grid).max() <= EVEN_STAMPS * step:
        return grid, position, torque
    from scipy.interpolate import CubicSpline  # slow to load, and the periodic pipeline does without

    return grid, CubicSpline(time, position)(grid), CubicSpline(time, torque)(grid)


def zero_phase_low_pass(values: FloatArray, step: float, cutoff_hz: float) -> FloatArray:
    """Butterworth low-pass of order 4 run forward and backward along axis 0; ends are mirrored through their value.

    By its gain on the spectrum, 1/(1 + (tan(π f h)/tan(π f_c h))⁸), which is what both runs of the digital filter
    (bilinear transform) have together, h the step. Behind the mirrored ends the values go over into each other.
    """
    samples = values.shape[0]
    padding = min(samples - 1, int(MIRRORED_PERIODS / cutoff_hz / step))
    before, after = 2.0 * values[0] - values[padding:0:-1], 2.0 * values[-1] - values[-2 : -2 - padding : -1]
    length = _fast_length(samples + 2 * padding + int(2.0 * MIRRORED_PERIODS / cutoff_hz / step))
    first, last = (before if padding else values)[0], (after if padding else values)[-1]
    share = np.linspace(0.0, 1.0, length - samples - 2 * padding + 2)[1:-1].reshape(-1, *[1] * (values.ndim - 1))
    spectrum = np.fft.rfft(np.concatenate([before, values, after, last + share * (first - last)]), axis=0)
    ratio = np.tan(np.pi * np.fft.rfftfreq(length)) / np.tan(np.pi * cutoff_hz * step)
    gain = 1.0 / (1.0 + ratio ** (2 * FILTER_ORDER))
    spectrum *= gain.reshape(-1, *[1] * (values.ndim - 1))
    filtered = np.fft.irfft(spectrum, length, axis=0)
    return np.ascontiguousarray(filtered[padding : padding + samples])


def _fast_length(least: int) -> int:
    """The smallest 2ᵏ, 3 · 2ᵏ, 5 · 2ᵏ, 9 · 2ᵏ or 15 · 2ᵏ not below: a Fourier transform is slow on large primes."""
    return min(factor << ((least - 1) // factor).bit_length() for factor in (1, 3, 5, 9, 15))


def sixth_order_difference(values: FloatArray, step: float) -> FloatArray:
    """First derivative along axis 0 by the sixth-order central difference; of lower order at the ends."""
    result = np.gradient(values, step, axis=0, edge_order=2)
    if values.shape[0] < 2 * _DIFFERENCE.size:
        return np.asarray(result, dtype=np.float64)
    inner = sum(
        coefficient * values[offset : values.shape[0] - 6 + offset] for offset, coefficient in enumerate(_DIFFERENCE)
    )
    result[3:-3] = inner / step
    return np.asarray(result, dtype=np.float64)


def standstill(velocity: FloatArray, slowest: FloatArray, *, shortest: int, margin: int) -> BoolArray:
    """(S, n) samples at which a joint stands still: slower than `slowest` (n,) for `shortest` samples on end.

    A mere reversal is shorter and stays in. The stretch is widened by `margin` samples: the low-pass carries the
    unknown friction of the standstill that far.
    """
    result = np.zeros(velocity.shape, dtype=np.bool_)
    for joint in range(velocity.shape[1]):
        for start, stop in runs_of(np.abs(velocity[:, joint]) <= slowest[joint]):
            if stop - start >= shortest:
                result[max(0, start - margin) : stop + margin, joint] = True
    return result


def _fastest(recording: Recording, cutoff_hz: float) -> FloatArray:
    """Largest speed of each joint over the whole recording, (n,) rad/s, from a thinned and smoothed position."""
    width = max(1, round(0.25 / cutoff_hz / recording.sampling_period_s))
    change = recording.position[width:] - recording.position[:-width]
    duration = recording.time[width:] - recording.time[:-width]
    return np.asarray(np.percentile(np.abs(change / duration[:, None]), 99.5, axis=0), dtype=np.float64)
