"""A recording with few samples, for questions to the rigid body that no fit has to be made for.

Here: the samples, and the columns of base parameters along them beside what free functions of each joint take.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from identification.arrays import FloatArray, IntArray, evenly
from identification.base_parameters import BaseRegressor
from identification.errors import RecordingError
from identification.mismatch.data_faults.rival_physics import beside, rival_physics
from identification.recordings.recording import Recording
from identification.remembered import once_per_object
from identification.signals.aperiodic import process_aperiodic
from identification.signals.periodic import process_periodic
from identification.signals.processed import ProcessedSignals

ROWS_PER_NUMBER = 10.0
"""Residuals of neighbouring rows are alike: their number overstates what is known, by ten at least."""
MOST_STATES = 1200
SMOOTHED_S = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Thinned:
    """A stretch with few samples, and per joint the free functions that a fault must beat (`rival_physics`)."""

    signals: ProcessedSignals
    rivals: tuple[FloatArray, ...]


@once_per_object
def thinned_stretch(recording: Recording) -> Thinned | None:
    """At most MOST_STATES samples of the longest stretch, spread evenly over those that count, torque smoothed over
    0.1 s; None where the recording has no stretch.
    """
    try:
        stretches = [process_periodic(recording)] if recording.is_periodic else process_aperiodic(recording)
    except RecordingError:
        return None
    stretch = max(stretches, key=lambda signals: signals.time.size)
    step = float(stretch.time[1] - stretch.time[0])
    width = min(max(5, 2 * round(0.5 * SMOOTHED_S / step) + 1), (stretch.time.size - 1) // 2 * 2 - 1)
    counts = np.ones(stretch.time.size, dtype=np.bool_)
    if stretch.row_time is not None:
        place = np.minimum(np.searchsorted(stretch.row_time, stretch.time), stretch.row_time.size - 1)
        inside = (stretch.time >= stretch.row_time[0]) & (stretch.time <= stretch.row_time[-1])
        counts = inside & stretch.used[place].all(axis=1)
    index = np.flatnonzero(counts if counts.sum() > 100 else np.ones_like(counts))
    index = index[evenly(index.size, MOST_STATES)]
    torque, rate = smoothed(stretch.torque, width, step, index)
    position, velocity = stretch.position[index], stretch.velocity[index]
    signals = replace(
        stretch,
        time=stretch.time[index],
        position=position,
        velocity=velocity,
        acceleration=stretch.acceleration[index],
        torque=torque,
    )
    return Thinned(signals, rival_physics(position, velocity, torque, rate))


def smoothed(values: FloatArray, width: int, step: float, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Value and rate (S, n) of the cubic through the `width` samples around each of `rows` (Savitzky-Golay); at the
    ends through the first or last `width`. As `scipy.signal.savgol_filter`, which takes 0.3 s to load.
    """
    half = width // 2
    start = np.clip(rows - half, 0, len(values) - width)
    cubic = np.linalg.pinv(np.vander(np.arange(-half, half + 1.0), 4, increasing=True))
    c = sliding_window_view(values, width, axis=0)[start] @ cubic.T
    at = (rows - half - start)[:, None]
    value = c[..., 0] + at * (c[..., 1] + at * (c[..., 2] + at * c[..., 3]))
    return value, (c[..., 1] + at * (2.0 * c[..., 2] + at * 3.0 * c[..., 3])) / step


def columns_of(stretch: ProcessedSignals, regressor: BaseRegressor, velocity: float, acceleration: float) -> FloatArray:
    """(S, n, p) with velocity and acceleration times those factors."""
    return regressor.matrix(stretch.position, velocity * stretch.velocity, acceleration * stretch.acceleration)


def by_joint_of(columns: FloatArray, rivals: Sequence[FloatArray]) -> FloatArray:
    """(S, n, p) → (n, S, p), so that weights of joints can be changed after the products over the samples are made.

    rivals: per joint what is fitted along and taken off, or nothing.
    """
    if not rivals:
        return np.ascontiguousarray(columns.transpose(1, 0, 2))
    return np.stack([beside(basis, columns[:, joint]) for joint, basis in enumerate(rivals)])


def torque_beside(torque: FloatArray, rivals: Sequence[FloatArray]) -> FloatArray:
    """(S, n) without what the free functions of each joint take of it."""
    return by_joint_of(torque[:, :, None], rivals)[..., 0].T if rivals else torque


def transposed(columns: FloatArray) -> FloatArray:
    """(n, S, p) → (n, p, S)."""
    return columns.transpose(0, 2, 1)
