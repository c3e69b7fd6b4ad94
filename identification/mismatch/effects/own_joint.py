"""What effects on one joint's own torque share: a place per joint, columns in that joint's row alone.

Units throughout the library are those of a revolute joint; for a prismatic joint read N for Nm and m for rad.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Columns, Effect, Estimate, Place
from identification.mismatch.motion import Motion


class OwnJointEffect(Effect):
    """An effect that adds torque to the joint it sits on, and to no other."""

    sees_torque: ClassVar[bool] = False

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """The joint's own row; None where the effect exerts no torque during this motion.

        On every joint at once (no joint in the place): columns of joint 1, of joint 2, …, each in its own row.
        """
        if place.joint is None and self.everywhere:
            own = [self.own_torque(motion, joint, shape) for joint in range(motion.n)]
            size = own[0].shape[1]
            together = np.zeros((motion.samples, motion.n, motion.n * size))
            for joint, part in enumerate(own):
                together[:, joint, joint * size : (joint + 1) * size] = part
            return Columns(tuple(range(motion.n)), together) if together.any() else None
        joint = joint_index(place)
        values = self.own_torque(motion, joint, shape)
        return Columns((joint,), values[:, None, :]) if values.any() else None

    def parts(self, estimate: Estimate) -> Sequence[Estimate]:
        """One for each joint where the effect is on every joint."""
        if estimate.place.joint is not None:
            return (estimate,)
        size = len(self.units)
        blocks = [slice(first, first + size) for first in range(0, estimate.coefficients.size, size)]
        return [
            replace(
                estimate, place=Place(joint=joint + 1), coefficients=estimate.coefficients[own],
                covariance=estimate.covariance[own, own],
                shape_covariance={name: values[own] for name, values in estimate.shape_covariance.items()},
            )
            for joint, own in enumerate(blocks)
        ]  # fmt: skip

    @abstractmethod
    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Torque per unit of each coefficient, (S, m) Nm. joint: counted from 0."""


def joint_index(place: Place) -> int:
    """The joint of a place, counted from 0. Raises ValueError for a place without one."""
    if place.joint is None:
        raise ValueError("this effect sits on one joint, and the place names none")
    return place.joint - 1


def friction_sign(motion: Motion, joint: int) -> FloatArray:
    """The direction of motion as the nominal Coulomb column has it: sign(q̇), 0 at rest, or a wider transition. (S,)."""
    return motion.direction[:, joint]
