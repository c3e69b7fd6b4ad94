"""What stands while it should change: a torque cut off at its end or held, an encoder that is stuck.

Exact equality of neighbouring rows tells it, against what the same sensor does elsewhere in the recording. No row is
left out for it: fits warn, and the diagnosis calls it a fault of the data. Pure functions of a recording.
"""

from __future__ import annotations

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray, longest_run, runs_of
from identification.recordings.held import OF_A_QUANTUM, is_coarse
from identification.recordings.recording import Finding, Recording

__all__ = ["STANDING", "standing_values"]

STANDING = ("clipped_torque", "standing_torque", "stuck_position")
"""The kinds of finding made here."""

PLATEAU_SAMPLES = 10
PLATEAU_RUN = 3
PLATEAU_OVER_NEIGHBOUR = 5.0
CHANCE = 1e-3
"""Of a run of equal torques anywhere in a recording, up to which it is not the steps of the sensor."""
AT_REST = 0.01
"""Share of a joint's largest speed up to which it stands."""


def standing_values(recording: Recording) -> tuple[Finding, ...]:
    """What stands in rows in which it should not, by joint, with rows (from 1) and their share; none of a sound one.

    clipped_torque: the torque stays at its largest or smallest value while the arm moves. standing_torque: it keeps one
    value, to the bit, for longer than its steps explain, while its joint moves. stuck_position: the position stops
    from one row to the next, or goes on with a leap, while other joints move.
    """
    found = []
    step = np.abs(np.diff(recording.position, axis=0))
    moves = np.concatenate([[True], (step != 0.0).any(axis=1)])
    for joint in range(recording.n):
        torque = recording.torque[:, joint]
        clipped, limits = _clipped(torque, moves)
        if clipped.any():
            ends = " and ".join(f"{side:+.4g}" for side in limits)
            found.append(
                _finding("clipped_torque", clipped, joint, f"the torque is cut off at {ends} {recording.torque_unit}")
            )
        held = _held(recording, joint) & ~clipped
        if held.any():
            zero = bool((torque[held] == 0.0).all())
            what = "the torque is exactly 0" if zero else "the torque keeps the value of the row before"
            found.append(_finding("standing_torque", held, joint, f"{what} while the joint moves"))
        stuck = _stuck(recording, joint)
        if stuck.any():
            what = "the position stands while other joints move, and stops or goes on at full speed: a stuck encoder"
            found.append(_finding("stuck_position", stuck, joint, what))
    return tuple(found)


def _finding(kind: str, marked: BoolArray, joint: int, what: str) -> Finding:
    rows = np.flatnonzero(marked) + 1
    share = 100.0 * rows.size / marked.size
    where = f"in {rows.size} rows between {rows[0]} and {rows[-1]}, {share:.2g} % of all"
    return Finding(kind, int(rows[0]), int(rows[-1]), int(rows.size), f"joint {joint + 1}: {what}, {where}", joint + 1)


def _clipped(torque: FloatArray, moves: BoolArray) -> tuple[BoolArray, list[float]]:
    """(N,) rows of a torque (N,) at an end of its range at which it is cut off, and these ends."""
    marked, limits = np.zeros(torque.size, dtype=np.bool_), []
    for extreme in (torque.max(), torque.min()):
        at = (torque == extreme) & moves
        if at.sum() < PLATEAU_SAMPLES or longest_run(at) < PLATEAU_RUN:
            continue
        values, counts = np.unique(torque, return_counts=True)
        beside = np.argsort(np.abs(values - extreme))[1:4]
        neighbour = int(counts[beside].max()) if beside.size else 0
        if at.sum() > PLATEAU_OVER_NEIGHBOUR * neighbour and values.size > 10:
            marked |= torque == extreme
            limits.append(float(extreme))
    return marked, limits


def _held(recording: Recording, joint: int) -> BoolArray:
    """(N,) rows that repeat a joint's torque of the row before for longer than chance, while the joint moves.

    A sensor whose steps are coarser than its noise repeats what it will, so nothing is said of it; nor of a run that
    begins and ends by one step.
    """
    torque = recording.torque[:, joint]
    marked = np.zeros(torque.size, dtype=np.bool_)
    change = np.abs(np.diff(torque))
    news, runs = change > 0.0, _unlikely_runs(change)
    if not runs.size or not news.any() or is_coarse(torque[np.append(True, news), None]):
        return marked
    moves = _in_motion(recording, joint)
    quantum = OF_A_QUANTUM * float(np.percentile(change[news], 10.0))
    for first, behind in runs:
        beside = [change[place] for place in (first - 1, behind) if 0 <= place < change.size]
        if max(beside) > quantum and moves[first + 1 : behind + 1].mean() > 0.5:
            marked[first + 1 : behind + 1] = True
    return marked


def _unlikely_runs(change: FloatArray) -> IntArray:
    """(k, 2) runs of steps (N - 1,) without a change that are longer than chance has them in so many rows.

    By how often a value that just changed is the same in the next row, which is what the sensor's steps and noise do:
    in all rows, and in as many as the run has before it and behind it, as slow parts of a motion repeat more.
    """
    same = change == 0.0
    news = np.append(~same[:-1], False)
    again = news & np.append(same[1:], False)

    def expected(length: IntArray, rows: slice, own: int) -> FloatArray:
        """Runs of such lengths in all rows, by some of which `own` news are the begin of the run in question."""
        share = (float(again[rows].sum()) - own + 1.0) / (float(news[rows].sum()) - own + 2.0)
        return np.asarray(same.size * share**length)

    runs = runs_of(same)
    runs = runs[expected(runs[:, 1] - runs[:, 0], slice(None), 0) < CHANCE]
    around = [(max(0, 2 * first - behind), 2 * behind - first, first > 0, behind - first) for first, behind in runs]
    kept = [bool(expected(length, slice(low, high), int(own)) < CHANCE) for low, high, own, length in around]
    return runs[np.array(kept, dtype=np.bool_)]


def _in_motion(recording: Recording, joint: int) -> BoolArray:
    """(N,) rows in which a joint moves, by where it is a hundredth of a second or a few rows before and behind."""
    half = max(2, round(0.01 / recording.sampling_period_s))
    number = np.arange(recording.samples)
    before, behind = np.maximum(number - half, 0), np.minimum(number + half, recording.samples - 1)
    position = recording.position[:, joint]
    speed = np.abs(position[behind] - position[before]) / (recording.time[behind] - recording.time[before])
    return np.asarray(speed > AT_REST * speed.max(), dtype=np.bool_)


def _stuck(recording: Recording, joint: int) -> BoolArray:
    """(N,) rows that repeat a joint's position though it moves: it leaps from there by more than it ever goes from row
    to row, or stops there by a change of speed that it shows nowhere else, not where it starts either.

    A joint that rests slows down before, as fast as it speeds up. The rest of the rows has to bring news.
    """
    step = np.diff(recording.position[:, joint])
    marked = np.zeros(recording.samples, dtype=np.bool_)
    runs = _unlikely_runs(np.abs(step))
    if not runs.size:
        return marked
    others = np.column_stack([np.delete(recording.position, joint, axis=1), recording.torque[:, joint]])
    news = (np.diff(others, axis=0) != 0.0).any(axis=1)
    runs = np.array([run for run in runs if news[slice(*run)].mean() > 0.5], dtype=np.int64).reshape(-1, 2)
    if not runs.size:
        return marked
    speed = np.append(step / np.diff(recording.time), 0.0)  # behind the last row nothing leaps
    change = np.abs(np.diff(speed))
    usual = np.abs(speed)
    usual[runs[:, 1]] = 0.0
    leaps = np.abs(speed[runs[:, 1]]) > usual.max()
    ordinary = change.copy()
    stops = runs[:, 0] - 1
    ordinary[stops[stops >= 0]] = 0.0
    for behind in runs[leaps, 1]:
        ordinary[behind - 1 : behind + 1] = 0.0
    largest = np.argsort(ordinary)[::-1][:3]
    for (first, behind), leap in zip(runs, leaps, strict=True):
        elsewhere = next(ordinary[place] for place in largest if place not in (behind - 1, behind))
        if leap or (first > 0 and change[first - 1] > elsewhere):
            marked[first + 1 : behind + 1] = True
    return marked
