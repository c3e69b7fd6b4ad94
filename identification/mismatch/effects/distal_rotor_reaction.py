"""The spinning rotor of a motor, felt by the joints that carry it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place
from identification.mismatch.effects.describe import linear, size_of
from identification.mismatch.effects.dynamics import rotor_reactions
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.motion import Motion


class DistalRotorReaction(Effect):
    """h z_i · d/dt(z_j q̇_j) on every joint i before j, h = N_j J_r,j with the sign of the gear.

    Joint j's own sensor, behind the gear, does not feel its rotor; the joints before it carry motor and all.
    Usual: 0.005 to 0.03 kg m². Looks like: torque_sensor_gain, rotor_inertia. Source: Sciavicco, Siciliano, Villani,
    Lagrange and Newton-Euler modelling of geared robots, 1995.
    """

    name = "distal_rotor_reaction"
    sees_torque = False
    units = ("kg m²",)
    separating_experiment = "Accelerate the carrying joint j alone and hard, the joints before it at rest."

    def places(self, motion: Motion) -> Sequence[Place]:
        """Every revolute joint that another joint carries; the joint named is the one whose rotor spins."""
        kinematics = motion.robot.kinematics
        return tuple(
            Place(joint=joint + 1)
            for joint in range(motion.n)
            if kinematics.revolute[joint] and kinematics.parent[joint] >= 0
        )

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Reaction on the joints before, per kg m² of N J_r."""
        joint = joint_index(place)
        before = motion.robot.kinematics.upstream(joint)[:-1]
        values = rotor_reactions(motion)[:, list(before), joint, None]
        return Columns(before, values) if values.any() else None

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Ratio times rotor inertia."""
        return (linear("ratio_times_rotor_inertia", estimate, "kg m²"),)

    def sentence(self, estimate: Estimate) -> str:
        """Whose rotor, how large."""
        (inertia,) = self.parameters(estimate)
        return (
            f"The joints before joint {estimate.place.joint} feel its motor spin up and turn: gear ratio times rotor "
            f"inertia is {size_of(inertia)} (rotor reaction)."
        )
