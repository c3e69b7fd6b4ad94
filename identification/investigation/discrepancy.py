"""What may be there beside a hypothesis without a form: classes of dependence, each as large as the recordings ask for.

Their columns on any motion, recorded or planned. A motion that leaves the recorded ranges meets functions that nobody
has seen: there the same functions, held at the ends of the ranges, begin anew with weights of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.mismatch.motion import Motion
from identification.mismatch.unknown.classes import CLASSES, Basis, Part
from identification.mismatch.unknown.inputs import Inputs, Ranges
from identification.mismatch.unknown.selection import JointState
from identification.signals.processed import LinearOperator

Variances = tuple[FloatArray, ...]
"""Of each basis of each joint, Nm²; 0: not there."""


@dataclass(frozen=True, slots=True, eq=False)
class Discrepancies:
    """bases: per joint, the classes that some hypothesis has beside it. ranges: of the recorded motions.

    fade_width: as in `Inputs`.
    """

    bases: tuple[tuple[Basis, ...], ...]
    ranges: Ranges
    fade_width: float

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number q of columns of each joint."""
        return tuple(sum(2 * basis.centre.size for basis in bases) for bases in self.bases)

    def columns(self, motion: Motion, project: LinearOperator) -> tuple[tuple[IntArray, FloatArray], ...]:
        """Per joint places (k,) among its q columns, and these columns (R, k) Nm per unit weight, all others being
        zero: of each basis within the recorded ranges, then beyond them, where few motions are.
        """
        inputs = Inputs(motion, self.ranges, self.fade_width, self.ranges)
        shared: dict[tuple[int, int], Part] = {}
        found = []
        for bases in self.bases:
            places, parts, start = [], [], 0
            for basis in bases:
                kind, key = CLASSES[basis.number], (basis.number, basis.group)
                values, inside = shared[key] if key in shared else kind.functions(basis.group)(inputs, basis.joint)
                if kind.shared:
                    shared[key] = values, inside
                for share in (inside, 1.0 - inside):
                    own = np.arange(start, start + basis.centre.size)
                    start += own.size
                    if share.any():
                        places.append(own)
                        parts.append(basis.scaled((values, share)))
            there = np.concatenate(places) if places else np.zeros(0, dtype=np.int64)
            found.append((there, project(np.concatenate(parts, axis=1)) if parts else np.zeros((0, 0))))
        return tuple(found)

    def over(self, motions: Sequence[Motion]) -> Discrepancies:
        """The same classes over the ranges of these motions together, as they are once all of them are recorded."""
        ranges = Ranges.of(motions)
        inputs = [Inputs(motion, ranges, self.fade_width) for motion in motions]
        shared: dict[tuple[int, int, int], Basis] = {}
        found = []
        for bases in self.bases:
            own = []
            for basis in bases:
                joint = -1 if CLASSES[basis.number].shared else basis.joint
                key = basis.number, basis.group, joint
                if key not in shared:
                    functions = CLASSES[basis.number].functions(basis.group)
                    shared[key] = Basis.of(*key[:2], basis.joint, [functions(each, basis.joint) for each in inputs])
                own.append(replace(shared[key], joint=basis.joint))
            found.append(tuple(own))
        return Discrepancies(tuple(found), ranges, self.fade_width)

    def deviations(self, variances: Variances) -> tuple[FloatArray, ...]:
        """Per joint (q,) standard deviation of each column's weight."""
        return tuple(
            np.repeat(np.sqrt(own), [2 * basis.centre.size for basis in bases])
            for own, bases in zip(variances, self.bases, strict=True)
        )


def variances_of(states: Sequence[JointState], counts: Sequence[int]) -> Variances:
    """Of all bases of each joint, those that a state does not hold at 0. counts: number of bases of each joint."""
    found = []
    for state, count in zip(states, counts, strict=True):
        own = np.zeros(count)
        own[list(state.groups)] = state.hyper.variance
        found.append(own)
    return tuple(found)
