"""A torque sensor that also reads part of a neighbouring joint's torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place
from identification.mismatch.effects.describe import linear, size_of
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.motion import Motion


class JointCrosstalk(Effect):
    """c · τ̂_i read on joint j, i the joint before or after j.

    Where the axes are such that joint i's torque is a bending moment at joint j (joint 2 on joint 1 of an iiwa), this
    and bending crosstalk are the same torque.
    Usual: 0.2 to 2 %. Looks like: bending_crosstalk, base_tilt. Source: Lee, Kim, Song, calibration of joint torque
    sensors with crosstalk compensation, 2010.
    """

    name = "joint_crosstalk"
    units = ("1",)
    separating_experiment = "Move and load joint i alone while joint j stands still, then the other way round."

    def places(self, motion: Motion) -> Sequence[Place]:
        """Both directions of every pair of neighbours in the chain."""
        parent = motion.robot.kinematics.parent
        pairs = [(joint + 1, int(parent[joint]) + 1) for joint in range(motion.n) if parent[joint] >= 0]
        return tuple(Place(joint=a, other_joint=b) for pair in pairs for a, b in (pair, pair[::-1]))

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """The neighbour's nominal torque, in this joint's row."""
        assert place.other_joint is not None, "crosstalk is between two joints"
        other = place.other_joint - 1
        values = motion.torque[:, other : other + 1, None]
        return Columns((joint_index(place),), values) if values.any() else None

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The share that is read, in per cent of the other joint's torque."""
        return (linear("crosstalk", estimate, "%", scale=100.0),)

    def sentence(self, estimate: Estimate) -> str:
        """Which joint reads how much of which."""
        (crosstalk,) = self.parameters(estimate)
        return (
            f"Joint {estimate.place.joint}'s torque sensor also reads {size_of(crosstalk)} of joint "
            f"{estimate.place.other_joint}'s torque (crosstalk)."
        )
