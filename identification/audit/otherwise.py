"""What else a recording may be than it states, asked of it alone: all readings by one measure, and the likeliest said.

Each reading is one hypothesis against "nothing is wrong", by the likelihood of rows that were not fitted (`held_out`):
the zeros of joints, a torque without its sign, torques in scales of their own, another clock, another arm from some
moment on, and a filter that only the torque went through (`linear_dynamics`). One is said where it gains clearly and
next to nothing of the misfit stays; all others look like it in part. Not here: places and turns of joints (`turned`),
the stand of the base (`mount`), the torque of one joint that changes (`partly`). Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.audit.columns import INERTIAL, PARAMETERS
from identification.audit.comparison import LEAST_GAIN
from identification.audit.held_out import STAYS, STEPS, Asked, Score
from identification.audit.hypotheses import GAIN_WIDTH
from identification.audit.linear_dynamics import likeliest_filter, within_stretches
from identification.audit.partly import FIRST_MOMENTS, MOMENTS, ChangedTorque, changed_torques, sentence_of_changes
from identification.audit.rows import MOST_ROWS, REPEATED, band_of, rows_of
from identification.errors import RecordingError
from identification.recordings.clock import SMALLEST_CLOCK_ERROR
from identification.recordings.independence import recording_names
from identification.recordings.leaps import HIDDEN_GAPS
from identification.recordings.recording import Recording
from identification.remembered import once_per_object
from identification.robots.model import RobotModel
from identification.signals.aperiodic import ROWS_PER_CUTOFF_PERIOD

CHANGING = "changes", "another arm"
"""Kinds of a recording that is not one throughout."""
FILTERED = "filtered"
"""The kind of a torque that alone went through a filter, or is late."""
WIDEST_ZERO = np.pi / 2.0
SETTLED = 1e-4
"""rad, m, or of a scale's logarithm: where no step is longer, the values are settled."""


@dataclass(frozen=True, slots=True, eq=False)
class Otherwise:
    """kind: which reading. sentence: what an operator reads."""

    kind: str
    sentence: str


_Found = tuple[str, str, Score] | None


def may_be_read_otherwise(over_noise: FloatArray) -> bool:
    """Whether a misfit, (n,) times the noise, is so large that a reading could leave next to nothing of it.

    None leaves less than the noise. True where the noise is not known (nan).
    """
    return not np.mean(1.0 + over_noise**2) < 1.0 / STAYS


def other_readings(
    recordings: Sequence[Recording], robot: RobotModel, turned: Sequence[bool], *, large: bool = True
) -> list[Otherwise | None]:
    """`other_reading` of each of some recordings of one robot, with its name.

    turned: of each, whether a torque is known to have the wrong sign throughout, which looks like much else: then
    only what changes is said. large: `may_be_read_otherwise`; else only what changes is asked.
    """
    result: list[Otherwise | None] = []
    for recording, name, wrong in zip(recordings, recording_names(recordings), turned, strict=True):
        found = other_reading(recording, robot) if large else _changes(changed_torques(recording, robot))
        said = found is not None and (not wrong or found.kind in CHANGING)
        result.append(replace(found, sentence=f"{name}: {found.sentence}") if found is not None and said else None)
    return result


@once_per_object
def other_reading(recording: Recording, robot: RobotModel) -> Otherwise | None:
    """The likeliest other reading of a recording; None of a sound one.

    None too where it is at rest or too short, and where joints follow others.
    """
    if robot.mimics:
        return None
    try:
        asked = Asked.of(rows_of([recording]), robot)
        unbroken = _unbroken(recording, robot, asked)
    except RecordingError:
        return None
    stated, alone = (each.of_reading(each.columns) for each in (asked, unbroken))
    changed = changed_torques(recording, robot)
    known = _changes(changed)
    found: list[tuple[str, str, Score, Score]] = []
    passed = likeliest_filter(unbroken, alone, LEAST_GAIN)
    if passed is not None:
        found.append((FILTERED, passed[0].sentence, passed[1], alone))
    if known is not None:
        found.append((known.kind, known.sentence, _mended(asked, recording, changed), stated))
    whole = _another_arm(asked, stated, recording)
    others = (_zeros(asked, stated), _without_sign(asked), _scales(asked), _clock(asked), whole)
    found += [(*other, stated) for other in others if other is not None]
    if not found:
        return None
    kind, sentence, score, against = max(found, key=lambda item: item[2].nats - item[3].nats)
    gain = score.nats - against.nats
    if kind == "clock" and recording.report.of_kind(HIDDEN_GAPS):  # wrong stamps, but by no one rate
        return known
    if gain > LEAST_GAIN and score.holds_against(against):
        return Otherwise(kind, sentence)
    return known


def _changes(changed: Sequence[ChangedTorque]) -> Otherwise | None:
    """As it is said where no other reading is likelier."""
    return Otherwise("changes", sentence_of_changes(changed)) if changed else None


def _mended(asked: Asked, recording: Recording, changed: Sequence[ChangedTorque]) -> Score:
    """Of the torques as they were before they changed."""
    rows, torque, logs = asked.rows, asked.rows.torque.copy(), 0.0
    # Rows are in the order of time, in stretches without a gap: time goes by their number.
    time = recording.time[0] + recording.duration_s * np.arange(len(torque)) / len(torque)
    for each in changed:
        after = time >= each.since_s
        if each.form == "offset":
            torque[after, each.joint - 1] -= each.value
        else:
            torque[after, each.joint - 1] /= each.value
            logs += float(np.log(abs(each.value))) * int((rows.used[:, each.joint - 1] & after).sum())
    score = asked.of_reading(asked.columns, torque)
    return replace(score, nats=score.nats - logs / REPEATED)


def _unbroken(recording: Recording, robot: RobotModel, asked: Asked) -> Asked:
    """As many rows from the beginning as stand without a gap: a filter needs neighbours."""
    step, low_pass_hz = recording.sampling_period_s, band_of([recording])
    stride = max(1, int(1.0 / step / (ROWS_PER_CUTOFF_PERIOD * low_pass_hz)))
    whole = asked.rows.spacing_s < 1.5 * stride * step
    part = recording if whole else recording.rows(np.arange(recording.samples) < stride * MOST_ROWS)
    unbroken = asked if whole else Asked.of(rows_of([part]), robot)
    return replace(unbroken, rows=within_stretches(unbroken.rows))


def _zeros(asked: Asked, stated: Score) -> _Found:
    """The zeros of joints that are off: the likeliest first, and one more while that gains as much."""
    n = len(asked.sizes.torque)
    chosen: list[int] = []
    best: tuple[FloatArray, Score] | None = None
    before, zeros = stated, np.zeros(n)
    while len(chosen) < n:
        slopes = _slopes(asked, zeros)[1]
        joint, most = 0, -np.inf
        for other in (each for each in range(n) if each not in chosen):
            if (nats := _beside(asked, zeros, slopes, [other], most)) > most:
                joint, most = other, nats
        tried = _settled_zeros(asked, zeros, [*chosen, joint])
        score = asked.of_reading(asked.geometry.at(tried).columns(asked.gravity))
        if score.nats - before.nats <= LEAST_GAIN or np.abs(tried).max() > WIDEST_ZERO:
            break
        chosen, zeros, before, best = [*chosen, joint], tried, score, (tried, score)
        if score.holds_against(stated):
            break
    if best is None:
        return None
    turning = asked.geometry.robot.kinematics.revolute
    which = " and ".join(
        f"{best[0][joint]:+.3g} {'rad' if turning[joint] else 'm'} to the position of joint {joint + 1}"
        for joint in sorted(chosen)
    )
    several = "s" * (len(chosen) > 1)
    sentence = (
        f"The zero{several} of joint{several} {' and '.join(str(joint + 1) for joint in sorted(chosen))} "
        f"{'are' if several else 'is'} off: add {which}, and the recording goes far better with one rigid body"
    )
    return "zeros", sentence, best[1]


def _slopes(asked: Asked, zeros: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns (R, n, 14 n) with those zeros, and (R, n, n) how the torque that they explain changes with each."""
    geometry = asked.geometry.at(zeros)
    columns = geometry.columns(asked.gravity)
    values = asked.values(asked.products(columns, asked.rows.torque), asked.widths())
    return columns, geometry.by_zero(values, asked.gravity, 1.0)


def _beside(asked: Asked, zeros: FloatArray, slopes: FloatArray, joints: list[int], least: float) -> float:
    """Nats with the zeros of some joints free, as far as a tangent says. least: as in `score`."""
    columns = asked.geometry.at(zeros).columns(asked.gravity)
    both = np.concatenate([columns, slopes[..., joints]], axis=2)
    return asked.score(asked.products(both, asked.rows.torque), asked.widths(len(joints), WIDEST_ZERO), least).nats


def _settled_zeros(asked: Asked, start: FloatArray, joints: list[int]) -> FloatArray:
    """(n,) the zeros of some joints that leave least."""
    zeros = start.copy()

    def at(values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        zeros[joints] = values
        columns, slopes = _slopes(asked, zeros)
        return columns, slopes[..., joints], asked.rows.torque

    zeros[joints] = asked.settled(start[joints], at, WIDEST_ZERO, SETTLED)
    return zeros


def _without_sign(asked: Asked) -> _Found:
    """Torques of joints that are never below zero, or never above it, with the sign that the other joints' say."""
    torque = asked.rows.torque
    size = 0.1 * asked.sizes.torque
    sided = (torque.min(axis=0) > -size) | (torque.max(axis=0) < size)
    joints = np.flatnonzero(sided & asked.rows.used.any(axis=0))
    if not joints.size or len(joints) == torque.shape[1]:
        return None
    widths = asked.widths()
    products = asked.products(asked.columns, torque)
    counted = np.where(np.isin(np.arange(torque.shape[1]), joints), 0.0, 1.0)
    values = asked.values(
        type(products)(
            products.gram * counted[:, None, None], products.right * counted[:, None], products.square * counted,
            products.count * counted,
        ),
        widths,
    )  # fmt: skip
    signed = torque
    for _ in range(STEPS):
        expected = asked.columns[:, joints] @ values
        before, signed = signed, torque.copy()
        signed[:, joints] = np.copysign(torque[:, joints], expected)
        if np.array_equal(before, signed):
            break
        values = asked.values(asked.products(asked.columns, signed), widths)
    joints = np.flatnonzero((signed != torque).any(axis=0))
    which = ", ".join(str(joint + 1) for joint in joints)
    sentence = (
        f"The torque of joint{'s' * (len(joints) > 1)} {which} has lost its sign: with the sign that the motion says, "
        "the recording goes far better with one rigid body. Record the torque itself, not its absolute value"
    )
    return "without sign", sentence, asked.of_reading(asked.columns, signed)


def _scales(asked: Asked) -> _Found:
    """Torques each in a scale of its own, which one body on all of the joints tells but for a common one."""
    n = len(asked.sizes.torque)
    if n < 2:
        return None

    def at(logs: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        torque = asked.rows.torque * np.exp(np.median(logs) - logs)
        expected = asked.columns @ asked.values(asked.products(asked.columns, torque), asked.widths())
        return asked.columns, expected[..., None] * np.eye(n), torque

    logs = asked.settled(np.zeros(n), at, GAIN_WIDTH, SETTLED)
    logs -= np.median(logs)
    score = asked.of_reading(asked.columns, asked.rows.torque * np.exp(-logs))
    nats = score.nats - float(asked.rows.used.sum(axis=0) @ logs) / REPEATED
    scales = ", ".join(f"{value:.2g}" for value in np.exp(logs - logs.max()))
    sentence = (
        f"The torques are in different scales, joints 1 to {n} as {scales}: each divided by that, the recording goes "
        "far better with one rigid body. So are torques before the gears and motor currents: multiply each joint's by "
        "its gear ratio and torque constant"
    )
    return "scales", sentence, Score(nats, score.square * np.exp(2.0 * logs))


def _clock(asked: Asked) -> _Found:
    """Another rate than the stated one, where no recorded velocity says it."""
    if asked.rows.clock_known:
        return None

    def at(log_ratio: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        ratio = float(np.exp(log_ratio[0]))
        columns = asked.geometry.columns(asked.gravity, ratio)
        values = asked.values(asked.products(columns, asked.rows.torque), asked.widths())
        return columns, asked.geometry.by_ratio(values, ratio)[..., None], asked.rows.torque

    log_ratio = float(asked.settled(np.zeros(1), at, 1.0, SETTLED)[0])
    if abs(log_ratio) < SMALLEST_CLOCK_ERROR:
        return None
    ratio = float(np.exp(log_ratio))
    sentence = (
        f"The clock is wrong: with a true rate of {ratio:.3g} times the stated one the recording goes far better "
        "with one rigid body. Check the sampling rate"
    )
    return "clock", sentence, asked.of_reading(asked.geometry.columns(asked.gravity, ratio))


def _another_arm(asked: Asked, stated: Score, recording: Recording) -> _Found:
    """One body up to some moment and another from there on, all joints at once."""
    rows = asked.rows
    part = np.arange(len(rows.block)) * MOMENTS // len(rows.block)
    own = np.arange(asked.columns.shape[2]) % PARAMETERS >= INERTIAL

    def score(moment: int, which: BoolArray, least: float) -> Score:
        """Of columns (14 n,) that have other values from a moment on. least: as in `Asked.score`."""
        late = np.where((part >= moment)[:, None, None], asked.columns[..., which], 0.0)
        widths = np.concatenate([asked.widths(), asked.widths()[which]])
        return asked.score(asked.products(np.concatenate([asked.columns, late], axis=2), rows.torque), widths, least)

    every, least = np.ones_like(own), stated.nats + LEAST_GAIN
    tried = {moment: score(moment, every, least) for moment in FIRST_MOMENTS}
    near = max(tried, key=lambda moment: tried[moment].nats)
    if tried[near].nats <= least:
        return None
    between = (moment for moment in range(FIRST_MOMENTS[0], FIRST_MOMENTS[-1] + 1) if moment not in FIRST_MOMENTS)
    tried |= {moment: score(moment, every, least) for moment in between}
    moment, found = max(tried.items(), key=lambda item: item[1].nats)
    # Friction and offsets of one arm change, too.
    if score(moment, own, found.nats - LEAST_GAIN).nats >= found.nats - LEAST_GAIN:
        return None
    within = recording.duration_s / MOMENTS
    since = float(recording.time[0]) + moment * within
    sentence = (
        f"From t = {since:.3g} ± {within:.2g} s on the torques are those of another arm, or a load was picked up or "
        "put down there: each part goes with one rigid body by itself, both together do not. Leave one of the parts out"
    )
    return "another arm", sentence, found
