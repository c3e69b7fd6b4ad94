"""Rows of a controller's own even clock, stamped by somebody whose clock trembles.

A logger writes down when a row reached it. Where the controller samples evenly, the way that the joints go from row to
row says how many of its cycles lie between them: none (the row before once more), one, or more where rows are lost. So
the positions themselves tell whether the rows are even and the stamps tremble, or the stamps are right: with the times
that are right, what the neighbours of a row foretell of its position is nearer to it. A velocity or acceleration by
trembling stamps is noise, and looks like torque that comes late, or rings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray, runs_of
from identification.recordings.labels import in_its_own_motion

_EVEN = 0.02
"""Part of the sampling period that stamps of an even clock are off a whole number of periods at most."""
_NEARER = 0.5
"""Part of the distance to what the neighbours foretell, in the middle, that may be left by the times that are taken."""
_SLOW = 0.05
"""Part of the RMS speed below which the way between two rows does not tell the time between them; the stamps do."""
_FARTHEST = 3.0
"""Periods (standard deviation) that the stamps may lie beside the even clock: else it is none that they followed."""
_WHOLE = 0.1
"""Part of a period by which the ways between rows miss whole cycles in the middle at most: of others it is 0.25."""
_TELLS = 14.0
"""Times its noise that a joint has to go in a cycle for the way to tell it: to a tenth, of two positions."""
_BESIDE, _ROUNDS = 8, 3
_CROWDED = 0.1
"""Share of the usual distance of two rows below which nobody can say when the second one was measured."""
CROWDED_ROW = "comes right behind another, which is when it arrived and not when it was measured; it was left out"


def crowded(time: FloatArray) -> BoolArray:
    """(N,) rows that come right behind the one before them; time: (N,) s, increasing."""
    return np.diff(time, prepend=-np.inf) < _CROWDED * np.median(np.diff(time))


@dataclass(frozen=True, slots=True)
class RowClock:
    """time: (N,) s of the even clock. again: (N,) rows of a cycle that the row before them is of already.

    period_s: of the clock. trembling_s: standard deviation of the stamps about it. missing: cycles without a row.
    """

    time: FloatArray
    again: BoolArray
    period_s: float
    trembling_s: float

    @property
    def missing(self) -> int:
        """How many cycles between the rows have none."""
        return round(float(np.ptp(self.time)) / self.period_s) + 1 - int((~self.again).sum())

    @property
    def sentence(self) -> str:
        """What was found, and what was done."""
        said = [
            f"between its rows the joints go as far as in whole cycles of {1e3 * self.period_s:.5g} ms, which the time "
            f"stamps follow to {1e3 * self.trembling_s:.2g} ms (standard deviation): the times of that even clock are "
            "taken"
        ]
        if self.missing:
            said.append(f"{self.missing} cycles have no row")
        if again := int(self.again.sum()):
            said.append(f"{again} rows are of the cycle of the row before, and left out")
        return "; ".join(said)


def row_clock(time: FloatArray, position: FloatArray) -> RowClock | None:
    """The even clock of rows with trembling stamps; None where the stamps are even, or nearer to the positions.

    time: (N,) s, increasing; position: (N, n) rad (m).
    """
    steps = np.diff(time)
    period_s = float(np.median(steps))
    if time.size < 8 * _BESIDE or np.abs(steps / period_s - np.rint(steps / period_s)).max() < _EVEN:
        return None
    there = in_its_own_motion(position - position.mean(axis=0))
    taken, noise = time, 0.0
    for _ in range(_ROUNDS):
        found = _cycles(time, taken, there, noise)
        if found is None:
            return None
        period_s, start_s = np.polyfit(found, time, 1)
        if not period_s > 0.0:
            return None
        taken, kept = start_s + period_s * found, np.diff(found, prepend=-1) > 0
        if kept.mean() < 0.5:  # a file written faster than its source, which is another finding
            return None
        even = _from_neighbours(taken[kept], there[kept])
        noise = float(np.median(even, axis=0).max() / period_s)
    trembling_s = float((time - taken).std())
    if trembling_s > _FARTHEST * period_s:
        return None
    stamped = _from_neighbours(time[kept], there[kept])
    if not np.median(even / np.maximum(np.median(stamped, axis=0), np.finfo(np.float64).tiny)) < _NEARER:
        return None
    return RowClock(taken, ~kept, float(period_s), trembling_s)


def _cycles(stamps: FloatArray, time: FloatArray, there: FloatArray, noise: float) -> IntArray | None:
    """(N,) cycle of each row, by the ways between rows and, where the arm is slow, by the stamps.

    None where it stands, or the ways are no whole numbers of cycles.
    time: (N,) s by which the speed is taken. noise: of the positions, in a cycle.
    """
    from scipy.ndimage import median_filter  # slow to load, and the stamps of most recordings are even

    speed = _speeds(time, there)
    speed = 0.5 * (speed[1:] + speed[:-1])
    square = (speed**2).sum(axis=1)
    tells = square > max(_SLOW**2 * square.mean(), (_TELLS * noise) ** 2)
    if not tells.any():
        return None
    between_s = np.where(tells, (np.diff(there, axis=0) * speed).sum(axis=1) / np.where(tells, square, 1.0), 0.0)
    moved = between_s[tells]
    period_s = float(np.median(moved[moved > 0.5 * np.median(moved)]))
    if not period_s > 0.0 or np.median(np.abs(moved / period_s - np.rint(moved / period_s))) > _WHOLE:
        return None
    # One cycle a row where the arm is slow, unless most stamps around say otherwise: single ones come late.
    steps = np.where(tells, np.maximum(np.rint(between_s / period_s), 0.0), 1.0).astype(np.int64)
    for first, last in runs_of(~tells):
        begins, ends = max(0, first - _BESIDE), min(stamps.size, last + _BESIDE + 1)
        late = stamps[begins:ends] - period_s * np.concatenate([[0], np.cumsum(steps[begins : ends - 1])])
        most = median_filter(late, 2 * _BESIDE + 1, mode="nearest")[first - begins : last - begins + 1]
        further = np.rint((most - most[0]) / period_s).astype(np.int64)
        steps[first:last] += np.diff(further)
        # What the rows behind the run lie behind those before it is not the run's own to say.
        longer = np.median(late[last - begins :]) - np.median(late[: first - begins + 1])
        steps[last - 1] += round(float(longer / period_s)) - further[-1]
    steps = np.maximum(steps, 0)
    return np.concatenate([[0], np.cumsum(steps)])


def _speeds(time: FloatArray, there: FloatArray) -> FloatArray:
    """(N, n) slope of the straight line through each row and those beside it."""
    rows, count = np.arange(time.size), 2 * _BESIDE + 1
    later = squares = np.zeros(time.size)
    further = products = np.zeros_like(there)
    for offset in range(-_BESIDE, _BESIDE + 1):
        other = np.clip(rows + offset, 0, time.size - 1)
        apart, way = time[other] - time, there[other] - there
        later, squares = later + apart, squares + apart**2
        further, products = further + way, products + apart[:, None] * way
    spread = np.maximum(squares - later**2 / count, np.finfo(np.float64).tiny)
    return (products - later[:, None] * further / count) / spread[:, None]


def _from_neighbours(time: FloatArray, there: FloatArray) -> FloatArray:
    """(N − 4, n) distance of each row from the cubic through the two rows before and the two behind it."""
    count = time.size - 4
    places = [time[offset : offset + count] for offset in range(5)]
    foretold = np.zeros((count, there.shape[1]))
    for one in (0, 1, 3, 4):
        weight = np.ones(count)
        for other in {0, 1, 3, 4} - {one}:
            weight *= (places[2] - places[other]) / (places[one] - places[other])
        foretold += weight[:, None] * there[one : one + count]
    return np.abs(there[2 : 2 + count] - foretold)
