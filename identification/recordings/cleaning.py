"""From raw rows to a Recording: every doubtful row is found, named with its place and number, and handled.

Order: shapes, non-finite rows, time stamps, isolated spikes, held rows, the clock of the rows, then gaps and jitter of
what is left. Rows are dropped, never repaired: a gap is honest, an invented sample is not. No file is read here.
"""

from __future__ import annotations

import shlex
from typing import Any

import numpy as np

from identification.arrays import DEVIATION_FROM_MEDIAN, BoolArray, FloatArray, IntArray
from identification.errors import RecordingError
from identification.recordings.clock import before_a_clock_was_set_back, highest_before_each
from identification.recordings.held import held_rows, rows_of_a_slower_source, rows_used_again
from identification.recordings.joint_choice import LARGEST_SHARE_OF_BAD_ROWS
from identification.recordings.labels import labels_of_a_stated_period, labels_of_the_run
from identification.recordings.leaps import GAP_FACTOR, HIDDEN_GAPS, rows_behind_hidden_gaps
from identification.recordings.recording import Finding, ImportReport, Recording, RecordingSource
from identification.recordings.repetition import unstated_period
from identification.recordings.row_clock import CROWDED_ROW, crowded, row_clock
from identification.recordings.table import RawTable
from identification.recordings.uneven import gaps_and_jitter

MINIMUM_DURATION_S = 0.5
MINIMUM_SAMPLES = 20
# An isolated value is garbled when it leaves the median of its five neighbours by more than this many times the largest
# ordinary step of its channel (99th percentile of the change of that median) and of its ordinary scatter.
SPIKE_STEPS = 10.0
SPIKE_SCATTER = 15.0
LARGEST = 1e100
"""Of a position or torque: squares of far larger ones are not finite."""
_BLOCK = 4096
_ZERO_IS_ABSENT = {
    "link_position": ("no_second_encoder", "q_link", "second encoder"),
    "velocity": ("no_velocity", "dq", "measured velocity"),
}


def build_recording(table: RawTable, *, sha256: str) -> Recording:
    """Judge the rows of a table in SI units, its shapes checked, and build the Recording of those that hold.

    Raises RecordingError when the arrays do not fit together, when more than a fifth of the rows is unusable, when time
    does not advance, or when less than half a second is left.
    """
    rows_read = table.time.shape[0]
    findings = list(table.findings)
    number = np.arange(1, rows_read + 1, dtype=np.int64)
    keep, every = _usable(table, number, findings)
    time = table.time[keep]
    if (clock := row_clock(time, _kept(table.position, keep))) is not None:
        time, again = clock.time, clock.again
        findings.append(Finding.of_all("trembling_stamps", rows_read, clock.sentence))
    else:
        again = crowded(time)
        _note_runs(findings, "crowded_rows", number[keep][again], CROWDED_ROW)
    time, keep[keep] = time[~again], ~again
    duration = float(np.ptp(time)) if time.size else 0.0
    if time.size < MINIMUM_SAMPLES or duration < MINIMUM_DURATION_S:
        raise RecordingError.named(
            table.path,
            f"{time.size} usable samples over {duration:.3g} s; at least {MINIMUM_SAMPLES} samples and "
            f"{MINIMUM_DURATION_S} s are needed",
        )
    sampling_period_s, uneven = gaps_and_jitter(time, number[keep], every)
    findings.extend(uneven)
    position, torque = _kept(table.position, keep), _kept(table.torque, keep)
    what = (
        "is reached by twice the step beside it, in all joints at once: a row is missing before it and the even stamps "
        "hide it, or q comes by another clock than t. State the true times"
    )
    _note_runs(findings, HIDDEN_GAPS, number[keep][rows_behind_hidden_gaps(time, position)], what)
    moves = np.ptp(position, axis=0) > 0.0
    _refuse_dead_torque(table, torque, moves, findings)
    arrays: dict[str, Any] = {}
    for name, values in table.optional.items():
        arrays[name] = _optional_array(name, _kept(values, keep), moves, findings, rows_read)
    if table.period_index is not None and table.sample_in_period is not None:
        arrays.update(labels_of_the_run(table, keep, every, findings))
    elif table.period_s:
        arrays.update(labels_of_a_stated_period(table, time, position, sampling_period_s, findings, rows_read))
    elif table.period_s is None and (period_s := unstated_period(time, position, sampling_period_s)) is not None:
        sentence = (
            f"the motion repeats every {period_s:.5g} s, {(time[-1] - time[0]) / period_s:.2g} times, but no period is "
            f"stated: with `iiwa-ident import {shlex.quote(str(table.path))} --period {period_s:.5g}` its noise is "
            "measured"
        )
        findings.append(Finding.of_all("unstated_period", rows_read, sentence))
    findings.sort(key=lambda finding: finding.first_row)
    return Recording(
        time=time,
        position=position,
        torque=torque,
        sampling_period_s=sampling_period_s,
        source=RecordingSource(str(table.path), sha256, table.kind, table.metadata),
        report=ImportReport(rows_read, int(keep.sum()), tuple(findings)),
        robot=table.robot,
        joint_names=table.joint_names,
        installation=table.installation,
        torque_unit=table.torque_unit,
        **arrays,
    )


def _usable(table: RawTable, number: IntArray, findings: list[Finding]) -> tuple[BoolArray, int]:
    """(R,) rows that hold: finite, in the order of time, no spike, no sample held. Why others do not joins `findings`.

    number: of each row, from 1. Also returned: in how many rows of the file its source brings news once. Raises
    RecordingError where too many rows do not hold.
    """
    keep = np.ones(number.size, dtype=np.bool_)
    finite = np.isfinite(table.time)
    for values in (table.position, table.torque):
        finite &= (np.abs(values) < LARGEST).all(axis=1)
    _note_runs(
        findings,
        "garbled_rows",
        number[~finite],
        "holds a value in t, q or tau that is not finite, or beyond any number measured; it was left out",
    )
    keep &= finite
    _refuse_too_many(table, keep, "hold values that are not finite, or beyond any number measured")

    keep[keep] = _advancing_time(table, table.time[keep], number[keep], findings)
    again = rows_used_again(_kept(table.position, keep), _kept(table.torque, keep))
    what = "stands in the file a second time, after a leap back, with the q and tau of before; it was left out"
    _note_runs(findings, "repeated_rows", number[keep][again], what)
    keep[keep] = ~again
    spikes = _spikes(_kept(table.position, keep)) | _spikes(_kept(table.torque, keep))
    _note_runs(
        findings,
        "garbled_rows",
        number[keep][spikes],
        "stands alone far away from its neighbours in q or tau; the row was left out",
    )
    keep[keep] = ~spikes
    repeated, name, every = rows_of_a_slower_source(_kept(table.position, keep), _kept(table.torque, keep))
    what = (
        f"brings no new {name}, which comes once in {every} rows, from a source slower than the file; it was left out"
    )
    _note_runs(findings, "repeated_rows", number[keep][repeated], what)
    slower = np.zeros_like(keep)
    slower[keep] = repeated
    keep[keep] = ~repeated
    held = held_rows(_kept(table.position, keep), _kept(table.torque, keep))
    left_out = held.mean() < LARGEST_SHARE_OF_BAD_ROWS  # of coarse sensors many rows are alike, and true
    what = "repeats q and tau of the row before in the middle of a motion (a held sample); the row was "
    _note_runs(
        findings, "repeated_rows", number[keep][held], what + ("left out" if left_out else "kept, as so many do")
    )
    if left_out:
        keep[keep] = ~held
    _refuse_too_many(table, keep | slower, "are garbled or repeated")
    return keep, every


def _kept(values: FloatArray, keep: BoolArray) -> FloatArray:
    """The rows that are kept; the array itself where all are."""
    return values if keep.all() else values[keep]


def check_shapes(table: RawTable) -> None:
    """Raises RecordingError unless t is (N,) and q, tau and all that is optional are (N, n), N and n at least 1."""
    name = table.path.name
    if table.time.ndim != 1:
        raise RecordingError.at(name, f"t has shape {table.time.shape}, one column of N times is needed")
    for label, values in (("q", table.position), ("tau", table.torque)):
        if values.ndim != 2 or values.shape[0] != table.time.shape[0]:
            raise RecordingError.at(
                name,
                f"{label} has shape {values.shape}, but t has {table.time.shape[0]} rows; "
                f"({table.time.shape[0]}, number of joints) is needed",
            )
    if table.position.shape[1] != table.torque.shape[1] or table.position.shape[1] == 0:
        raise RecordingError.at(
            name,
            f"q has {table.position.shape[1]} joints and tau has {table.torque.shape[1]}; "
            "both need the same number of joints, at least one",
        )
    for label, values in table.optional.items():
        if values.shape != table.position.shape:
            raise RecordingError.at(name, f"{label} has shape {values.shape}, but q has {table.position.shape}")
    if table.time.shape[0] == 0:
        raise RecordingError.at(name, "holds no sample at all")


def _refuse_too_many(table: RawTable, keep: BoolArray, what: str) -> None:
    bad = int((~keep).sum())
    if bad > LARGEST_SHARE_OF_BAD_ROWS * keep.size:
        first = int(np.flatnonzero(~keep)[0]) + 1
        named = (("q", table.position[first - 1]), ("tau", table.torque[first - 1]))
        wrong = [f"{name}{j + 1}" for name, row in named for j in np.flatnonzero(~(np.abs(row) < LARGEST))]
        where = f"row {first}" + (f" in {', '.join(wrong)}" if wrong else "")
        raise RecordingError.named(
            table.path,
            f"{bad} of {keep.size} rows {what} (first: {where}); too many to trust the rest",
            field=f"row {first}",
        )


def _note_runs(findings: list[Finding], kind: str, rows: IntArray, what: str) -> None:
    """One finding for all rows of a kind; a few places are named, all rows are counted."""
    if rows.size == 0:
        return
    if rows.size == 1:
        place = f"row {rows[0]}"
    elif rows[-1] - rows[0] == rows.size - 1:
        place = f"each of the {rows.size} rows {rows[0]} to {rows[-1]}"
    else:
        shown = ", ".join(str(row) for row in rows[:5]) + (", …" if rows.size > 5 else "")
        place = f"each of {rows.size} rows between {rows[0]} and {rows[-1]} ({shown})"
    findings.append(Finding.of_rows(kind, rows, f"{place} {what}"))


def _median_of_five(values: FloatArray) -> FloatArray:
    """Running median over five rows along axis 0, the ends repeated."""
    padded = np.concatenate([values[:1], values[:1], values, values[-1:], values[-1:]])
    result = np.empty_like(values)
    for start in range(0, len(values), _BLOCK):  # blocks that stay in the processor's cache
        part = padded[start : start + _BLOCK + 4]
        a, b, c, d, e = (part[first : len(part) - 4 + first] for first in range(5))
        # The largest and the smallest of four are not the median of five; of the two between them and the fifth the
        # middle.
        low = np.maximum(np.minimum(a, b), np.minimum(c, d))
        high = np.minimum(np.maximum(a, b), np.maximum(c, d))
        smaller, larger = np.minimum(low, high), np.maximum(low, high)
        np.maximum(smaller, np.minimum(larger, e), out=result[start : start + _BLOCK])
    return result


def _advancing_time(table: RawTable, time: FloatArray, number: IntArray, findings: list[Finding]) -> BoolArray:
    """Rows (of those given) whose time stamps can be used: no isolated jump, strictly increasing."""
    steps = np.diff(time)
    ordinary = float(np.median(np.abs(steps))) if steps.size else 0.0
    if time.size < 2 or not np.any(steps != 0.0) or ordinary == 0.0:
        raise RecordingError.named(
            table.path,
            f"time stands still (t = {time[0]:g} s in most rows); advancing time stamps in seconds are needed",
        )
    good = np.abs(time - _median_of_five(time[:, None])[:, 0]) <= 100.0 * ordinary
    _note_runs(
        findings, "garbled_rows", number[~good], "carries a time stamp far from its neighbours'; it was left out"
    )
    rest = time[good]
    highest_before = highest_before_each(rest)
    repeated = rest == highest_before
    backwards = rest < highest_before
    if backwards.sum() > LARGEST_SHARE_OF_BAD_ROWS * rest.size:
        at = int(np.flatnonzero(backwards)[0])
        raise RecordingError.named(
            table.path,
            f"time goes backwards at row {number[good][at]} "
            f"(from {highest_before[at]:.6g} s to {rest[at]:.6g} s) and does not recover; split the file there",
            field="t",
        )
    _note_runs(findings, "repeated_rows", number[good][repeated], "repeats the time stamp before it; it was left out")
    _note_runs(
        findings, "time_backwards", number[good][backwards], "carries a time before an earlier row's; it was left out"
    )
    twice = before_a_clock_was_set_back(rest, GAP_FACTOR * ordinary)
    _note_runs(
        findings,
        "time_backwards",
        number[good][twice],
        "stands at a time that comes twice, because the clock was set back behind it; it was left out, too",
    )
    good[good] = ~(repeated | backwards | twice)
    return good


def _spikes(values: FloatArray) -> BoolArray:
    """Rows that leave the running median of five by far more than the channel's ordinary steps and scatter."""
    if values.shape[0] < 5:
        return np.zeros(values.shape[0], dtype=np.bool_)
    middle = _median_of_five(values)
    deviation = np.abs(values - middle)
    largest = deviation.max(axis=0)
    # Where more than half of the deviations are above a share of the largest, so is their median, and nothing can be a
    # spike: the order of all values need not be asked for.
    doubtful = (deviation >= largest / (SPIKE_SCATTER * DEVIATION_FROM_MEDIAN)).mean(axis=0) <= 0.5
    if not doubtful.any():
        return np.zeros(values.shape[0], dtype=np.bool_)
    deviation, middle = deviation[:, doubtful], middle[:, doubtful]
    # Steps of the median, so that the garbled values themselves do not widen the limit.
    step = np.percentile(np.abs(np.diff(middle, axis=0)), 99.0, axis=0)
    scatter = DEVIATION_FROM_MEDIAN * np.median(deviation, axis=0)
    limit = np.maximum(SPIKE_STEPS * step, SPIKE_SCATTER * scatter) + 1e-9
    return np.asarray((deviation > limit).any(axis=1), dtype=np.bool_)


def _optional_array(name: str, values: FloatArray, moves: BoolArray, findings: list[Finding], rows: int) -> FloatArray:
    """An optional array; zeros in the second encoder, or in the velocity of a joint that moves, are no measurement and
    become nan. moves: (n,) whether the joint's position changes.
    """
    if name not in _ZERO_IS_ABSENT:
        return np.asarray(values, dtype=np.float64)
    values = np.array(values, dtype=np.float64)
    kind, field, what = _ZERO_IS_ABSENT[name]
    for joint in range(values.shape[1]):
        if (name == "link_position" or moves[joint]) and not np.any(values[:, joint] != 0.0):
            values[:, joint] = np.nan
            sentence = f"joint {joint + 1}: {field} holds zeros only; taken as having no {what}"
            findings.append(Finding.of_all(kind, rows, sentence, joint + 1))
    return values


def _refuse_dead_torque(table: RawTable, torque: FloatArray, moves: BoolArray, findings: list[Finding]) -> None:
    """A torque that never changes while its joint moves is no measurement; where all are so there is nothing to fit."""
    dead = moves & (np.ptp(torque, axis=0) == 0.0)
    if dead.any() and dead[moves].all():
        raise RecordingError.named(
            table.path,
            f"tau stays at {torque[0, np.argmax(dead)]:g} in every joint that moves; the torque was "
            "not measured (some drivers and simulators send zeros)",
            field="tau",
        )
    for joint in np.flatnonzero(dead):
        sentence = f"joint {joint + 1}: tau stays at {torque[0, joint]:g} although the joint moves; is it measured?"
        findings.append(Finding.of_all("dead_torque", table.time.shape[0], sentence, int(joint) + 1))
