"""Functions of one input more: another joint's, a bending moment, the sum of two angles, what an input was long before.

Each alone, or as large as an input of the joint that asks: friction is its direction of motion, as large as something
else. Not here: which class they belong to (`classes`), and on which joints they are asked (`further`).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.unknown.functions import straight_and_bent
from identification.mismatch.unknown.inputs import Inputs

Part = tuple[FloatArray, FloatArray]
"""Functions (S, m) before they are centred and scaled, and their fade (S,)."""
Functions = Callable[[Inputs, int], Part]
"""Those of a joint (from 0) on a motion."""

FARTHEST = 8
"""Joints from one to another of which functions are asked alone."""
SLOW_S = 0.2 * np.sqrt(10.0) ** np.arange(1, 4)
"""Lags of what heats, creeps or flows: those of `classes.LAGS_S` go on at the same steps."""


@dataclass(frozen=True, slots=True)
class OfOther:
    """The functions that `of_one` makes of a joint, of that `offset` further out (0: its own); none where none is.

    gate: the input of the asking joint they are as large as, "direction" of motion, "velocity" or "load"; "": none.
    """

    of_one: Functions
    offset: int = 0
    gate: str = ""

    def __call__(self, inputs: Inputs, joint: int) -> Part:
        """Those on a motion, asked for a joint (from 0)."""
        other = joint + self.offset
        if not 0 <= other < inputs.motion.n:
            return none_of(inputs)
        values, inside = self.of_one(inputs, other)
        return gated(inputs, joint, self.gate, values, inside) if self.gate else (values, inside)

    def same_for(self, joint: int) -> Hashable:
        """What is the same of functions that are the same, asked for a joint (from 0)."""
        return self.of_one, joint + self.offset, self.gate, joint if self.gate else None


def none_of(inputs: Inputs) -> Part:
    """What stands for functions of a joint that is not there."""
    return np.zeros((inputs.motion.samples, 1)), np.ones(inputs.motion.samples)


def gated(inputs: Inputs, joint: int, gate: str, values: FloatArray, inside: FloatArray) -> Part:
    """Functions (S, m) with their fade (S,), as large as an input of a joint (from 0)."""
    own = np.clip(getattr(inputs, gate)[:, joint, None], -1.0, 1.0)
    return values * own, inside if gate == "direction" else inside * inputs.inside(gate)[:, joint]


def of_one_other(functions: Functions, gate: str = "") -> tuple[OfOther, ...]:
    """The same functions of one other joint each, in the order of how much further out it is."""
    return tuple(OfOther(functions, offset, gate) for offset in (*range(-FARTHEST, 0), *range(1, FARTHEST + 1)))


def of_moments(kind: tuple[float, int]) -> tuple[OfOther, ...]:
    """Functions of each of the two moments that bend a joint, alone and as large as what the joint does (Palmgren
    1959: so is the friction of its bearing; the gain of its sensor may be).
    """

    def of(which: int) -> Functions:
        def columns(inputs: Inputs, joint: int) -> Part:
            place = inputs.moments[:, joint, which] / max(float(inputs.ranges.bending[joint, which]), 1e-9)
            return straight_and_bent(place, kind), inputs.inside("torque").prod(axis=1)

        return columns

    return tuple(OfOther(of(which), gate=gate) for which in (0, 1) for gate in ("", "direction", "velocity", "load"))


def of_sums(*kinds: tuple[float, int]) -> tuple[OfOther, ...]:
    """Functions of the sum and of the difference of a joint's position and a neighbour's, of some lengths: what turns
    with both, as teeth of a wrist or a hose along two joints.
    """

    def of(offset: int, sign: float, kind: tuple[float, int]) -> Functions:
        def columns(inputs: Inputs, joint: int) -> Part:
            other = joint + offset
            if not 0 <= other < inputs.motion.n:
                return none_of(inputs)
            lower, upper = inputs.ranges.bounds("position")
            own, second = (inputs.position[:, item] * (upper - lower)[item] for item in (joint, other))
            place = (own + sign * second) / max(float((upper - lower)[[joint, other]].sum()), 1e-9)
            return straight_and_bent(place, kind), inputs.inside("position")[:, [joint, other]].prod(axis=1)

        return columns

    return tuple(OfOther(of(offset, sign, kind)) for kind in kinds for offset in (-1, 1) for sign in (1.0, -1.0))


def of_slow(name: str, *, size: bool = False, gate: str = "") -> OfOther:
    """An input of the joint, or its size, now and as it was long before."""

    def columns(inputs: Inputs, joint: int) -> Part:
        value = np.clip(getattr(inputs, name)[:, joint, None], -1.0, 1.0)
        value = np.abs(value) if size else value
        return np.concatenate([value, inputs.late(value, SLOW_S)], axis=1), inputs.inside(name)[:, joint]

    return OfOther(columns, gate=gate)
