"""Time stamps that are not even: how far rows lie apart, and how many are missing between them."""

from __future__ import annotations

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.recordings.leaps import GAP_FACTOR
from identification.recordings.recording import Finding

JITTER_SHARE = 0.05
"""Of the sampling period (standard deviation), above which stamps are uneven."""
_BESIDE = 16


def is_uneven(time: FloatArray) -> bool:
    """Whether the stamps (N,) s tremble, gaps not counted."""
    steps = np.diff(time)
    ordinary = steps[steps <= GAP_FACTOR * np.median(steps)]
    return bool(ordinary.size and np.std(ordinary) > JITTER_SHARE * np.median(steps))


def missing_rows(time: FloatArray) -> tuple[IntArray, float]:
    """(N − 1,) how many rows are missing between one row and the next, and the sampling period, s.

    time: (N,) s, increasing. Of even stamps, whatever is longer than one and a half of the median step holds missing
    rows. Uneven ones go that far by themselves, and come back: rows are missing only where those behind stay late, and
    the period is what they then count to.
    """
    steps = np.diff(time)
    period_s = float(np.median(steps))
    if not is_uneven(time):
        return np.where(steps > GAP_FACTOR * period_s, np.rint(steps / period_s - 1.0), 0.0).astype(np.int64), period_s
    missing = np.zeros(steps.size, dtype=np.int64)
    if time.size > 2 * _BESIDE:  # sharper than by one step, and right of coarse stamps (3, 3, 4 ms)
        period_s = float(np.median(time[_BESIDE:] - time[:-_BESIDE])) / _BESIDE
    late = (time - time[0]) / period_s - np.arange(time.size)
    by_gaps = np.zeros(time.size)  # of it what is missing before each row
    total = row = 0
    for step in np.flatnonzero(steps > GAP_FACTOR * period_s).tolist():
        by_gaps[row : step + 1], row = total, step + 1
        before = slice(max(0, row - _BESIDE), row)
        longer = np.median(late[row : row + _BESIDE]) - total - np.median(late[before] - by_gaps[before])
        missing[step] = max(0, round(float(longer)))
        total += int(missing[step])
    return missing, float((time[-1] - time[0]) / (steps.size + total))


def gaps_and_jitter(time: FloatArray, number: IntArray, every: int) -> tuple[float, list[Finding]]:
    """The sampling period, s, and what is said of stamps (N,) s of rows with these numbers in the file.

    every: of so many rows of the file one was kept, where the source is slower than the file.
    """
    steps, findings = np.diff(time), []
    missing, period_s = missing_rows(time)
    gaps = np.flatnonzero(missing)
    if gaps.size:
        left_out = int(np.clip(np.diff(number)[gaps] // every - 1, 0, missing[gaps]).sum())
        said = f"about {int(missing.sum())} samples missing"
        said += f", {left_out} of them rows that were left out" if left_out else ""
        longest = int(gaps[np.argmax(steps[gaps])])
        length = float(steps[longest])
        sentence = (
            f"{gaps.size} gap{'s' if gaps.size > 1 else ''} longer than {GAP_FACTOR} sampling periods of "
            f"{1e3 * period_s:.4g} ms, {said}; the longest lasts "
            f"{f'{length:.4g} s' if length >= 1.0 else f'{1e3 * length:.4g} ms'} after row {number[longest]}"
        )
        findings.append(Finding("gap", int(number[gaps[0]]), int(number[gaps[-1] + 1]), int(gaps.size), sentence))
    if is_uneven(time):
        between = steps[missing == 0]
        count = int((np.abs(between - period_s) > JITTER_SHARE * period_s).sum())
        sentence = (
            f"time stamps are uneven: steps between {1e3 * between.min():.4g} and {1e3 * between.max():.4g} ms "
            f"around {1e3 * period_s:.4g} ms (standard deviation {1e3 * float(np.std(between)):.2g} ms)"
        )
        findings.append(Finding("jitter", int(number[0]), int(number[-1]), count, sentence))
    return period_s, findings
