"""Which period and which sample of it a row belongs to, by the run's own labels or by the stated period."""

from __future__ import annotations

from typing import Any

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.errors import RecordingError
from identification.recordings.recording import Finding
from identification.recordings.table import RawTable

SAME_MOTION = 0.1
"""Share of a motion (RMS) by which positions may differ that are of one and the same: a period later, or of a copy."""
SAME_SAMPLES = 0.9
"""Share of the rows of a slower source that are at the same samples of each period: others are late ones."""
SMALLEST_COVERAGE = 0.5
LARGEST_ERROR_OF_PERIOD = 0.05
"""Share by which a stated period may be off and still be the one that is meant."""
SMALLEST_SLIDE = 0.2
"""Samples by which rows have to slide along the period in all: less does not matter to a mean over periods."""
EXPLAINED = 0.75
"""Share of what periods differ by (in squares) that a shift has to take away: noise leaves all of it, missing rows half
of it over half of the recording.
"""
STANDS, RESTS = 0.05, 0.005
"""Share of a joint's motion (standard deviation) up to which it still is where the recording began, or where it ends;
and up to which half of these rows are, if it stands there and does not only pass."""
LEAST_OF_MOTION = 0.01
"""Of the largest joint's motion: what moves less is no more than its noise, and counts by this."""
_ROUNDS, _ROWS = 8, 20_000


def labels_of_the_run(table: RawTable, keep: BoolArray, every: int, findings: list[Finding]) -> dict[str, Any]:
    """Period labels that the run itself wrote, of the rows kept. Of a source that brings news once in `every` rows the
    same samples of each period are left, and are counted anew; where they are others in each period, there are none.
    """
    assert table.period_index is not None
    assert table.sample_in_period is not None
    period_index, sample = table.period_index[keep], table.sample_in_period[keep]
    per_period = table.samples_per_period or int(sample.max()) + 1
    if every > 1:
        place = sample[period_index >= 0] % every
        usual = int(np.bincount(place).argmax()) if place.size else 0
        if per_period % every or float((place == usual).mean()) < SAME_SAMPLES:
            sentence = (
                f"a source that brings news once in {every} rows is at other samples of the {per_period} in each "
                "period; it is used as not periodic"
            )
            findings.append(Finding.of_all("periods_not_used", keep.size, sentence))
            return {}
        other = (period_index < 0) | (sample % every != usual)
        period_index, sample = np.where(other, -1, period_index), np.where(other, -1, sample // every)
        per_period //= every
    return {
        "period_index": period_index,
        "sample_in_period": sample,
        "period_s": table.period_s,
        "samples_per_period": per_period,
    }


def labels_of_a_stated_period(
    table: RawTable,
    time: FloatArray,
    position: FloatArray,
    sampling_period_s: float,
    findings: list[Finding],
    rows: int,
) -> dict[str, Any]:
    """Period labels from the stated period, or from the one near it with which the motion repeats."""
    assert table.period_s is not None
    if not np.isfinite(table.period_s) or table.period_s < 0.0:
        raise RecordingError.named(
            table.path,
            f"period_s is {table.period_s:g}; it is a time in seconds, or 0 for a recording that is not periodic",
        )
    if _is_short(time, table.period_s, findings, rows):
        return {}
    period_s = repeating_period(time, position, table.period_s, sampling_period_s)
    if period_s != table.period_s:
        off = 100.0 * abs(period_s / table.period_s - 1.0)
        sentence = (
            f"by its stamps the motion repeats every {period_s:.7g} s, not every {table.period_s:.7g} s as stated; "
            f"that is taken. Else the clock is {off:.2g} % off, or the arm follows later and later"
        )
        findings.append(Finding.of_all("other_period", rows, sentence))
    standing = standing_apart(time, position, period_s)
    if standing.any():
        sentence = (
            f"before the motion or after it the arm stands for {standing.sum() * sampling_period_s:.3g} s; the periods "
            "are taken without that"
        )
        findings.append(Finding.of_all("standing_ends", rows, sentence))
    moving = time[~standing]
    if _is_short(moving, period_s, findings, rows):
        return {}
    # Of coarse stamps (3, 3, 4 ms) and of late ones the mean step is the true one, of rows with a gap the median.
    steps = np.unique([sampling_period_s, (moving[-1] - moving[0]) / (moving.size - 1)])
    choices = [label_by_time(moving, period_s, float(step)) for step in steps]
    period_index, sample = np.full((2, time.size), -1, dtype=np.int64)
    period_index[~standing], sample[~standing], per_period = min(choices, key=unfilled)
    return {
        "period_index": period_index,
        "sample_in_period": sample,
        "period_s": float(period_s),
        "samples_per_period": per_period,
    }


def _is_short(time: FloatArray, period_s: float, findings: list[Finding], rows: int) -> bool:
    """Whether the motion covers less than its stated period, which joins `findings`."""
    if time[-1] - time[0] >= 0.99 * period_s:
        return False
    sentence = (
        f"the motion covers {time[-1] - time[0]:.4g} s of a stated period of {period_s:.4g} s; it is used as not "
        "periodic"
    )
    findings.append(Finding.of_all("short_of_a_period", rows, sentence))
    return True


def repeating_period(time: FloatArray, position: FloatArray, period_s: float, sampling_period_s: float) -> float:
    """The period with which a motion repeats, s, near a stated one; the stated one where no other is clearly better.

    time: (N,) s; position: (N, n) rad (m). A stated period that is rounded, of a clock that runs otherwise, or wrong by
    a little lays every later period further off, and their mean is of no motion that was driven. Asked from one period
    to the next first, then over twice as many each time: the further apart, the sharper. Not of rows at either end that
    the arm stands in.
    """
    there = in_its_own_motion(position)
    moving = slice(*_ends_of_motion(there))
    time, there = time[moving], there[moving]
    last = round((time[-1] - time[0]) / period_s) - 1
    if last < 1:
        return period_s
    rows = np.arange(0, time.size, -(-time.size // _ROWS))
    period = period_s
    for apart in sorted({*(2**power for power in range(last.bit_length())), last}):
        for _ in range(_ROUNDS):
            shift = _difference(time, there, rows, apart * period, sampling_period_s)[0]
            period -= shift / apart
            if abs(shift) < 2e-5 * sampling_period_s:
                break
        if abs(period - period_s) > LARGEST_ERROR_OF_PERIOD * period_s:
            return period_s
    if last * abs(period - period_s) < SMALLEST_SLIDE * sampling_period_s:
        return period_s
    for apart in {(last + 1) // 2, last}:
        left = [_difference(time, there, rows, apart * each, sampling_period_s)[1] for each in (period_s, period)]
        if left[1] > (1.0 - EXPLAINED) * left[0]:
            return period_s
    return period


def standing_apart(time: FloatArray, position: FloatArray, period_s: float) -> BoolArray:
    """(N,) rows at either end in which the arm stands, though it moves there a period later, or earlier.

    Whoever records by hand begins before the motion and ends after it. A motion that rests in every period is kept.
    """
    there = in_its_own_motion(position)
    marked = np.zeros(time.size, dtype=np.bool_)
    begins, ends = _ends_of_motion(there)
    for rows, row, apart_s in ((slice(0, begins), 0, period_s), (slice(ends, None), -1, -period_s)):
        elsewhere = np.column_stack([np.interp(time[rows] + apart_s, time, q) for q in there.T])
        away = np.abs(there[rows] - there[row]).max(axis=1)
        stands = away.size > 0 and float(np.median(away)) < RESTS
        if stands and bool((np.abs(elsewhere - there[rows]) > STANDS).any()):
            # What is further away than noise, next to the motion, is its slow begin, or its slow end.
            resting = np.flatnonzero(away < RESTS)
            marked[slice(0, resting[-1] + 1) if row == 0 else slice(ends + resting[0], None)] = True
    return marked


def in_its_own_motion(position: FloatArray) -> FloatArray:
    """Positions (N, n) in standard deviations of the joint's own motion."""
    deviation = position.std(axis=0)
    smallest = max(LEAST_OF_MOTION * float(deviation.max()), float(np.finfo(np.float64).tiny))
    return np.asarray(position / np.maximum(deviation, smallest))


def _ends_of_motion(there: FloatArray) -> tuple[int, int]:
    """The first row that is not where the recording begins, and behind the last that is not where it ends.

    All rows where nothing lies between: an arm that stands, or only once goes to another place.
    """
    begun, going = (np.flatnonzero((np.abs(there - there[row]) > STANDS).any(axis=1)) for row in (0, -1))
    between = begun.size and going.size and begun[0] <= going[-1]
    return (int(begun[0]), int(going[-1]) + 1) if between else (0, len(there))


def _difference(
    time: FloatArray, position: FloatArray, rows: IntArray, apart_s: float, sampling_period_s: float
) -> tuple[float, float]:
    """By how much (s) the motion comes early where it is read `apart_s` later, and the mean square between both."""
    rows = rows[time[rows] + apart_s <= time[-1]]
    later = time[rows] + apart_s
    behind = np.clip(np.searchsorted(time, later), 1, time.size - 1)
    whole = time[behind] - time[behind - 1] < 1.5 * sampling_period_s  # not across a gap
    rows, later = rows[whole], later[whole]
    if not rows.size:
        return 0.0, 0.0
    width = 3.0 * sampling_period_s
    at = [
        np.column_stack([np.interp(when, time, q) for q in position.T])
        for when in (later, later - width, later + width)
    ]
    difference, speed = at[0] - position[rows], (at[2] - at[1]) / (2.0 * width)
    size = float((speed**2).sum())
    return float((difference * speed).sum()) / size if size > 0.0 else 0.0, float((difference**2).mean())


def label_by_time(time: FloatArray, period_s: float, sampling_period_s: float) -> tuple[IntArray, IntArray, int]:
    """Period and sample number of each row, by rounding time onto the grid of M = round(period / sampling period).

    time: (N,) s; the first row is sample 0 of period 0. Returns (period_index, sample_in_period, M). Where two rows of
    one period fall on the same sample, the nearer one is kept and the other gets the label -1. Rows of a last period
    that is less than half covered get the label -1 too.
    """
    per_period = max(1, round(period_s / sampling_period_s))
    place = (time - time[0]) / period_s * per_period
    grid = np.rint(place).astype(np.int64)
    order = np.lexsort((np.abs(place - grid), grid))
    first_of_each = np.ones(time.size, dtype=np.bool_)
    first_of_each[order[1:]] = grid[order[1:]] != grid[order[:-1]]
    period_index = grid // per_period
    sample = grid % per_period
    period_index[~first_of_each] = -1
    last = int(period_index.max())
    if last > 0 and int((period_index == last).sum()) < SMALLEST_COVERAGE * per_period:
        period_index[period_index == last] = -1
    sample[period_index < 0] = -1
    return period_index, sample, per_period


def unfilled(labels: tuple[IntArray, IntArray, int]) -> int:
    """How many rows have no label, and samples of all periods no row."""
    period_index, _, per_period = labels
    labelled = int((period_index >= 0).sum())
    return period_index.size - labelled + per_period * (int(period_index.max()) + 1) - labelled
