"""Which classes stand on which joint with no name beside them, and whether they predict rows that were not fitted.

Chosen on fitted and held-out rows together; weights and variances of the fitted rows alone.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import chain

from identification.arrays import FloatArray
from identification.mismatch.prepared import Prepared
from identification.mismatch.settings import PRIOR_COST
from identification.mismatch.unknown.angle_search import HeldAngle, settled_angles, with_angles, worth
from identification.mismatch.unknown.choice import choose_classes, kept, without_background_of_few
from identification.mismatch.unknown.further import asked_further, left_more_than_noise
from identification.mismatch.unknown.left import Left
from identification.mismatch.unknown.predictive import Dropped, useful
from identification.mismatch.unknown.rows import Rows, build_rows
from identification.mismatch.unknown.selection import Held, Selection


@dataclass(frozen=True, slots=True, eq=False)
class Dependence:
    """every: rows of both roles, all classes. held: what stands. chosen: its groups in `every`, of each joint. alone:
    the same, weights of the fitted rows alone.

    after: RMS (n,) Nm that they leave of the fitted and of the held-out rows. dropped: classes that the rows ask for
    and that predict others worse; only where the noise is not known. angles: joints whose angle is off; their columns
    stand in the rows beside the base parameters.
    """

    every: Rows
    held: tuple[Held, ...]
    chosen: tuple[tuple[int, ...], ...]
    alone: Selection
    left: Left
    after: tuple[FloatArray, FloatArray]
    dropped: tuple[Dropped, ...]
    angles: tuple[HeldAngle, ...] = ()


def find_dependence(fitted: Prepared, unseen: Prepared | None, named: Collection[int] = ()) -> Dependence:
    """The classes of what the nominal model leaves. named: joints (from 0) that names are proposed for."""
    usual = build_rows(fitted, unseen, named)
    together, angles = _with_angles(usual)
    every = together.rows
    if every.problem.noise_is_measured or not every.heldout:
        rows = every.limited([state.groups for state in together.states])
        return _found(together, weighed(rows, predicted=True), Left.of(rows), (), angles)
    # Rows whose noise is not known are no proof for each other: there a class has to predict.
    alone, left, dropped = _predicting(together)
    together = kept(together, alone)
    if without_background_of_few(together):
        alone, left, dropped = _predicting(together)
        together = kept(together, alone)
    return _found(together, alone, left, dropped)


def _with_angles(rows: Rows) -> tuple[Selection, tuple[HeldAngle, ...]]:
    """The classes of all joints, and the angles that are off where that is worth it, before functions that are put in
    one by one and after.
    """
    plain = _chosen_on(rows)
    found, angles = with_angles(plain, rows, _chosen_on)
    found = _grown(found)
    if angles and worth(grown := _grown(plain)) > worth(found) - PRIOR_COST:
        return grown, ()
    return found, angles


def _chosen_on(rows: Rows) -> Selection:
    return choose_classes(Selection.of(rows, rows.parts, predicted=True))


def _grown(together: Selection) -> Selection:
    """With functions of one other joint and narrow ones, where the classes leave more than noise."""
    joints = left_more_than_noise(together)
    return asked_further(together, joints) if joints else together


def _predicting(together: Selection) -> tuple[Selection, Left, tuple[Dropped, ...]]:
    """Of the classes that stand, those that predict rows which were not fitted, weights of the fitted rows alone."""
    rows = together.rows.limited([state.groups for state in together.states])
    left = Left.of(rows)
    before = left(Selection.nominal(rows, range(rows.folds)))[1]
    alone, dropped = useful(weighed(rows, predicted=True), lambda item: left(item)[1], before)
    return alone, left, dropped


def _found(
    together: Selection,
    alone: Selection,
    left: Left,
    dropped: tuple[Dropped, ...],
    angles: tuple[HeldAngle, ...] = (),
) -> Dependence:
    held = tuple(item for item in together.held if item.number in alone.families(item.joint, alone.states[item.joint]))
    chosen = tuple(state.groups for state in together.states)
    return Dependence(together.rows, held, chosen, alone, left, left(alone), dropped, angles)


def beside_names(found: Dependence, torque: Sequence[Sequence[FloatArray]]) -> Selection:
    """The classes that were chosen without names, weighed anew beside these.

    torque: (R, n) Nm of each evidence of the fitted and of the held-out rows, without that of the names.
    """
    rows = found.alone.rows.limited([state.groups for state in found.alone.states])
    return weighed(rows.with_torque(list(chain(*torque))), predicted=True)


def weighed(rows: Rows, *, predicted: bool = False) -> Selection:
    """All classes of the rows, with variances and weights of the fitted rows alone."""
    plain = Selection.of(rows, range(rows.folds), predicted=predicted)
    return settled_angles(plain.with_groups([range(len(joint.bases)) for joint in rows.joints]))
