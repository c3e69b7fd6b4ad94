"""The rigid torque on all joints as a function of one joint's displacement, known from a few places of that joint.

What lies behind a joint enters the inverse dynamics through two factors of the joint's own rotation (or shift) at most:
its inertia, turned into the frame before it, has two. So the torque is a trigonometric polynomial of degree two in the
position of a revolute joint, a polynomial of degree two in that of a sliding one; its velocity enters up to the square,
its acceleration linearly. Five places (three) tell everything, and any displacement after that is a sum of twenty
products instead of a recursion over the links.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.dynamics import chain_of, links_of
from identification.mismatch.motion import Motion
from identification.remembered import once_per_object

_REVOLUTE_PLACES = 2.0 * np.pi * np.arange(5) / 5
_SLIDING_PLACES = np.array([-1.0, 0.0, 1.0])


def change_of_torque(
    motion: Motion, joint: int, displacement: FloatArray, rate: FloatArray, growth: FloatArray
) -> FloatArray:
    """(S, n) Nm: rigid torque on all joints with a joint's (from 0) position, velocity and acceleration changed by the
    (S,) displacement in rad (m), its rate and its growth (first and second derivative), less that of the motion.
    """
    return _polynomial(motion, joint).change(displacement, rate, growth, slice(None))


def change_of_own_torque(
    motion: Motion, joint: int, displacement: FloatArray, rate: FloatArray, growth: FloatArray
) -> FloatArray:
    """(S,) Nm of the displaced joint alone, as `change_of_torque`."""
    return _polynomial(motion, joint).change(displacement, rate, growth, slice(joint, joint + 1))[:, 0]


@once_per_object
def _polynomial(motion: Motion, joint: int) -> _Polynomial:
    return _Polynomial.of(motion, joint)


@dataclass(frozen=True, slots=True, eq=False)
class _Polynomial:
    """coefficients: (S, n, 4 K) of the K functions of the displacement: alone, times its rate, the rate's square, its
    growth. The sum over them is the innermost axis: that is what makes it fast.
    """

    revolute: bool
    coefficients: FloatArray

    @classmethod
    def of(cls, motion: Motion, joint: int) -> _Polynomial:
        revolute = bool(motion.robot.kinematics.revolute[joint])
        places = _REVOLUTE_PLACES if revolute else _SLIDING_PLACES
        unit, reference, measured = np.eye(motion.n)[joint], links_of(motion), chain_of(motion)
        # What this joint's motion does by itself, its links feel alike at all places.
        by_square, by_growth = measured.alone(joint, 1.0, 0.0), measured.alone(joint, 0.0, 1.0)
        parts = np.empty((4, places.size, motion.samples, motion.n))
        for number, place in enumerate(places):
            chain = measured.moved(joint, float(place))
            still, ahead = (
                chain.forward(velocity, motion.acceleration, motion.robot.gravity, joint, reference)
                for velocity in (motion.velocity, motion.velocity + unit)
            )
            known, faster, square, growing = (
                chain.backward(links).torque for links in (still, ahead, by_square, by_growth)
            )
            parts[:, number] = known, faster - known - square, square, growing
        solved = np.tensordot(parts, np.linalg.inv(_functions(revolute, places)), axes=(1, 0))
        return cls(revolute, solved.transpose(1, 2, 0, 3).reshape(motion.samples, motion.n, -1))

    def change(self, displacement: FloatArray, rate: FloatArray, growth: FloatArray, joints: slice) -> FloatArray:
        """(S, len(joints)) Nm."""
        functions = _functions(self.revolute, displacement)
        moved = functions - _functions(self.revolute, np.zeros(1))
        weights = np.concatenate([moved, functions * rate, functions * rate**2, functions * growth])
        return np.asarray(np.einsum("snk,sk->sn", self.coefficients[:, joints], np.ascontiguousarray(weights.T)))


def _functions(revolute: bool, displacement: FloatArray) -> FloatArray:
    """(K, S) of a displacement (S,): the constant, and degrees one and two."""
    one = np.ones_like(displacement)
    if not revolute:
        return np.stack([one, displacement, displacement**2])
    sine, cosine = np.sin(displacement), np.cos(displacement)
    return np.stack([one, cosine, sine, cosine**2 - sine**2, 2.0 * sine * cosine])
