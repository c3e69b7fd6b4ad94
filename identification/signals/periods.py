"""Periods of a periodic recording: laid out in a table, averaged with respect for gaps, compared with each other.

The average over K periods keeps signal and repeatable misfit; the differences of successive periods know only the
noise (von Neumann: blind to slow drift). The two are never mixed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray, longest_run
from identification.errors import RecordingError
from identification.recordings.labels import SAME_MOTION
from identification.recordings.recording import Recording
from identification.remembered import once_per_object
from identification.signals.filter_ends import at_filter_ends, cutoff_hz
from identification.signals.finer_grid import ON_THE_ROWS, FinerGrid, at_moments, finer_grid_of
from identification.signals.gaps import median_over_periods, wrapped_fill

LARGEST_SHARE_WITHOUT_DATA = 0.02
LARGEST_GAP_WITHOUT_DATA_S = 0.05
# Time stamps further than this from the grid (in samples) are brought onto it along the local slope.
SMALLEST_SHIFT = 0.02
TRANSIENT_FACTOR = 10.0
# Parts of a period that are asked whether they come at their time; the share of what periods differ by that shifts in
# time have to explain before they are believed; by how much (s, and not less than a sample) a part may come early or
# late: up to there what the periods differ by stands in the deviations of the parameters, which are no further off;
# part of a segment's ordinary motion that it has to show.
_PARTS, _EXPLAINED, LARGEST_SHIFT_S, _LEAST_MOTION = 20, 0.5, 3e-3, 0.1


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class PeriodTable:
    """Position and torque laid out by period and sample, nan where a sample is missing.

    position, torque: (K, M, n) rad, Nm. periods: (K,) their numbers in the recording. period_s: s.
    notes: sentences on what was left out. filtered_hz: cutoff of a low-pass that the torque went through before, None
    where its noise shows none. finer: the grid on which a model of it is evaluated.
    """

    position: FloatArray
    torque: FloatArray
    periods: IntArray
    period_s: float
    notes: tuple[str, ...] = ()
    filtered_hz: float | None = None
    finer: FinerGrid = ON_THE_ROWS

    @property
    def sampling_period_s(self) -> float:
        """Distance of the samples, s."""
        return self.period_s / int(self.position.shape[1])


@dataclass(frozen=True, slots=True)
class PeriodAverage:
    """The mean period and what the periods say about noise.

    position, torque: (M, n) mean over the periods that have the sample. counts: (M,) how many had it.
    filled: (M,) samples that no period had, interpolated along the period. periods: number K of periods.
    torque_spectrum, position_spectrum: (M // 2 + 1, n) variance of the noise of ONE period per spectral line, in the
    units of a white noise's variance (Nm², rad²), from successive differences; None for a single period.
    torque_noise_nm: (n,) standard deviation of one sample of one period, nan for a single period.
    noise_freedom: degrees of freedom of a line's noise variance, inf for a single period. filtered_hz, finer: as in
    `PeriodTable`.
    """

    position: FloatArray
    torque: FloatArray
    counts: IntArray
    filled: BoolArray
    periods: int
    period_s: float
    torque_spectrum: FloatArray | None
    position_spectrum: FloatArray | None
    torque_noise_nm: FloatArray
    noise_freedom: float = float("inf")
    notes: tuple[str, ...] = ()
    filtered_hz: float | None = None
    finer: FinerGrid = ON_THE_ROWS

    @property
    def sampling_period_s(self) -> float:
        """Distance of the samples, s."""
        return self.period_s / int(self.position.shape[0])


@once_per_object
def period_table(recording: Recording) -> PeriodTable:
    """Lay a periodic recording out by period and sample.

    Labels that the run itself wrote are taken as they are. Labels by time stamps are refined: a stamp that is off the
    grid moves the value along the local slope onto it; rows that slide along the period are read at the moments of the
    grid by a spline. Of several periods, a first one that differs from the others ten times as much as they differ
    among themselves (the transient of a start) is left out.
    Raises RecordingError when the recording has no period labels, or the motion does not repeat with the stated period.
    """
    if recording.period_index is None or recording.sample_in_period is None:
        raise RecordingError.at(
            recording.source.path,
            "states no period; give period_s, or use the pipeline for aperiodic recordings",
            field="period_s",
        )
    assert recording.period_s is not None
    assert recording.samples_per_period is not None
    inside = recording.period_index >= 0
    numbers, row = np.unique(recording.period_index[inside], return_inverse=True)
    sample = recording.sample_in_period[inside]
    if numbers.size == 0 or int(sample.max()) >= recording.samples_per_period:
        raise RecordingError.at(
            recording.source.path,
            f"its period labels do not fit {recording.samples_per_period} samples per period",
            field="sample_in_period",
        )
    shape = (numbers.size, recording.samples_per_period, recording.n)
    offset_s = np.zeros(recording.samples) if recording.labelled_by_run else _offset_s(recording)
    step_s = recording.period_s / recording.samples_per_period
    finer = ON_THE_ROWS if recording.labelled_by_run else finer_grid_of(recording, offset_s[inside] / step_s)
    values = [recording.position, recording.torque]
    if finer.factor > 1:
        moments = (
            recording.time[inside][0]
            - offset_s[inside][0]
            + step_s * ((numbers - numbers[0])[:, None] * shape[1] + np.arange(shape[1]) - sample[0])
        )
        position, torque = (at_moments(recording.time, value, moments.ravel()).reshape(shape) for value in values)
    else:
        if np.abs(offset_s).max() > SMALLEST_SHIFT * step_s:
            values = [value - offset_s[:, None] * np.gradient(value, recording.time, axis=0) for value in values]
        position, torque = np.full((2, *shape), np.nan)
        position[row, sample], torque[row, sample] = (value[inside] for value in values)
    notes: list[str] = []
    keep = np.ones(numbers.size, dtype=np.bool_)
    coverage = np.isfinite(position[:, :, 0]).mean(axis=1)
    if np.any(coverage < 0.5) and np.any(coverage >= 0.5):
        keep = coverage >= 0.5
        notes.append(f"{int((~keep).sum())} of {numbers.size} periods hold less than half of their samples; left out")
    if not recording.labelled_by_run:
        keep &= ~_transient(position, keep, notes)
    filtered_hz = cutoff_hz(torque[keep], recording.period_s / torque.shape[1])
    if filtered_hz is not None:
        keep[keep] = ~_at_filter_ends(recording, numbers[keep], filtered_hz, notes)
    position, torque, numbers = position[keep], torque[keep], numbers[keep]
    _check_repetition(recording, position)
    if not recording.labelled_by_run and (late := _not_simultaneous(recording, position, numbers)):
        notes.append(late)
    return PeriodTable(position, torque, numbers, recording.period_s, tuple(notes), filtered_hz, finer)


@once_per_object
def average_periods(table: PeriodTable) -> PeriodAverage:
    """Average over periods; a missing sample is left out of that sample's mean, and its count says so.

    Samples that no period has are interpolated along the (wrapped) period when they are few: at most 2 % of the period
    and no hole longer than 50 ms; otherwise RecordingError. They count as interpolated in `filled`.
    """
    present = np.isfinite(table.position[:, :, 0]) & np.isfinite(table.torque[:, :, 0])
    counts = present.sum(axis=0)
    filled = counts == 0
    notes = list(table.notes)
    if filled.any():
        longest = _longest_run(filled) * table.sampling_period_s
        if filled.mean() > LARGEST_SHARE_WITHOUT_DATA or longest > LARGEST_GAP_WITHOUT_DATA_S:
            first = int(np.flatnonzero(filled)[0])
            raise RecordingError(
                f"{int(filled.sum())} of {filled.size} samples of the period are missing in every period (first: "
                f"sample {first}, longest hole {longest:.3g} s); record at least one period more"
            )
        notes.append(f"samples of the period that are missing in every period: {int(filled.sum())}; interpolated")
    elif np.any(counts < present.shape[0]):
        notes.append(
            f"samples that are missing in single periods: {int((present.shape[0] - counts).sum())}; "
            "each sample's mean is over the periods that have it"
        )
    position, torque = (
        wrapped_fill(np.where(present[..., None], values, 0.0).sum(axis=0) / np.maximum(counts, 1)[:, None], filled)
        for values in (table.position, table.torque)
    )
    several = present.shape[0] > 1
    return PeriodAverage(
        position=position,
        torque=torque,
        counts=counts.astype(np.int64),
        filled=filled,
        periods=present.shape[0],
        period_s=table.period_s,
        torque_spectrum=_noise_spectrum(table.torque, present) if several else None,
        position_spectrum=_noise_spectrum(table.position, present) if several else None,
        torque_noise_nm=_noise_deviation(table.torque, present),
        noise_freedom=_noise_freedom(present.shape[0]),
        notes=tuple(notes),
        filtered_hz=table.filtered_hz,
        finer=table.finer,
    )


def _at_filter_ends(recording: Recording, numbers: IntArray, cutoff: float, notes: list[str]) -> BoolArray:
    """Marks periods that reach to where a filter of that cutoff (Hz) had not settled.

    Whole ones: what fills a part of a filtered period has lines that the filter took from all others.
    """
    assert recording.period_index is not None
    said = f"the torque was filtered at about {cutoff:.2g} Hz before: nothing above half of that is compared"
    ends = at_filter_ends(recording.time, cutoff)
    marked = np.isin(numbers, recording.period_index[ends])
    if not marked.any() or numbers.size - int(marked.sum()) < 2:
        notes.append(said)
        return np.zeros(numbers.size, dtype=np.bool_)
    notes.append(
        f"{said}; {int(marked.sum())} periods reach to the ends of the recording, where such a filter has not settled; "
        "left out"
    )
    return marked


def _offset_s(recording: Recording) -> FloatArray:
    """(N,) s by which the stamps of labelled rows come behind the moments of their samples, by all of them together."""
    assert recording.period_index is not None
    assert recording.sample_in_period is not None
    assert recording.period_s is not None
    assert recording.samples_per_period is not None
    step = recording.period_s / recording.samples_per_period
    place = recording.period_index * recording.period_s + recording.sample_in_period * step
    inside = recording.period_index >= 0
    offset = recording.time - place
    return np.asarray(np.where(inside, offset - np.median(offset[inside]), 0.0))


def _transient(position: FloatArray, keep: BoolArray, notes: list[str]) -> BoolArray:
    """Marks the first kept period if it is the transient of a start: far from the mean of the others."""
    marked = np.zeros(keep.size, dtype=np.bool_)
    kept = np.flatnonzero(keep)
    if kept.size < 4:
        return marked
    middle = median_over_periods(position[kept[1:]])
    distance = np.sqrt(np.nanmean((position[kept] - middle) ** 2, axis=(1, 2)))
    if distance[0] > 1e-4 and distance[0] > TRANSIENT_FACTOR * float(np.median(distance[1:])):
        marked[kept[0]] = True
        notes.append(
            f"the first period differs from the others by {distance[0]:.2g} rad (RMS), they among themselves by "
            f"{float(np.median(distance[1:])):.2g} rad: the transient of the start, left out"
        )
    return marked


def _check_repetition(recording: Recording, position: FloatArray) -> None:
    if position.shape[0] < 2:
        return
    difference = float(np.sqrt(np.nanmean(np.diff(position, axis=0) ** 2) / 2.0))
    motion = float(np.sqrt(np.nanmean((position - np.nanmean(position, axis=(0, 1))) ** 2)))
    if difference > SAME_MOTION * motion:
        raise RecordingError.at(
            recording.source.path,
            f"the motion does not repeat every {recording.period_s:g} s: successive periods "
            f"differ by {difference:.3g} rad where the motion itself is {motion:.3g} rad (RMS)",
            field="period_s",
        )


def _not_simultaneous(recording: Recording, position: FloatArray, numbers: IntArray) -> str:
    """A warning where parts of single periods come early or late: their mean is of no motion that was.

    Rows that are missing while the time stamps hide it do that. Empty where shifts in time do not explain what the
    periods differ by. No reason to do without periods: straight across what is missing the parameters are further off
    than by the mean, whose deviations hold part of it. position: (K, M, n), laid out by time stamps. numbers: (K,) of
    the periods, from 0.
    """
    assert recording.period_s is not None
    middle = median_over_periods(position)
    speed = np.nan_to_num(np.roll(middle, -3, axis=0) - np.roll(middle, 3, axis=0)) / 6.0  # rad per sample
    difference = position - middle
    # Of one joint alone all that differs slowly is its motion at another time; that it stands elsewhere is not.
    moved = np.nan_to_num(difference - np.nanmean(difference, axis=1, keepdims=True))
    parts = np.arange(0, middle.shape[0], -(-middle.shape[0] // _PARTS))
    along = np.add.reduceat((speed**2).sum(axis=1), parts)
    moving = along > _LEAST_MOTION * along.mean()

    def shift_of(values: FloatArray) -> FloatArray:
        return np.asarray(
            np.add.reduceat(np.einsum("kmn,mn->km", values, speed), parts, axis=1)[:, moving] / along[moving]
        )

    if not (shift_of(moved) ** 2 * along[moving]).sum() > _EXPLAINED * float((moved**2).sum()):
        return ""
    shift = shift_of(np.nan_to_num(difference))
    period, part = np.unravel_index(int(np.argmax(np.abs(shift))), shift.shape)
    step = recording.period_s / middle.shape[0]
    largest_s = step * float(np.abs(shift[period, part]))
    if largest_s <= max(LARGEST_SHIFT_S, step):
        return ""
    return (
        f"WARNING, parts of its periods of {recording.period_s:.7g} s do not come at their times: the motion "
        f"{step * parts[moving][part]:.3g} s into period {int(numbers[period]) + 1} is {1e3 * largest_s:.3g} ms off. "
        "Rows may be missing there that the time stamps hide, or the arm followed later than in other periods"
    )


def _longest_run(marked: BoolArray) -> int:
    """Longest run of marked samples on the wrapped period."""
    if marked.all():
        return int(marked.size)
    return longest_run(np.roll(marked, -int(np.flatnonzero(~marked)[0])))


def _successive_differences(values: FloatArray, present: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Differences of neighbouring periods (K − 1, M, n), zero where either sample is missing, and where both exist."""
    both = present[1:] & present[:-1]
    return np.where(both[..., None], np.diff(np.nan_to_num(values), axis=0), 0.0), both


def _noise_deviation(values: FloatArray, present: BoolArray) -> FloatArray:
    if present.shape[0] < 2:
        return np.full(values.shape[2], np.nan)
    difference, both = _successive_differences(values, present)
    return np.asarray(np.sqrt((difference**2).sum(axis=(0, 1)) / (2.0 * max(1, int(both.sum())))), dtype=np.float64)


def _noise_freedom(periods: int) -> float:
    """Degrees of freedom of the variance that K − 1 successive differences of a line and its neighbours give.

    Successive differences share a period, so d of them are worth 2 d²/(3 d − 1) independent ones; a line has two
    parts, cosine and sine, and at least 2 · 3 + 1 lines are averaged.
    """
    differences = periods - 1
    if differences < 1:
        return float("inf")
    return 2.0 * 7.0 * 2.0 * differences**2 / (3.0 * differences - 1.0)


def _noise_spectrum(values: FloatArray, present: BoolArray) -> FloatArray:
    """E|T_{k+1} − T_k|² / 2 per line, scaled so that white noise of variance s² gives s² on every line.

    Smoothed over ± max(3, 10 %) lines; line 0 (the mean, where drift gathers) stands for itself.
    """
    difference, both = _successive_differences(values, present)
    samples = values.shape[1]
    covered = np.maximum(both.mean(axis=1), 1.0 / samples)[:, None, None]
    power = (np.abs(np.fft.rfft(difference, axis=1)) ** 2 / (2.0 * samples) / covered).mean(axis=0)
    smooth = smooth_over_lines(power)
    if difference.shape[0] < 4:  # too few differences to say anything about one line alone
        smooth[0] = np.maximum(smooth[0], smooth[1])
    return smooth


def smooth_over_lines(power: FloatArray) -> FloatArray:
    """Running mean over ± max(3, 10 %) lines along axis 0, line 0 left as it is. power: (lines, …)."""
    lines = power.shape[0]
    if lines < 2:
        return power.copy()
    total = np.concatenate([np.zeros((1, *power.shape[1:])), np.cumsum(power, axis=0)])
    number = np.arange(1, lines)
    half = np.maximum(3, number // 10)
    low = np.maximum(1, number - half)
    high = np.minimum(lines - 1, number + half)
    result = power.copy()
    result[1:] = (total[high + 1] - total[low]) / (high + 1 - low)[:, None]
    return result
