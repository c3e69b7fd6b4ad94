"""Recordings reduced to the rows that an audit compares: one band, thinned, motion and torque filtered alike.

Every column of an audit is a function of these rows, so that another clock, gravity or zero is judged without
filtering again. Not here: which of them are compared with what (`columns`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.audit.colour import preceded
from identification.base_parameters import Widths
from identification.errors import RecordingError
from identification.fitting.processing import SMALLEST_MOTION
from identification.recordings.clock import clock_by_velocity
from identification.recordings.recording import Recording
from identification.signals.aperiodic import process_aperiodic, sixth_order_difference, zero_phase_low_pass
from identification.signals.processed import ProcessedSignals

WIDEST_HZ = 8.0
SAMPLES_PER_CUTOFF_PERIOD = 20.0
MOST_ROWS = 1500
BLOCK_S = 2.0
FEWEST_BLOCKS = 16
"""Parts of one motion differ in posture and direction: blocks taken in turns see all of it."""
COULOMB_VELOCITY = 0.02
"""rad/s over which Coulomb friction turns over where a model says nothing, and of a joint that is slow:"""
SHARE_OF_SPEED = 0.05
"""of its largest speed. The width is a velocity of the joint, and what it takes off friction belongs to no cause."""
FEWEST_ROWS = 40
REPEATED = 4.0
"""Neighbouring rows that count as one where their colour is not asked."""
MOTION = "position", "velocity", "acceleration", "direction", "sharp"
_ARRAYS = *MOTION, "torque", "torque_rate", "used", "block"


@dataclass(frozen=True, slots=True, eq=False)
class Smooth:
    """The torque of one stretch in the band of the rows, before it is thinned. torque, rate: (S, n) Nm, Nm/s at every
    sample, step_s apart. samples: (R,) which of them are rows.
    """

    torque: FloatArray
    rate: FloatArray
    step_s: float
    samples: IntArray

    @classmethod
    def of(cls, piece: ProcessedSignals, low_pass_hz: float) -> Smooth:
        """Of a stretch, filtered once; later or earlier torque is taken from it."""
        step = float(piece.time[1] - piece.time[0])
        torque = zero_phase_low_pass(piece.torque, step, low_pass_hz)
        samples = np.round((piece.evaluation_time - piece.time[0]) / step).astype(np.int64)
        return cls(torque, sixth_order_difference(torque, step), step, samples)

    def after(self, delay_s: float) -> tuple[FloatArray, FloatArray]:
        """(R, n) torque and rate so much later than the rows: of the nearest sample, and from there by the rate."""
        count = round(delay_s / self.step_s)
        places = np.clip(self.samples + count, 0, len(self.torque) - 1)
        rate = self.rate[places]
        return self.torque[places] + (delay_s - count * self.step_s) * rate, rate


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """R rows of n joints. position, velocity, acceleration: (R, n) rad, rad/s, rad/s². direction: (R, n), of Coulomb
    friction, −1 to 1; sharp: where it turns over at once and no model says otherwise. torque, torque_rate: (R, n) Nm,
    Nm/s. used: (R, n), false where a joint stands still. block:
    (R,) which stretch of time a row is in. spacing_s: distance of neighbours. smooth: the torque of every stretch, from
    which a later one is taken. clock_known: whether every recording has a velocity that goes with its positions.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    direction: FloatArray
    sharp: FloatArray
    torque: FloatArray
    torque_rate: FloatArray
    used: BoolArray
    block: IntArray
    spacing_s: float
    smooth: tuple[Smooth, ...]
    clock_known: bool = False

    @property
    def before(self) -> IntArray:
        """(R, n) how many rows without a break stand before each: those that its noise goes on from."""
        starts = np.zeros(len(self.block), dtype=np.bool_)
        starts[np.cumsum([0, *(len(stretch.samples) for stretch in self.smooth)])[:-1]] = True
        return preceded(self.used, starts)

    def torque_after(self, delay_s: float) -> tuple[FloatArray, FloatArray]:
        """(R, n) Nm and Nm/s, the torque and its rate so much later: of a torque that is late, those of these rows."""
        if delay_s == 0.0:
            return self.torque, self.torque_rate
        torque, rate = zip(*(stretch.after(delay_s) for stretch in self.smooth), strict=True)
        return np.concatenate(torque), np.concatenate(rate)


def excerpt(recording: Recording) -> Recording:
    """As many periods as every part of the rows needs to have blocks of: a motion repeated shows gravity no better."""
    if recording.period_index is None or recording.period_s is None:
        return recording
    enough = int(np.ceil(FEWEST_BLOCKS * BLOCK_S / recording.period_s))
    periods = np.unique(recording.period_index[recording.period_index >= 0])
    if len(periods) <= enough:
        return recording
    stop = int(np.argmax(recording.period_index == periods[enough]))
    return recording.rows(np.arange(recording.samples) < stop)


def band_of(recordings: Sequence[Recording]) -> float:
    """Hz, the cutoff that all of some recordings are compared up to."""
    step = max(recording.sampling_period_s for recording in recordings)
    return min(WIDEST_HZ, 1.0 / (SAMPLES_PER_CUTOFF_PERIOD * step))


def rows_of(recordings: Sequence[Recording], coulomb_velocity: Widths = 0.0) -> Rows:
    """The rows of recordings of one robot, one band for all. Raises RecordingError for one too short or at rest.

    coulomb_velocity: rad/s over which a model has Coulomb friction turn over, 0 where it says nothing.
    A joint whose torque never changes has none that was measured, so no row of it is used.
    """
    low_pass_hz = band_of(recordings)
    found: list[Rows] = []
    for recording in recordings:
        if float(np.ptp(recording.position, axis=0).max()) < SMALLEST_MOTION:
            raise RecordingError.at(
                recording.source.path,
                "no joint moves; a recording of a motion is needed to compare with a model.",
                field="q",
            )
        duration = min(BLOCK_S, recording.duration_s / FEWEST_BLOCKS)
        measured = np.ptp(recording.torque, axis=0) > 0.0
        pieces = process_aperiodic(recording, low_pass_hz)
        said = np.asarray(coulomb_velocity) > 0.0
        width = np.where(said, coulomb_velocity, _width_of(pieces))
        for piece in pieces:
            first = 1 + (int(found[-1].block[-1]) if found else -1)
            smooth = Smooth.of(piece, low_pass_hz)
            torque, rate = smooth.after(0.0)
            time = piece.evaluation_time
            found.append(
                Rows(
                    piece.project(piece.position),
                    piece.project(piece.velocity),
                    piece.project(piece.acceleration),
                    direction := piece.project(np.tanh(piece.velocity / width)),
                    np.where(said, direction, piece.project(np.sign(piece.velocity))),
                    torque,
                    rate,
                    piece.used & measured,
                    first + ((time - time[0]) / duration).astype(np.int64),
                    float(time[1] - time[0]),
                    (smooth,),
                )
            )
    arrays: dict[str, Any] = {name: np.concatenate([getattr(item, name) for item in found]) for name in _ARRAYS}
    clock_known = all(clock_by_velocity(recording) is not None for recording in recordings)
    smooth_all = tuple(each for item in found for each in item.smooth)
    joined = replace(found[0], **arrays, smooth=smooth_all, clock_known=clock_known)
    if int(joined.used.any(axis=1).sum()) < FEWEST_ROWS:
        raise RecordingError.at(
            recordings[0].source.path,
            f"the robot moves in fewer than {FEWEST_ROWS} rows of {low_pass_hz:.3g} Hz; "
            "a longer motion is needed to compare with a model.",
            field="q",
        )
    stride = -(-len(joined.block) // MOST_ROWS)
    return joined if stride == 1 else _thinned(joined, stride)


def _width_of(pieces: Sequence[ProcessedSignals]) -> FloatArray:
    """(n,) rad/s over which Coulomb friction of each joint turns over where no model says it."""
    speed = np.abs(np.concatenate([piece.velocity for piece in pieces])).max(axis=0)
    return np.asarray(np.clip(SHARE_OF_SPEED * speed, 1e-9, COULOMB_VELOCITY))


def _thinned(rows: Rows, stride: int) -> Rows:
    arrays: dict[str, Any] = {name: getattr(rows, name)[::stride] for name in _ARRAYS}
    first, smooth = 0, []
    for stretch in rows.smooth:
        smooth.append(replace(stretch, samples=stretch.samples[-first % stride :: stride]))
        first += len(stretch.samples)
    return replace(rows, **arrays, smooth=tuple(smooth), spacing_s=rows.spacing_s * stride)
