"""A recording reduced for diagnosis: rows of the mean, rows of each period, and the noise that both carry.

Noise comes from differences of successive periods, misfit from the mean of the periods, changes from contrasts between
them; the three are never mixed. Rows are spectral lines, so that coloured noise is a matter of one variance per line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, starmap

import numpy as np
from scipy.fft import irfft

from identification.arrays import BoolArray, FloatArray
from identification.base_parameters import BaseRegressor
from identification.mismatch.motion import Motion
from identification.mismatch.noise import noise_of_mean
from identification.mismatch.settings import ROUNDING, DiagnosisSettings
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.signals.periodic import PeriodicSettings, projection_of, smooth_motion, to_lines, torque_lines
from identification.signals.periods import PeriodTable, average_periods
from identification.signals.processed import LinearOperator


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """One stretch of a recording in the space of the diagnosis.

    recording: where it comes from. motion: what effects see. project: linear along axis 0, (S, …) → (R, …), for every
    torque column. frequency: (R,) Hz of each row (line 0, then cosine and sine of each line). torque: (R, n) rows of
    the measured mean. period_torque: (K, R, n) rows of each period, None without periods. nominal: (R, n, p) rows of
    the base regressor's columns. noise: (R, n) Nm, standard deviation of the noise in `torque`'s rows.
    noise_freedom: (R, n) real degrees of freedom behind each entry of `noise`. used: (R, n) rows that count.
    noise_is_measured: whether the noise comes from period differences; False where it had to be taken from the high
    band, which is weaker evidence. restore: rows (R, …) back to (S, …), nan where no row tells; None for the lines of
    a period. counted: samples behind the rows where those are not all of the motion's. white_noise:
    (R, n) Nm, level of the torque above the compared band where `noise` is more than that, no less than rows without
    periods are known to (`ROWS_TELL`); None where it is measured.
    noise_by_band: whether noise that stands in for a measured one may differ between bands. table: the periods that
    the rows come from, None without.
    """

    recording: Recording
    motion: Motion
    project: LinearOperator
    frequency: FloatArray
    torque: FloatArray
    period_torque: FloatArray | None
    nominal: FloatArray
    noise: FloatArray
    noise_freedom: FloatArray
    used: BoolArray
    noise_is_measured: bool
    restore: LinearOperator | None = None
    counted: int | None = None
    white_noise: FloatArray | None = None
    noise_by_band: bool = True
    table: PeriodTable | None = None

    @property
    def samples(self) -> int:
        """Number of samples behind the rows: Σ rows² over it is a mean square over time."""
        return self.motion.samples if self.counted is None else self.counted

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.torque.shape[1])

    @property
    def periods(self) -> int:
        """Number K of periods, 1 for a stretch without periods."""
        return 1 if self.period_torque is None else int(self.period_torque.shape[0])


@dataclass(frozen=True, slots=True, eq=False)
class PlannedRows:
    """Rows of a motion that is planned, with the noise to be expected; fields as in `Evidence`."""

    motion: Motion
    project: LinearOperator
    nominal: FloatArray
    noise: FloatArray


Rows = Evidence | PlannedRows
"""Rows that effects can be seen in, of a recording or of a motion not recorded yet."""


def rows_of_each(evidences: Sequence[Evidence]) -> list[slice]:
    """Where the rows of each evidence stand among those of all."""
    edges = np.cumsum([0, *(item.frequency.size for item in evidences)]).tolist()
    return list(starmap(slice, pairwise(edges)))


def fit_parameters(evidences: Sequence[Evidence]) -> FloatArray:
    """Base parameters (p,) that fit the means of all evidences together, rows weighted by their noise.

    The shortest solution (columns scaled alike) where the motion leaves parameters undetermined.
    """
    rows, torque = [], []
    for evidence in evidences:
        weight = np.where(evidence.used, 1.0 / evidence.noise, 0.0)
        rows.append((evidence.nominal * weight[..., None]).reshape(-1, evidence.nominal.shape[2]))
        torque.append((evidence.torque * weight).ravel())
    matrix = np.concatenate(rows)
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale < ROUNDING * scale.max()] = np.inf  # the motion does not ask for it: it stays at zero, with a variance
    solution = np.linalg.lstsq(matrix / scale, np.concatenate(torque), rcond=1e-10)[0]
    return np.asarray(solution / scale, dtype=np.float64)


def with_parameters(evidence: Evidence, regressor: BaseRegressor, values: FloatArray) -> Evidence:
    """The same evidence with the nominal torque and the dynamic parameters of other base parameters (p,)."""
    motion = evidence.motion
    torque = regressor.torque(values, motion.position, motion.velocity, motion.acceleration, motion.direction)
    full = regressor.ungrouping @ values
    return replace(evidence, motion=replace(motion, torque=torque, full_parameters=full))


def rows_to_time(evidence: Evidence, rows: FloatArray) -> FloatArray:
    """Spectral rows (R, …) back on the time grid of the motion (S, …), within the compared bandwidth."""
    if evidence.restore is not None:
        return evidence.restore(rows)
    samples = evidence.motion.samples
    spectrum = np.zeros((samples // 2 + 1, *rows.shape[1:]), dtype=np.complex128)
    lines = (rows.shape[0] - 1) // 2
    spectrum[0] = rows[0] * np.sqrt(samples)
    spectrum[1 : lines + 1] = (rows[1::2] + 1j * rows[2::2]) * np.sqrt(samples / 2.0)
    return np.asarray(irfft(spectrum, n=samples, axis=0), dtype=np.float64)


def periodic_evidence(
    recording: Recording, table: PeriodTable, robot: RobotModel, regressor: BaseRegressor, settings: DiagnosisSettings
) -> Evidence:
    """The evidence of a recording whose motion repeats, with the noise that its periods differ by."""
    average = average_periods(table)
    bands = PeriodicSettings(settings.motion_bandwidth_hz, settings.torque_bandwidth_hz)
    position, velocity, acceleration = smooth_motion(average, bands)
    lines = torque_lines(average, bands)
    project = projection_of(velocity, average, lines)
    finer = average.finer
    torque = project(finer.refined(average.torque))
    frequency = np.repeat(np.arange(lines + 1) / average.period_s, 2)[1:]
    period_torque = None
    if average.periods > 1:
        filled = np.where(np.isfinite(table.torque), table.torque, average.torque[None])
        period_torque = np.stack([project(finer.refined(period)) for period in filled])
        noise, freedom = noise_of_mean(period_torque)
    else:
        noise, freedom = _noise_of_high_band(average.torque, lines)
        noise = noise * np.sqrt(finer.factor)
    # argmax: the first row of a period.
    begins = np.array([int(np.argmax(recording.period_index == number)) for number in table.periods])
    motion = Motion(
        robot=robot,
        time=np.arange(len(position), dtype=np.float64) * (average.sampling_period_s / finer.factor),
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        torque=np.zeros_like(position),
        full_parameters=np.zeros(len(regressor.full_names)),
        periodic=True,
        start_s=recording.time[begins] - recording.time[0],
        coulomb_velocity=regressor.options.coulomb_velocity,
        compared_hz=float(frequency.max()),
    )
    evidence = Evidence(
        recording=recording,
        motion=motion,
        project=project,
        frequency=frequency,
        torque=torque,
        period_torque=period_torque,
        nominal=np.zeros(0),
        noise=noise,
        noise_freedom=freedom,
        used=np.ones(torque.shape, dtype=np.bool_),
        noise_is_measured=average.periods > 1,
        table=table,
    )
    return with_nominal(evidence, regressor)


def with_nominal(evidence: Evidence, regressor: BaseRegressor) -> Evidence:
    """The evidence with its nominal rows and the torque of the nominal fit to it."""
    motion = evidence.motion
    columns = regressor.matrix(motion.position, motion.velocity, motion.acceleration, motion.direction)
    nominal = np.zeros((*evidence.torque.shape, regressor.size))
    for joint in range(motion.n):
        present = np.flatnonzero(columns[:, joint].any(axis=0))
        nominal[:, joint, present] = evidence.project(columns[:, joint, present])
    evidence = replace(evidence, nominal=nominal)
    values = fit_parameters([evidence])
    full = regressor.ungrouping @ values
    return replace(evidence, motion=replace(motion, torque=columns @ values, full_parameters=full))


def _noise_of_high_band(torque: FloatArray, lines: int) -> tuple[FloatArray, FloatArray]:
    """White noise at the level of the lines above the compared band, or of its upper fifth where there are none.

    Weaker than period differences: colour at low frequencies stays unseen.
    """
    available = (torque.shape[0] - 1) // 2
    rows = to_lines(torque, available)
    high = rows[2 * lines + 1 :] if available > 1.2 * lines else rows[int(1.6 * available) :]
    level = np.sqrt(np.maximum(np.median(high**2, axis=0) / 0.4549, 1e-18))
    return np.tile(level, (2 * lines + 1, 1)), np.full((2 * lines + 1, level.size), float(high.shape[0]))
