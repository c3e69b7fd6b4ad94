"""Do two recordings hold the same noise? A copy that was resampled, filtered, scaled or turned has no sample in common
with its original and no clock, but what does not repeat in its torques came about once. Pure.
"""

from __future__ import annotations

import numpy as np

from identification.arrays import DEVIATION_FROM_MEDIAN, FloatArray
from identification.recordings.labels import SAME_MOTION
from identification.recordings.recording import Recording
from identification.recordings.rounded import ODDS

PARTS = 4
"""In time, each of which has to show it: two runs may begin alike, or meet one push alike."""
SAME_PERIOD = 1e-3
LATEST = 16
"""Part of a period by which a filter may have made a torque late."""
SAMPLES_PER_BIN = 2.0
MOST_BINS = 1000
LARGEST = 4.0
"""Standard deviations beyond which noise is cut off, so that no single event carries a correlation."""


def correlation_of_noise(own: Recording, other: Recording) -> float:
    """Correlation of what does not repeat in the torques of two recordings of one motion, 0 where it may be chance.

    What does not repeat is the second difference from period to period, which takes off the motion, all torque that it
    causes, and a drift that goes on evenly; three periods are needed. Where only one recording states a period it is
    the other's too. Of all time shifts the best is taken, against what the others show. Of other motions it is 0:
    simulated runs may have been given the same random numbers.
    """
    stated = [recording.period_s for recording in (own, other) if recording.period_s]
    if not stated or own.n != other.n or max(stated) > (1.0 + SAME_PERIOD) * min(stated):
        return 0.0
    step = SAMPLES_PER_BIN * max(own.sampling_period_s, other.sampling_period_s)
    bins = min(MOST_BINS, int(stated[0] / step))
    if bins < PARTS or min(own.duration_s, other.duration_s) < (3.0 - SAME_PERIOD) * stated[0]:
        return 0.0
    width_s = stated[0] / bins
    first, second = (_unrepeated(_in_bins(item.torque, item, width_s), bins) for item in (own, other))
    length = len(first) + len(second)
    spectra = [np.fft.rfft(values, length, axis=0) for values in (first, second)]
    products = np.fft.irfft((np.conj(spectra[0]) * spectra[1]).sum(axis=1), length)
    shift = np.arange(length)
    shift = np.where(shift < len(second), shift, shift - length)  # of the second behind the first, in bins
    overlap = np.minimum(len(second) - shift, len(first)) - np.maximum(-shift, 0)
    asked = overlap >= min(bins, len(first), len(second)) // 2
    size = float(np.sqrt(np.mean(products[asked] ** 2 / overlap[asked])))
    if size == 0.0:
        return 0.0
    sigmas = np.where(asked, np.abs(products) / (size * np.sqrt(np.maximum(overlap, 1))), 0.0)
    best = int(np.argmax(sigmas))
    if sigmas[best] < np.sqrt(2.0 * np.log(ODDS * asked.sum())):
        return 0.0
    begin = max(-int(shift[best]), 0)
    if not _same_motion(own, other, width_s, int(shift[best]), bins // LATEST):
        return 0.0
    pair = first[begin:][: overlap[best]], second[begin + shift[best] :][: overlap[best]]
    parts = np.array_split(np.sign(products[best]) * (pair[0] * pair[1]).sum(axis=1), PARTS)
    if min(part.sum() / (size * np.sqrt(part.size)) for part in parts) < np.sqrt(2.0 * np.log(ODDS)):
        return 0.0
    return float(abs(products[best]) / np.sqrt((pair[0] ** 2).sum() * (pair[1] ** 2).sum()))


def _same_motion(own: Recording, other: Recording, width_s: float, shift: int, latest: int) -> bool:
    """Whether two recordings are of one motion, the second so many bins behind, or up to `latest` more or less: a
    filter makes a torque late, and leaves the positions.
    """
    there, elsewhere = (_in_bins(item.position, item, width_s) for item in (own, other))
    moved = SAME_MOTION**2 * float(np.nanvar(there, axis=0).mean())
    for behind in range(shift - latest, shift + latest + 1):
        begin = max(-behind, 0)
        length = min(len(there) - begin, len(elsewhere) - begin - behind)
        if length > 0:
            apart = there[begin : begin + length] - elsewhere[begin + behind : begin + behind + length]
            if np.nanmean(apart**2) < moved:
                return True
    return False


def _in_bins(values: FloatArray, recording: Recording, width_s: float) -> FloatArray:
    """(T, n) means of values (N, n) in steps of width_s, nan where there is none.

    Steps begin between two samples: on one, the last digits of its stamp decide where it belongs, in all runs alike.
    """
    since_s = recording.time - recording.time[0] + 0.5 * recording.sampling_period_s
    place = (since_s / width_s).astype(np.int64)
    with np.errstate(invalid="ignore"):
        return np.column_stack([np.bincount(place, column) for column in values.T]) / np.bincount(place)[:, None]


def _unrepeated(torque: FloatArray, bins: int) -> FloatArray:
    """(T, n) second difference from period to period of a torque in bins, in its standard deviations."""
    left = torque[2 * bins :] - 2.0 * torque[bins:-bins] + torque[: -2 * bins]
    left = left - np.nanmedian(left, axis=0)
    size = DEVIATION_FROM_MEDIAN * np.nanmedian(np.abs(left), axis=0)
    return np.nan_to_num(np.clip(left / np.where(size > 0.0, size, np.inf), -LARGEST, LARGEST))
