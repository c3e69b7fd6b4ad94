"""A joint whose true angle is not the measured one: off by functions of its own load or position, without a form.

A gear that yields by any law, a kinematic error of the gear, an encoder beside its axis. The displacement of one joint
makes torque on all of them, so the functions of a hypothesis are columns of all joints, with one variance for each
group. Here: the functions and their torque. Not here: whether an arm holds any (`angle_search`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.displacement import torque_of_small
from identification.mismatch.unknown.classes import CLASSES, NOTHING, Functions, Part, load_functions
from identification.mismatch.unknown.inputs import Inputs

SMALLEST_RAD = 1e-8
"""Deviation below which functions of an angle are none: the finest encoders tell no more."""


def _own(name: str) -> tuple[Functions, ...]:
    return next(kind.groups for kind in CLASSES if kind.name == name)


ANGLES: dict[str, tuple[str, tuple[Functions, ...]]] = {
    "own_load": ("load", load_functions("load")),
    "own_position": ("position", _own("own_position")),
}
"""Class name → the input that the angle is off by functions of, and these in groups, each with its own variance.

Of the load of the rigid links: friction turns round, and a jump of an angle has no acceleration.
"""


@dataclass(frozen=True, slots=True, eq=False)
class AngleBasis:
    """Functions of one group on all motions, centred, and scaled so that unit weights displace by a mean square of one.

    The first group holds a constant besides, the last of its functions: a function of no known form has a mean.
    name: in ANGLES. group: which one. joint: from 0. centre: (m,), without the constant. scale: one number, rad.
    """

    name: str
    group: int
    joint: int
    centre: FloatArray
    scale: float

    @classmethod
    def of(cls, name: str, group: int, joint: int, motions: Sequence[Inputs]) -> AngleBasis | None:
        """On some motions; None where the input does not move."""
        values = np.concatenate([ANGLES[name][1][group](each, joint)[0] for each in motions])
        centre = values.mean(axis=0)
        square = float(((values - centre) ** 2).sum(axis=1).mean())
        return cls(name, group, joint, centre, 1.0 / np.sqrt(square)) if square > NOTHING else None

    def displacement(self, inputs: Inputs) -> FloatArray:
        """(S, m) rad that the true angle is more than the measured one, of each unit weight."""
        part: Part = ANGLES[self.name][1][self.group](inputs, self.joint)
        values, inside = part
        moved = (values - self.centre) * (self.scale * inside)[:, None]
        return np.column_stack([moved, inside]) if self.group == 0 else np.asarray(moved)

    @property
    def functions(self) -> int:
        """How many there are."""
        return int(self.centre.size) + (self.group == 0)

    def torque(self, inputs: Inputs) -> Iterator[FloatArray]:
        """(S, m) Nm of each unit weight on each of all joints, to first order."""
        return torque_of_small(inputs.motion, self.joint, self.displacement(inputs))
