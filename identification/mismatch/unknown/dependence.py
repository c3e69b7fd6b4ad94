"""Which classes stand on which joint with no name beside them, and whether they predict rows that were not fitted.

Chosen on fitted and held-out rows together; weights and variances of the fitted rows alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from identification.mismatch.prepared import Prepared
from identification.mismatch.unknown.left import Left
from identification.mismatch.unknown.predictive import Dropped, predictive, refused
from identification.mismatch.unknown.rows import Rows, build_rows
from identification.mismatch.unknown.selection import FULL_ROUNDS, Held, Selection
from identification.mismatch.unknown.settings import ClaimSettings

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Dependence:
    """every: rows of both roles, all classes. held: what stands. alone: the same, weights of the fitted rows alone.

    before, after: RMS (n,) Nm on the fitted and on the held-out rows, without and with the classes. dropped: classes
    that the rows ask for and that predict others worse; only where the noise is not known. rival: the classes as names
    are judged against them, weights of the fitted rows alone; predicts: (n,) joints where they do not make rows that
    were not fitted worse, which counts where the noise is not known.
    """

    every: Rows
    held: tuple[Held, ...]
    alone: Selection
    left: Left
    before: tuple[FloatArray, FloatArray]
    after: tuple[FloatArray, FloatArray]
    dropped: tuple[Dropped, ...]
    rival: Selection
    predicts: BoolArray


def find_dependence(fitted: Prepared, unseen: Prepared | None, settings: ClaimSettings | None = None) -> Dependence:
    """The classes of what the nominal model leaves."""
    settings = settings if settings is not None else ClaimSettings()
    every = build_rows(fitted, unseen, settings)
    together = Selection.of(every, range(every.folds + every.heldout), settings).run()
    rows = every.limited([state.groups for state in together.states])
    rival, left, dropped = weighed(rows, settings), Left.of(rows), tuple[Dropped, ...]()
    before, after = left(Selection.of(rows, range(rows.folds), settings)), left(rival)
    predicts = after[1] < before[1] if every.heldout else np.ones(every.problem.n, dtype=np.bool_)
    alone = rival
    if every.heldout and not every.problem.noise_is_measured:
        # Rows whose noise is not known are no proof for each other: there a class has to predict, and weights rest on
        # what is left of rows that did not make them.
        before = left(Selection.nominal(rows, range(rows.folds), settings))

        def judge(selection: Selection) -> tuple[FloatArray, BoolArray]:
            rise = left(selection)[1] / before[1] - 1.0
            return rise, refused(selection, rise)

        alone, dropped = predictive(weighed(rows, settings, predicted=True), judge)
        after = left(alone)
    held = tuple(item for item in together.held if item.number in alone.families(item.joint, alone.states[item.joint]))
    return Dependence(every, held, alone, left, before, after, dropped, rival, predicts)


def weighed(rows: Rows, settings: ClaimSettings, *, predicted: bool = False) -> Selection:
    """All classes of the rows, with variances and weights of the fitted rows alone."""
    alone = Selection.of(rows, range(rows.folds), settings, predicted=predicted)
    for turn in range(2):
        for joint in range(rows.problem.n):
            if rows.asked[joint]:
                state = alone.states[joint] if turn else alone.full(joint)
                alone.states[joint] = alone.settled(joint, state, FULL_ROUNDS, quiet=0 if turn else FULL_ROUNDS)
    return alone
