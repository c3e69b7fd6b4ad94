"""Which classes stand on which joint with no name beside them, and whether they predict rows that were not fitted.

Chosen on fitted and held-out rows together; weights and variances of the fitted rows alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from identification.mismatch.prepared import Prepared
from identification.mismatch.unknown.left import Left
from identification.mismatch.unknown.rows import Rows, build_rows
from identification.mismatch.unknown.selection import FULL_ROUNDS, Held, Selection
from identification.mismatch.unknown.settings import ClaimSettings

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Dependence:
    """every: rows of both roles, all classes. held: what stands. alone: the same, weights of the fitted rows alone.

    before, after: RMS (n,) Nm on the fitted and on the held-out rows, without and with the classes.
    """

    every: Rows
    held: tuple[Held, ...]
    alone: Selection
    left: Left
    before: tuple[FloatArray, FloatArray]
    after: tuple[FloatArray, FloatArray]

    @property
    def predicts(self) -> BoolArray:
        """(n,) joints whose classes do not make rows that were not fitted worse."""
        if not self.every.heldout:
            return np.ones(self.every.problem.n, dtype=np.bool_)
        return np.asarray(self.after[1] < self.before[1])


def find_dependence(fitted: Prepared, unseen: Prepared | None, settings: ClaimSettings | None = None) -> Dependence:
    """The classes of what the nominal model leaves."""
    settings = settings if settings is not None else ClaimSettings()
    every = build_rows(fitted, unseen, settings)
    together = Selection.of(every, range(every.folds + every.heldout), settings).run()
    alone = weighed(every.limited([state.groups for state in together.states]), settings)
    left = Left.of(alone.rows)
    plain = Selection.of(alone.rows, range(alone.rows.folds), settings)
    return Dependence(every, tuple(together.held), alone, left, left(plain), left(alone))


def weighed(rows: Rows, settings: ClaimSettings) -> Selection:
    """All classes of the rows, with variances and weights of the fitted rows alone."""
    alone = Selection.of(rows, range(rows.folds), settings)
    for turn in range(2):
        for joint in range(rows.problem.n):
            if rows.asked[joint]:
                state = alone.states[joint] if turn else alone.full(joint)
                alone.states[joint] = alone.settled(joint, state, FULL_ROUNDS, quiet=0 if turn else FULL_ROUNDS)
    return alone
