"""What the figures of motion and residual draw, from a fit or from a diagnosis: arrays over time and over frequency.

Here: the modelled torque of a fit on its own recordings once more, and its residual in both views. Not here: any
drawing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from identification.arrays import FloatArray
from identification.fitting.delay import earlier
from identification.fitting.processing import process
from identification.fitting.result import FitResult
from identification.mismatch.figures import Spectrum, TimeSeries
from identification.mismatch.findings import Diagnosis
from identification.signals.processed import ProcessedSignals

_LONGEST_SEGMENT = 2048


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """One recording as a figure shows it: the mean period where there are periods, all of it otherwise.

    time: (S,) s. position, velocity: (S, n) rad, rad/s. residual_time: (E,) s, residual: (E, n) Nm, measured minus
    modelled, nan between stretches and where a joint rests; measured: (E, n) Nm, the torque itself there. floor_nm:
    (n,) standard deviation of the noise in the residual, nan where unknown. frequency: (F,) Hz; spectrum, noise: (F, n)
    Nm RMS per line, noise None where unknown.
    """

    name: str
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    residual_time: FloatArray
    residual: FloatArray
    measured: FloatArray
    floor_nm: FloatArray
    frequency: FloatArray
    spectrum: FloatArray
    noise: FloatArray | None


def stretches_of_fit(fit: FitResult, most: int) -> tuple[Stretch, ...]:
    """The first `most` recordings of a fit, processed as they were for it, with its base parameters' residual."""
    found = []
    for recording in fit.recordings[:most]:
        parts = process(recording, fit.robot, fit.settings).stretches
        if fit.settings.delay_correction != "no":
            shift = fit.torque_delay.of(fit.settings.delay_correction)
            parts = tuple(earlier(part, shift) for part in parts)
        found.append(_stretch(fit, PurePath(recording.source.path).name, parts))
    return tuple(found)


def stretches_of_diagnosis(diagnosis: Diagnosis, names: tuple[str, ...]) -> tuple[Stretch, ...]:
    """The fitted stretches of a diagnosis with the residual that its findings leave."""
    baseline = diagnosis.baseline
    known = baseline.noise_is_measured
    floor = baseline.noise_floor_nm if known else np.full_like(baseline.noise_floor_nm, np.nan)
    return tuple(
        _of_series(names[index] if index < len(names) else f"stretch {index + 1}", series, spectrum, floor, known)
        for index, (series, spectrum) in enumerate(zip(diagnosis.series, diagnosis.spectra, strict=False))
    )


def _of_series(name: str, series: TimeSeries, spectrum: Spectrum, floor: FloatArray, known: bool) -> Stretch:
    return Stretch(
        name, series.time, series.position, series.velocity, series.time, series.after, series.measured, floor,
        spectrum.frequency, spectrum.after, spectrum.noise if known else None,
    )  # fmt: skip


def _stretch(fit: FitResult, name: str, parts: tuple[ProcessedSignals, ...]) -> Stretch:
    differences = [
        part.torque - fit.regressor.torque(fit.values, part.position, part.velocity, part.acceleration)
        for part in parts
    ]
    residuals = []
    for part, difference in zip(parts, differences, strict=True):
        evaluated = part.evaluate(difference)
        residuals.append(np.where(part.evaluated, evaluated, np.nan))
    first = parts[0]
    if first.row_time is None:
        frequency, spectrum, noise = _lines(first, differences[0])
    else:
        frequency, spectrum, noise = (*_welch(residuals, first.evaluation_time), None)
    return Stretch(
        name=name,
        time=_joined([part.time for part in parts]),
        position=_joined([part.position for part in parts]),
        velocity=_joined([part.velocity for part in parts]),
        residual_time=_joined([part.evaluation_time for part in parts]),
        residual=_joined(residuals),
        measured=_joined([np.where(part.evaluated, part.evaluate(part.torque), np.nan) for part in parts]),
        floor_nm=np.sqrt(np.mean([part.noise_floor_nm**2 for part in parts], axis=0)),
        frequency=frequency,
        spectrum=spectrum,
        noise=noise,
    )


def _joined(parts: list[FloatArray]) -> FloatArray:
    """Arrays one after the other, a row of nan between two: lines break there."""
    gap = np.full((1, *parts[0].shape[1:]), np.nan)
    return np.concatenate([piece for part in parts for piece in (part, gap)][:-1])


def _lines(part: ProcessedSignals, difference: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Frequency and RMS amplitude per spectral line of the mean period, and the noise there."""
    samples = len(part.time)
    rows = part.project(difference)
    frequency = np.arange(len(rows) // 2 + 1) / (samples * float(part.time[1] - part.time[0]))
    noise = None if part.row_noise is None else _per_line(part.row_noise, samples)
    return frequency, _per_line(rows, samples), noise


def _per_line(rows: FloatArray, samples: int) -> FloatArray:
    """RMS over time of each line from its orthonormal cosine and sine rows: (2 L + 1, n) → (L + 1, n)."""
    power = rows**2
    return np.asarray(np.sqrt(np.concatenate([power[:1], power[1::2] + power[2::2]]) / samples), dtype=np.float64)


def _welch(residuals: list[FloatArray], time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frequency and RMS amplitude per line of the longest stretch without periods (Welch); a resting joint counts 0."""
    from scipy.signal import welch  # slow to load, and recordings with periods do without

    longest = max(residuals, key=len)
    rate = 1.0 / float(np.median(np.diff(time)))
    frequency, power = welch(
        np.nan_to_num(longest), fs=rate, nperseg=min(_LONGEST_SEGMENT, len(longest)), scaling="spectrum", axis=0
    )
    return frequency, np.sqrt(power)
