"""Are recordings different measurements? A recording that checks itself confirms whatever was fitted to it.

Here: names that tell recordings apart, an order of theirs, and the refusal of samples that stand in two of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from identification.arrays import FloatArray, IntArray, runs_of
from identification.errors import RecordingError
from identification.recordings.recording import CLOCK_START, Recording
from identification.recordings.rounded import (
    FEWEST_ROWS,
    Rows,
    is_no_chance,
    moving_rows,
    row_codes,
    rows_that_agree,
    share_of,
)
from identification.recordings.same_noise import correlation_of_noise
from identification.remembered import once_per_object

KEPT_DECIMALS = 6
"""Of q and tau in a sample's fingerprint: a file with rounded numbers is still the same measurement."""
KEPT_DIGITS = 6
"""Of them too: a file in single precision has seven."""
NUMBERS = 8
"""In a sample that do not repeat together, by noise and steps of sensors; of few joints it takes several rows."""
SAME_POSITION = 0.01
"""Of the spread of each joint's motion, RMS: nearer than two motions come, further than filters and clocks lead one."""
EARLIEST_CLOCK_S = 1.0e9
"""Stamps before 2001 count from some start, not from 1970, so they do not tell when something was."""

KEPT_PRINTS = 512
"""Of a recording in the file of a model fitted to it: a cut of a twentieth still holds more than enough of them."""
PRINT_DIGITS = 8
"""Of each there, hexadecimal: two of 512 and of a million samples agree by accident once in eight recordings."""

Prints = IntArray


def recording_names(recordings: Sequence[Recording]) -> list[str]:
    """File names, with as many of their folders as tell them apart (every run calls its log alike)."""
    return names_apart([recording.source.path for recording in recordings])


def names_apart(paths: Sequence[str | Path]) -> list[str]:
    """Names of files, with as many of their folders as tell the files apart."""
    parts = [Path(path).parts for path in paths]
    depth = 1
    while len({item[-depth:] for item in parts}) < len(set(parts)):
        depth += 1
    return [str(Path(*item[-depth:])) for item in parts]


def in_one_order(recordings: Sequence[Recording]) -> list[Recording]:
    """The longest one first, those as long by what stands in them: in whatever order they were given."""
    return sorted(
        recordings, key=lambda item: (-item.samples, item.source.sha256, float(item.torque.sum()), item.source.path)
    )


def is_called(recording: Recording, name: str) -> bool:
    """Whether a name of `recording_names` is a recording's."""
    parts = Path(name).parts
    return Path(recording.source.path).parts[-len(parts) :] == parts


def refuse_repeated(recordings: Sequence[Recording]) -> None:
    """Raises RecordingError where one measurement is given twice: it would count as two, and every σ be too small."""
    names, prints = recording_names(recordings), _all_fingerprints(recordings)
    for later in range(1, len(recordings)):
        for first in range(later):
            own = recordings[first]
            what = _shared(own, recordings[later], str(own.source.path), prints[first], prints[later])
            if what:
                raise RecordingError(
                    f"{names[later]}: {what}; one measurement counts once. Give it once",
                    file=recordings[later].source.path,
                    field="recordings",
                )


def refuse_shared_samples(fitted: Sequence[Recording], heldout: Sequence[Recording]) -> None:
    """Raises RecordingError where a held-out recording is a fitted one, whole or in part, or one is given twice.

    A copy, an import and a cut of a recording have its samples under other names and other time stamps, so samples are
    compared: q and tau of every row in which the robot moves. A recording of the same moments by another program, at
    another rate or through another filter, is told by its clock and its positions; a copy so made of a periodic motion
    by its noise; one with fewer decimals by its rows, which agree to within the last of them.
    """
    names = recording_names([*fitted, *heldout])
    prints = _all_fingerprints([*fitted, *heldout])
    for other, other_name, other_prints in zip(heldout, names[len(fitted) :], prints[len(fitted) :], strict=True):
        for own, own_prints in zip(fitted, prints, strict=False):
            known = f"the fitted recording {own.source.path}"
            what = _shared(own, other, known, own_prints, other_prints)
            if what:
                raise RecordingError(
                    f"{other_name}: {what}; a recording cannot confirm what was fitted to it. Hold out another run",
                    file=other.source.path,
                    field="heldout",
                )
    refuse_repeated(fitted)
    refuse_repeated(heldout)


def seen_among(fitted: Sequence[Recording], recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Names of those recordings that a fitted one holds, whole or in part, told as `refuse_shared_samples` tells it."""
    prints = _all_fingerprints([*fitted, *recordings])
    known = list(zip(fitted, prints, strict=False))
    others = zip(recordings, recording_names(recordings), prints[len(fitted) :], strict=True)
    return tuple(
        name
        for other, name, other_prints in others
        if any(_shared(own, other, "", own_prints, other_prints) for own, own_prints in known)
    )


def prints_to_keep(recording: Recording) -> str:
    """Fingerprints of some moving samples as one text, by which `holds_samples` knows a copy without the recording.

    The smallest are kept, so that a cut keeps those of its own samples that the whole does.
    """
    kept = np.sort(_fingerprints(recording).view(np.uint64))[:KEPT_PRINTS]
    return "".join(f"{int(number):016x}"[-PRINT_DIGITS:] for number in kept)


def rows_to_keep(recording: Recording) -> str:
    """Some moving rows as one text, by which `holds_rows` knows a copy with fewer decimals."""
    return moving_rows(recording).to_text()


def holds_rows(recording: Recording, kept: str) -> bool:
    """Whether a recording has, to within the last decimals, the rows that `rows_to_keep` gave of another."""
    return rows_that_agree(Rows.from_text(kept), recording) > 0


def holds_samples(recording: Recording, kept: str) -> bool:
    """Whether a recording is, whole or in part, the one that `prints_to_keep` was asked about."""
    places = range(0, len(kept), PRINT_DIGITS)
    known = {int(kept[place : place + PRINT_DIGITS], 16) for place in places}
    own = _fingerprints(recording).view(np.uint64) % np.uint64(16**PRINT_DIGITS)
    return len(known.intersection(own.tolist())) >= FEWEST_ROWS


def _shared(own: Recording, other: Recording, name: str, own_prints: Prints, other_prints: Prints) -> str:
    """What two recordings have in common, said of the other one; empty where they are different measurements."""
    if own.source.sha256 and own.source.sha256 == other.source.sha256:
        return f"is {name} itself"
    if own.n != other.n:
        return ""
    if _running_in(own_prints, other_prints) or _running_in(other_prints, own_prints):
        shared = int(np.isin(other_prints, own_prints).sum())
        return f"shares {shared} of its {other_prints.size} moving samples with {name}"
    together = _same_moments(own, other)
    if together:
        return f"shows the same motion at the same time as {name}, for {together:.3g} s"
    # Runs that were told apart when they were recorded are not asked: simulated ones may share the seed of their noise.
    if None not in _runs(own, other):
        return ""
    alike = correlation_of_noise(own, other)
    if alike:
        return f"has the noise of {name} (correlation {alike:.2g}): a copy, resampled or filtered"
    rows = rows_that_agree(moving_rows(own), other)
    return f"agrees with {name} in {rows} rows running, to within the last decimals: a rounded copy" if rows else ""


def _running_in(known: Prints, prints: Prints) -> bool:
    """Whether more fingerprints, one after the other, are among known ones than chance has it.

    Where a motion that repeats is written with few decimals, samples of two runs are alike by chance: as often behind a
    known one as the others of the two show.
    """
    there = np.isin(prints, known)
    first, last = max(runs_of(there).tolist(), key=lambda ends: ends[1] - ends[0], default=(0, 0))
    others = there.copy()
    others[first:last] = False
    chance = share_of(others[1:][others[:-1]])
    return last - first >= FEWEST_ROWS and is_no_chance(last - first, chance, known.size * prints.size)


def _runs(own: Recording, other: Recording) -> list[str | None]:
    return [recording.source.metadata.get("run_id") for recording in (own, other)]


def _same_moments(own: Recording, other: Recording) -> float:
    """Seconds in which two recordings show one robot, 0 where their clocks or their positions say otherwise."""
    starts = [clock_start_s(recording) for recording in (own, other)]
    runs = _runs(own, other)
    if None in starts or (None not in runs and runs[0] != runs[1]):
        return 0.0
    apart = float(starts[1] or 0.0) - float(starts[0] or 0.0)
    time = other.time - other.time[0] + apart
    mine = own.time - own.time[0]
    within = (time >= 0.0) & (time <= mine[-1])
    if within.sum() < FEWEST_ROWS:
        return 0.0
    there = np.column_stack([np.interp(time[within], mine, column) for column in own.position.T])
    left = np.sqrt(np.mean((other.position[within] - there) ** 2, axis=0))
    return float(np.ptp(time[within])) if np.all(left <= SAME_POSITION * np.std(own.position, axis=0)) else 0.0


def clock_start_s(recording: Recording) -> float | None:
    """Time of the first sample by the clock of its source, s since 1970; None where time only counts from the start."""
    start = float(recording.source.metadata.get(CLOCK_START, "0")) + float(recording.time[0])
    return start if start > EARLIEST_CLOCK_S else None


def _all_fingerprints(recordings: Sequence[Recording]) -> list[Prints]:
    return [_fingerprints(recording) for recording in recordings] if len(recordings) > 1 else [np.empty(0, np.int64)]


@once_per_object
def _fingerprints(recording: Recording) -> Prints:
    """One number for each sample that differs from the one before it; equal samples have equal numbers."""
    rows = np.concatenate([recording.position, recording.torque], axis=1)
    moving = (np.diff(np.round(rows[:, : recording.n] * 10.0**KEPT_DECIMALS), axis=0) != 0).any(axis=1)
    whole = _rounded(rows)
    behind = -(-NUMBERS // whole.shape[1])
    whole = np.concatenate([np.roll(whole, shift, axis=0) for shift in range(behind)], axis=1)
    moving[: behind - 1] = False
    return row_codes(whole[1:][moving])


def _rounded(rows: FloatArray) -> Prints:
    """Numbers in steps of the last decimal kept, or of the last digit where that is coarser."""
    digits = np.floor(np.log10(np.maximum(np.abs(rows), np.finfo(np.float64).tiny)))
    order = np.maximum(digits - (KEPT_DIGITS - 1) + KEPT_DECIMALS, 0.0).astype(np.int64)
    step = (10.0 ** np.arange(order.max(initial=0) + 1))[order]  # one power of each order, not of each number
    return np.asarray(np.rint(np.rint(rows * 10.0**KEPT_DECIMALS / step) * step), dtype=np.int64)
