"""The filter chain of the paper's section 4.3, kept for comparison: it biases the parameters, and this is on purpose.

Position and torque pass different filters and the regressor passes none, so what the torque filter removes (mostly the
steps of Coulomb friction) is still in the regressor. The filters stand in second-order sections (as transfer function
they are unstable) and are wrapped around the mean period (zero-phase filtering = |H|² on its lines; with padding the
ends of one period are wrong by degrees).
"""

from __future__ import annotations

import numpy as np

from identification.arrays import FloatArray
from identification.recordings.recording import Recording
from identification.signals.periods import average_periods, period_table
from identification.signals.processed import ProcessedSignals, unchanged

POSITION_FILTER_ORDER, POSITION_CUTOFF_HZ = 20, 2.0
TORQUE_FILTER_ORDER, TORQUE_CUTOFF_HZ = 12, 1.6


def process_as_in_paper(recording: Recording) -> ProcessedSignals:
    """Mean period; q through order 20 at 2 Hz, τ through order 12 at 1.6 Hz, both forward and backward; central
    differences for q̇ and q̈; the regressor is not filtered. Raises RecordingError as `period_table` does.
    """
    average = average_periods(period_table(recording))
    step = average.sampling_period_s
    position = wrapped_zero_phase_filter(average.position, step, POSITION_FILTER_ORDER, POSITION_CUTOFF_HZ)
    torque = wrapped_zero_phase_filter(average.torque, step, TORQUE_FILTER_ORDER, TORQUE_CUTOFF_HZ)
    velocity = wrapped_central_difference(position, step)
    acceleration = wrapped_central_difference(velocity, step)
    time = np.arange(position.shape[0], dtype=np.float64) * step
    used = np.repeat(~average.filled[:, None], recording.n, axis=1)
    return ProcessedSignals(
        pipeline="paper",
        time=time,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        torque=torque,
        project=unchanged,
        used=used,
        row_time=time,
        row_noise=None,
        evaluate=unchanged,
        evaluated=used,
        evaluation_time=time,
        noise_floor_nm=_filtered_noise(average.torque_spectrum, average.periods, average.position.shape, step),
        facts={
            "periods": average.periods,
            "samples_per_period": position.shape[0],
            "period_s": average.period_s,
            "notes": list(average.notes),
        },
    )


def zero_phase_response(samples: int, sampling_period_s: float, order: int, cutoff_hz: float) -> FloatArray:
    """|H|² of a Butterworth low-pass run forward and backward, on the lines of a period of that many samples."""
    from scipy.signal import butter, sosfreqz  # slow to load, and the periodic pipeline does without

    sections = butter(order, cutoff_hz, fs=1.0 / sampling_period_s, output="sos")
    frequencies = 2.0 * np.pi * np.arange(samples // 2 + 1) / samples
    _, response = sosfreqz(sections, worN=frequencies)
    return np.asarray(np.abs(response) ** 2, dtype=np.float64)


def wrapped_zero_phase_filter(values: FloatArray, sampling_period_s: float, order: int, cutoff_hz: float) -> FloatArray:
    """Forward-backward Butterworth filter of one period repeated for ever. values: (M, n). Returns (M, n)."""
    response = zero_phase_response(values.shape[0], sampling_period_s, order, cutoff_hz)
    return np.fft.irfft(np.fft.rfft(values, axis=0) * response[:, None], n=values.shape[0], axis=0)


def wrapped_central_difference(values: FloatArray, sampling_period_s: float) -> FloatArray:
    """(x_{m+1} − x_{m−1}) / 2 h on the wrapped period. values: (M, n). Returns (M, n)."""
    return np.asarray(
        (np.roll(values, -1, axis=0) - np.roll(values, 1, axis=0)) / (2.0 * sampling_period_s), dtype=np.float64
    )


def _filtered_noise(
    spectrum: FloatArray | None, periods: int, shape: tuple[int, ...], sampling_period_s: float
) -> FloatArray:
    """Standard deviation of the filtered mean torque's noise, (n,)."""
    if spectrum is None:
        return np.full(shape[1], np.nan)
    response = zero_phase_response(shape[0], sampling_period_s, TORQUE_FILTER_ORDER, TORQUE_CUTOFF_HZ)
    weight = np.full(response.size, 2.0)
    weight[0] = 1.0
    power = (spectrum * (weight * response**2)[:, None]).sum(axis=0) / shape[0]
    return np.asarray(np.sqrt(power / periods), dtype=np.float64)
