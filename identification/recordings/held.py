"""Rows that bring nothing new: single held samples, a source slower than the file it was written to, and stretches
that stand in the file twice.

Loggers that run faster than a driver write its last values again and again. As positions such rows are a staircase,
whose derivative is no motion; rows with new values are honest. Which rows they are is decided here; `cleaning` asks.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.errors import RecordingError
from identification.recordings.rounded import FEWEST_ROWS, row_codes

_TOGETHER = 0.7
"""Share of the moving channels that change in a row with news; of coarse sensors that repeat values, few do at once."""
LONGEST_HELD_S = 0.025
"""Positions of 40 Hz carry the 20 Hz up to which motion is looked for."""
_REGULAR = 0.9
"""Share of the steps from news to news that are within one row of the usual step."""
OF_A_QUANTUM = 2.0
"""Times the tenth percentile of a channel's changes that their median is at most where a coarse sensor turns over by
one step now and then; a source that comes late brings changes as different as the motion makes them."""

A_LEAP = 2.0
"""Times the largest step of as many rows before and after: a simulated motion that repeats goes on without one."""


def rows_used_again(position: FloatArray, torque: FloatArray) -> BoolArray:
    """Rows of a stretch in which each equals one that stands as many rows before, and that begins with a leap.

    Noise comes about once, so no measurement repeats a stretch. position, torque: (R, n).
    """
    bits = np.ascontiguousarray(np.concatenate([position, torque], axis=1) + 0.0).view(np.int64)  # + 0.0: no -0.0
    code = row_codes(bits)
    order = np.argsort(code, kind="stable")
    equal = code[order][1:] == code[order][:-1]
    behind = np.zeros(code.size, dtype=np.int64)
    behind[order[1:][equal]] = (order[1:] - order[:-1])[equal]
    edges = np.concatenate([[0], np.flatnonzero(np.diff(behind)) + 1, [code.size]])
    steps, news = np.abs(np.diff(position, axis=0)), _news(position)
    again = np.zeros(code.size, dtype=np.bool_)
    for first, end in pairwise(edges):
        if behind[first] and first and news[first:end].sum() >= FEWEST_ROWS:
            around = np.concatenate([steps[max(first - (end - first), 0) : first - 1], steps[first : end - 1]])
            again[first:end] = (steps[first - 1] > A_LEAP * around.max(axis=0)).any()
    return again


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


def refuse_staircase(path: Path, position: FloatArray, step_s: float) -> None:
    """Raises RecordingError for a joint that goes its way (R, n) in leaps that come more slowly than motion is looked
    for: its positions stand in rows in which others move, so none can be left out.
    """
    for joint, values in enumerate(position.T):
        news = np.flatnonzero(_news(values[:, None]))
        steps, leaps = np.diff(news), np.abs(np.diff(values[news]))
        if steps.max(initial=0) * step_s <= LONGEST_HELD_S:
            continue
        order = np.argsort(steps)
        way = np.cumsum(leaps[order])
        rows = int(steps[order][np.searchsorted(way, 0.5 * way[-1])])
        if rows > 1 and rows * step_s > LONGEST_HELD_S and not is_coarse(values[news, None]):
            raise RecordingError.named(
                path,
                f"joint {joint + 1} leaps once in {rows} rows ({1e3 * rows * step_s:.3g} ms) and stands between, while "
                "others move: a staircase, whose derivative is no motion. Write each row with positions of its time",
                field="q",
                joint=joint + 1,
            )


def _news(values: FloatArray) -> BoolArray:
    """(R,) rows that differ from the row before in any channel; the first is one."""
    result = np.ones(values.shape[0], dtype=np.bool_)
    result[1:] = (values[1:] != values[:-1]).any(axis=1)
    return result


def _rows_per_news(values: FloatArray) -> int:
    """Rows of the file per row of its source: 1 where the source is as fast, or only coarse."""
    news = np.flatnonzero(_news(values))
    if 2 * (news.size - 1) > values.shape[0] or news.size < 3:  # the first row is no news of a source
        return 1
    steps = np.diff(news)
    usual = int(np.median(steps))
    changed = values[news[1:]] != values[news[1:] - 1]
    together = float(changed[:, changed.any(axis=0)].mean())
    regular = float((np.abs(steps - usual) <= 1).mean()) >= _REGULAR
    return usual if usual >= 2 and together >= _TOGETHER and (regular or not is_coarse(values[news])) else 1


def is_coarse(values: FloatArray) -> bool:
    """Whether the changes of all channels are of one step of a sensor. values: (R, n) rows with news."""
    changes = np.abs(np.diff(values, axis=0))
    changes[changes == 0.0] = np.nan
    changes = changes[:, np.isfinite(changes).any(axis=0)]
    step, usual = np.nanpercentile(changes, [10.0, 50.0], axis=0)
    return bool(np.all(usual <= OF_A_QUANTUM * step))
