"""One motor whose turning is that of two joints together, as in a wrist with crossed shafts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import linear, shaped, size_of
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.motion import Motion


class JointCoupling(Effect):
    """Friction and inertia of a motor that turns with ω = q̇_j + r q̇_i, felt as f(ω) at joint j and r f(ω) at joint i.

    f(ω) = Fc sign(ω) + Fv ω + J ω̇; r times the same on the other joint is the principle of virtual work. Own friction
    and inertia of both joints stay in the nominal model.
    Usual: not on an iiwa; Fc 2 to 5 Nm, Fv 1 to 5 Nm s/rad, J 0.01 kg m² on a small wrist. Looks like: joint_crosstalk,
    rotor_inertia, distal_rotor_reaction. Source: Gautier, Vandanjon, Janot, TX40 with coupled wrist: IFAC World
    Congress 2011; Khalil, Dombre 2002, ch. 9.
    """

    name = "joint_coupling"
    sees_torque = False
    units = ("Nm", "Nm s/rad", "kg m²")
    separating_experiment = "Move joint i alone, then joint j alone, then both against each other at equal speed."

    def places(self, motion: Motion) -> Sequence[Place]:
        """Every revolute joint j with the revolute joint i before it."""
        kinematics = motion.robot.kinematics
        return tuple(
            Place(joint=joint + 1, other_joint=int(kinematics.parent[joint]) + 1)
            for joint in range(motion.n)
            if kinematics.parent[joint] >= 0
            and kinematics.revolute[joint]
            and kinematics.revolute[kinematics.parent[joint]]
        )

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The ratio r."""
        return (ShapeParameter("ratio", "1", (-1.0, 1.0), -3.0, 3.0, logarithmic=False),)

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Coulomb, viscous and inertial columns on both joints."""
        assert place.other_joint is not None, "coupling is between two joints"
        joint, other, ratio = joint_index(place), place.other_joint - 1, shape["ratio"]
        speed, acceleration = (
            rate[:, joint] + ratio * rate[:, other] for rate in (motion.velocity, motion.acceleration)
        )
        own = np.column_stack([np.sign(speed), speed, acceleration])
        return Columns((other, joint), np.stack([ratio * own, own], axis=1)) if own.any() else None

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Coulomb and viscous friction and inertia of the shared motor, and the ratio."""
        return (
            linear("coulomb", estimate, "Nm"),
            linear("viscous", estimate, "Nm s/rad", index=1),
            linear("inertia", estimate, "kg m²", index=2),
            shaped("ratio", estimate, "1"),
        )

    def sentence(self, estimate: Estimate) -> str:
        """Which joints, how large."""
        coulomb, viscous, inertia, ratio = self.parameters(estimate)
        sign = "plus" if ratio.value > 0.0 else "minus"
        times = "" if abs(abs(ratio.value) - 1.0) < 0.02 else f"{abs(ratio.value):.2f} times "
        return (
            f"One motor drives joints {estimate.place.other_joint} and {estimate.place.joint} together: friction and "
            f"inertia of the speed of joint {estimate.place.joint} {sign} {times}that of joint "
            f"{estimate.place.other_joint} act on both ({size_of(coulomb)}, {size_of(viscous)}, {size_of(inertia)})."
        )
