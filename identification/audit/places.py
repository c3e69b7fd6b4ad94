"""Which recorded positions and torques belong to which joint, and which way a joint counts: one search for all of it.

Two columns change places, positions, torques or both, as long as that makes rows that were not fitted clearly likelier
(`held_out`): each such step has to gain the same. Or one joint has another sign. On the rows that are fitted wrong
orders of torques do as well as the right one. Asked of a recording alone, where nothing of the arm is known, and beside
a model. An order from which no first step leads on, as all joints from the last to the first may be, is not found, nor
is more than one such mistake. Pure.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, groupby

import numpy as np

from identification.arrays import FloatArray
from identification.audit.columns import INERTIAL, PARAMETERS, SYMBOLS, columns_of
from identification.audit.comparison import LEAST_GAIN
from identification.audit.evidence import Products
from identification.audit.given import GivenModel, Sizes, sizes_of, wide_open
from identification.audit.held_out import FOLDS, STAYS, Asked, Score
from identification.audit.reading import Columns, Reading
from identification.audit.rows import excerpt, rows_of
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel

KINDS = 3
"""Of a mistake: of positions, of positions and torques, and of torques."""


@dataclass(frozen=True, slots=True)
class Misplaced:
    """reading: under which every column is that of its joint. explained: share of the misfit that goes, of the joints
    that take part. clear: whether next to nothing of it stays, or it is the likeliest without a model too.
    """

    reading: Reading
    explained: float
    clear: bool


def misplaced_joints(
    recordings: Sequence[Recording], robot: RobotModel, other_gravity: FloatArray | None = None
) -> Reading | None:
    """How the columns of recordings have to be read; None where they stand well, or nothing clearly explains them.

    other_gravity: (3,) m/s², another stand of the base, than which a reading must be clearly likelier. Joints that
    follow others are not asked. Raises RecordingError for recordings at rest or too short.
    """
    if robot.mimics or robot.n < 2:
        return None
    asked = Asked.of(rows_of([excerpt(recording) for recording in recordings]), robot)
    rivals = [] if other_gravity is None else [asked.of_reading(asked.geometry.columns(other_gravity))]
    return next((each.reading for each in likeliest(asked, [None], rivals) if each.clear), None)


def likeliest(asked: Asked, models: Sequence[GivenModel | None], rivals: Sequence[Score] = ()) -> list[Misplaced]:
    """The likeliest reading beside each of some models, each once; none where the columns stand well.

    models: None where nothing of the arm is known. rivals: other explanations, which a reading is held against as it is
    against torques of the wrong sign alone.
    """
    asked = replace(asked, rows=replace(asked.rows, smooth=()))  # no reading is later or earlier
    n, found = len(asked.sizes.torque), dict[Reading, Misplaced]()
    stated = Reading.as_recorded(n)
    turns = _changed(stated, [_turned(n, joint) for joint in range(n)])
    scores = dict(_scored(asked, models, [stated], [-np.inf] * len(models)))
    least = [each.nats for each in scores[stated]]
    scores.update(_scored(asked, models, [*turns, *_changed(stated, _swaps(n))], least))
    for place, model in enumerate(models):
        ends = list(turns)
        for kind in range(KINDS):
            best, gain = stated, np.inf
            while gain > LEAST_GAIN:
                reading, steps = best, _changed(best, _swaps(n))[kind::KINDS]
                scores.update(_scored(asked, models, [each for each in steps if each not in scores], least))
                best = max(reading, *steps, key=lambda each: scores[each][place].nats)
                gain = scores[best][place].nats - scores[reading][place].nats
            ends.append(reading)
        reading = max(ends, key=lambda each: scores[each][place].nats)
        in_place = (each[place] for other, each in scores.items() if not other.places.is_other)
        score, rival = scores[reading][place], max((*in_place, *rivals), key=lambda each: each.nats)
        if reading.places.is_other and score.nats - rival.nats > LEAST_GAIN:
            # Beside free parameters of all bodies a column out of place is felt by every joint.
            part = slice(None) if model is None else np.abs(np.array(reading.torque))[np.array(reading.joints) - 1] - 1
            times = float((rival.square[part] / score.square[part]).mean())
            found[reading] = Misplaced(reading, 1.0 - 1.0 / times, STAYS * times >= 1.0 or reading in found)
    return list(found.values())


def _swaps(n: int) -> list[Columns]:
    """Two columns of n in each other's place."""
    every = range(1, n + 1)
    return [tuple({a: b, b: a}.get(joint, joint) for joint in every) for a, b in combinations(every, 2)]


def _turned(n: int, joint: int) -> Columns:
    """One column of n, from 0, with the other sign."""
    return tuple(-each if each == joint + 1 else each for each in range(1, n + 1))


def _changed(reading: Reading, changes: Sequence[Columns]) -> list[Reading]:
    """With each change of the motion, of motion and torque, and of the torque: KINDS in turns."""
    own = Reading.as_recorded(len(reading.motion)).motion
    each = ((Reading(change, own), Reading(change, change), Reading(own, change)) for change in changes)
    return [reading.then(change) for kinds in each for change in kinds]


def _scored(
    asked: Asked, models: Sequence[GivenModel | None], readings: Sequence[Reading], least: Sequence[float]
) -> Iterator[tuple[Reading, list[Score]]]:
    """Each reading's score beside each model, no further than it may be as likely as the least nats there. Its squares
    (n,) are in the order of the recorded torques.
    """

    def motion_of(reading: Reading) -> Columns:
        return reading.motion

    robot, counts = asked.geometry.robot, asked.rows.used.sum(axis=0)
    for _, alike in groupby(sorted(readings, key=motion_of), motion_of):
        moved: _Moved | None = None
        for reading in alike:
            rows = reading.of_rows(asked.rows)
            there = replace(asked, rows=rows, sizes=sizes_of(robot, rows))
            moved = moved or _Moved.of(there, asked.rows.torque)
            products, order = moved.products(reading.torque), np.argsort(np.abs(reading.torque))
            squares = []
            for model, nats in zip(models, least, strict=True):
                values, widths = _known(model, there.sizes)
                free = np.flatnonzero(widths)
                score = there.score(products.beside(values).of(free), widths[free], nats)
                squares.append(score.square[order])
            yield reading, [Score.of(square, counts) for square in squares]


@dataclass(frozen=True, slots=True, eq=False)
class _Moved:
    """Columns of one motion with every recorded torque. own: products with the torques as they are read. right:
    (folds, n, n, K), square: (folds, n, n) of a joint's columns with each torque.
    """

    own: Products
    right: FloatArray
    square: FloatArray

    @classmethod
    def of(cls, asked: Asked, torque: FloatArray) -> _Moved:
        """Of rows with their motion read so, and the recorded torque (R, n)."""
        columns = columns_of(asked.geometry.robot, asked.rows, asked.gravity)
        own = asked.products(columns, asked.rows.torque)
        right = np.empty((*own.count.shape, *columns.shape[1:]))
        square = np.empty(right.shape[:3])
        for joint, used in enumerate(asked.rows.used.T):
            for fold in range(FOLDS):
                here = used & (asked.fold == fold)
                right[fold, joint] = torque[here].T @ columns[here, joint]
                square[fold, joint] = (torque[here] ** 2).sum(axis=0)
        return cls(own, right, square)

    def products(self, torque: Columns) -> Products:
        """With the recorded torques in an order and with signs."""
        joints, order = np.arange(len(torque)), np.abs(torque) - 1
        right = np.sign(torque)[:, None] * self.right[:, joints, order]
        return replace(self.own, right=right, square=self.square[:, joints, order])


def _known(model: GivenModel | None, sizes: Sizes) -> tuple[FloatArray, FloatArray]:
    """Values (14 n,) of the parameters, and their widths: beside a model all stay but offsets, and the friction of
    which a drawn one says nothing.
    """
    widths = wide_open(sizes)
    if model is None:
        return np.zeros_like(widths), widths
    symbols = ("OFF",) if model.own else SYMBOLS[INERTIAL:-1]
    free = np.isin(np.arange(len(widths)) % PARAMETERS, [SYMBOLS.index(symbol) for symbol in symbols])
    return model.values, np.where(free, widths, 0.0)
