"""Does a recording stand in another one with fewer decimals? Its motion and its torques then agree with the other's
row by row to within the last decimals of one of the two, as no second run of a motion does: noise comes about once.

Rows are laid beside each other by their time stamps, at the shift of the clock that most rows of equal numbers show, so
that cuts, thinned copies and copies with lost rows agree as well. Pure.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray, runs_of
from identification.recordings.recording import Recording
from identification.remembered import once_per_object

SMALLEST_STEP = 1e-6
"""Of a column's largest number, and of one: decimals beyond are those of the storage, not of who wrote the file."""
FEWEST_ROWS = 10
"""Moving rows in common that are no accident, at least: of two recordings, or of two places in one."""
ODDS = 1000.0
"""To one, against as many rows that agree one after the other by chance."""
HALF = 0.52
"""Of a step, by which a rounded number may differ: a half, and what the last digit of a float adds."""
UNITS = (1.0, np.pi / 180.0, 2.0 * np.pi)
"""Of written decimals: those of a recording's own unit, degrees and turns."""
CELL = 4.0
"""Steps in which numbers are called equal where shifts of the clock are looked for: few numbers lie at an edge."""
MOST_PAIRS = 1_000_000
KEPT_ROWS = 256
"""Of a recording in the file of a model: a cut of a twentieth still holds FEWEST_ROWS of them."""


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Moving rows of a recording: time (N,) s, values (N, 2n) positions and torques, step (2n,): each one's last
    decimal, sampling_period_s of the recording.
    """

    time: FloatArray
    values: FloatArray
    step: FloatArray
    sampling_period_s: float

    def to_text(self) -> str:
        """KEPT_ROWS of them in single precision, drawn at even odds: even distances could miss a thinned copy's."""
        kept = np.arange(len(self.time))
        if len(kept) > KEPT_ROWS:
            # Raw bits of a generator are the same in every version of NumPy.
            kept = np.sort(np.argsort(np.random.PCG64(0).random_raw(len(kept)))[:KEPT_ROWS])
        period_s = self.sampling_period_s
        table = np.vstack([[period_s, *self.step], np.column_stack([self.time / period_s, self.values])[kept]])
        return f"{table.shape[1]} {base64.b64encode(table.astype('<f4').tobytes()).decode()}"

    @classmethod
    def from_text(cls, text: str) -> Rows:
        """What `to_text` wrote. Raises ValueError for any other text."""
        columns, _, numbers = text.partition(" ")
        table = np.frombuffer(base64.b64decode(numbers, validate=True), "<f4").astype(np.float64)
        table = table.reshape(-1, int(columns))
        return cls(table[1:, 0] * table[0, 0], table[1:, 1:], table[0, 1:], float(table[0, 0]))


@once_per_object
def moving_rows(recording: Recording) -> Rows:
    """Those rows of a recording whose position differs from the row before, with the last decimals of each column."""
    values = np.concatenate([recording.position, recording.torque], axis=1)
    moving = (np.diff(recording.position, axis=0, prepend=recording.position[:1]) != 0.0).any(axis=1)
    step = np.array([last_decimal(column) for column in values.T])
    return Rows(recording.time[moving], values[moving], step, recording.sampling_period_s)


def last_decimal(numbers: FloatArray) -> float:
    """The step in which numbers (N,) are written, in one of UNITS; SMALLEST_STEP of them where decimals are finer.

    With a fixed number of digits the step is that of the largest: each power of ten is looked at by itself.
    """
    smallest = SMALLEST_STEP * max(1.0, float(np.abs(numbers).max(initial=0.0)))
    distinct = np.unique(np.abs(numbers))
    distinct = distinct[distinct > smallest]
    decade = np.floor(np.log10(distinct))
    steps = [smallest]
    for each in np.unique(decade):
        those = distinct[decade == each]
        if len(those) < FEWEST_ROWS:
            continue
        asked = np.array([unit * 10.0**-place for unit in UNITS for place in range(-1, 7)])
        for some in (those[:FEWEST_ROWS], those):  # a few numbers tell of nearly every step that it is none
            parts = some[:, None] / asked
            asked = asked[(np.abs(parts - np.maximum(np.rint(parts), 1.0)) < HALF - 0.5).all(axis=0)]
        # Numbers near one and the same multiple, as those of a largest torque of 10.1 Nm, tell of no step.
        steps += [each for each in asked.tolist() if np.unique(np.rint(those / each)).size >= FEWEST_ROWS]
    return max(steps)


def rows_that_agree(rows: Rows, recording: Recording) -> int:
    """How many moving rows, one after the other, a recording has as well, to within the last decimals of one of them.

    0 where that may be chance: where rows one sample apart agree as often, or the other rows of the two.
    """
    others = moving_rows(recording)
    thin, dense = (rows, others) if len(rows.time) <= len(others.time) else (others, rows)
    if rows.values.shape[1] != others.values.shape[1] or len(thin.time) < FEWEST_ROWS:
        return 0
    step, finer = np.maximum(rows.step, others.step), np.minimum(rows.step, others.step)
    # Of two copies with decimals of their own both are rounded; two runs on one sensor have the same steps.
    near_enough = HALF * np.where(np.isclose(finer, step), step, step + finer)
    shift = _shift_of_clock(thin, dense, step)
    if shift is None:
        return 0
    time, near = thin.time + shift, 0.5 * min(rows.sampling_period_s, others.sampling_period_s)
    place = np.minimum(np.searchsorted(dense.time, time - near), len(dense.time) - 1)
    met = np.abs(dense.time[place] - time) <= near
    place, values = place[met], thin.values[met]

    def agree(apart: int) -> BoolArray:
        beside = dense.values[np.clip(place + apart, 0, len(dense.time) - 1)]
        return np.asarray((np.abs(beside - values) <= near_enough).all(axis=1))

    here = agree(0)
    first, last = max(runs_of(here).tolist(), key=lambda ends: ends[1] - ends[0], default=(0, 0))
    length = last - first
    if length < FEWEST_ROWS:
        return 0
    run = np.zeros_like(here)
    run[first:last] = True
    followed = (here & ~run)[:-1]  # rows that agree by chance are alone, or the data change little from row to row
    chance = [share_of(agree(apart)[run]) for apart in (-1, 1)]
    chance += [] if run.all() else [share_of((here & ~run)[1:][followed])]
    tried = len(thin.time) * len(dense.time)  # places to begin at, and shifts
    return length if is_no_chance(length, max(chance), tried) else 0


def is_no_chance(length: int, chance: float, tried: int) -> bool:
    """Whether rows that agree one after the other are more than one of so many tries has, each by a chance."""
    return bool(-length * np.log(chance) > np.log(ODDS * tried))


def share_of(true: BoolArray) -> float:
    """Of true values, with the one half that is thought of where there are none."""
    return float((true.sum() + 1) / (true.size + 2))


def _shift_of_clock(thin: Rows, dense: Rows, step: FloatArray) -> float | None:
    """Time of the dense rows minus that of the thin ones, s, at which most have the same numbers; None where none."""
    known, asked = (_cells(rows.values, CELL * step) for rows in (dense, thin))
    order = np.argsort(known, kind="stable")
    first, last = (np.searchsorted(known[order], asked, side) for side in ("left", "right"))
    number = last - first
    rare = np.argsort(np.where(number > 0, number, len(known) + 1), kind="stable")
    rare = rare[(number[rare] > 0) & (np.cumsum(number[rare]) <= MOST_PAIRS)]
    if not rare.size:
        return None
    thins = np.repeat(rare, number[rare])
    within = np.arange(len(thins)) - np.repeat(np.cumsum(number[rare]) - number[rare], number[rare])
    shifts = dense.time[order[np.repeat(first[rare], number[rare]) + within]] - thin.time[thins]
    shifts = np.sort(shifts)
    # The shift that has most others within one sampling period behind it.
    behind = np.searchsorted(shifts, shifts + 0.5 * dense.sampling_period_s) - np.arange(len(shifts))
    best = int(np.argmax(behind))
    return float(np.median(shifts[best : best + int(behind[best])]))


def _cells(values: FloatArray, width: FloatArray) -> IntArray:
    """One number for each row of values (N, m); rows in the same cells have the same."""
    return row_codes(np.rint(values / width).astype(np.int64))


def row_codes(numbers: IntArray) -> IntArray:
    """One number for each row of integers (N, m); equal rows have equal ones.

    Odd multipliers: sums wrap around at 2⁶⁴, and no number of a row is lost. Models keep such sums: raw bits of a
    generator are the same in every version of NumPy, what it draws from them need not be.
    """
    multipliers = (np.random.PCG64(0).random_raw(numbers.shape[1]) | np.uint64(1)).view(np.int64)
    with np.errstate(over="ignore"):
        return np.asarray((numbers * multipliers).sum(axis=1), dtype=np.int64)
