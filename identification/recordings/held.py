"""Rows that bring nothing new: single held samples, and a source slower than the file it was written to.

Loggers that run faster than a driver write its last values again and again. As positions such rows are a staircase,
whose derivative is no motion; rows with new values are honest. Which rows they are is decided here; `cleaning` asks.
"""

from __future__ import annotations

import numpy as np

from identification.arrays import BoolArray, FloatArray

__all__ = ["held_rows", "rows_of_a_slower_source"]

_TOGETHER = 0.7
"""Share of the moving channels that change in a row with news; of coarse sensors that repeat values, few do at once."""
_REGULAR = 0.9
"""Share of the steps from news to news that are within one row of the usual step."""


def rows_of_a_slower_source(position: FloatArray, torque: FloatArray) -> tuple[BoolArray, str, int]:
    """(R,) rows that repeat because q or tau comes from a slower source, which of them ("q", "tau"), rows per news.

    The slower of the two decides. position, torque: (R, n). No row, "" and 1 where neither is slower.
    """
    every_q, every_tau = _rows_per_news(position), _rows_per_news(torque)
    every = max(every_q, every_tau)
    if every < 2:
        return np.zeros(position.shape[0], dtype=np.bool_), "", 1
    name, values = ("q", position) if every_q >= every_tau else ("tau", torque)
    number = np.arange(values.shape[0])
    since = number - np.maximum.accumulate(np.where(_news(values), number, 0))
    return np.asarray(since % (2 * every) != 0), name, every  # a robot at rest has no news: some rows of it stay


def held_rows(position: FloatArray, torque: FloatArray) -> BoolArray:
    """Rows equal to the row before in every q and tau, while the next different row shows that the robot moved."""
    same = ~(_news(position) | _news(torque))
    if not same.any():
        return same
    # Position of the first row after each run of equal rows: a robot at rest shows the same position there.
    starts = np.flatnonzero(~same)
    following = np.searchsorted(starts, np.arange(same.size), side="right")
    next_row = np.append(starts, same.size - 1)[np.minimum(following, starts.size)]
    moved = (position[next_row] != position).any(axis=1)
    return np.asarray(same & moved, dtype=np.bool_)


def _news(values: FloatArray) -> BoolArray:
    """(R,) rows that differ from the row before in any channel; the first is one."""
    result = np.ones(values.shape[0], dtype=np.bool_)
    result[1:] = (values[1:] != values[:-1]).any(axis=1)
    return result


def _rows_per_news(values: FloatArray) -> int:
    """Rows of the file per row of its source: 1 where the source is as fast, or only coarse."""
    news = np.flatnonzero(_news(values))
    if 2 * news.size > values.shape[0] or news.size < 3:
        return 1
    steps = np.diff(news)
    usual = int(np.median(steps))
    changed = values[news[1:]] != values[news[1:] - 1]
    together = float(changed[:, changed.any(axis=0)].mean())
    regular = float((np.abs(steps - usual) <= 1).mean())
    return usual if usual >= 2 and together >= _TOGETHER and regular >= _REGULAR else 1
