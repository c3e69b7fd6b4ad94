"""Play in a gear: the link drops from one tooth flank to the other when the torque reverses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import joint_name, linear, shaped, size
from identification.mismatch.effects.displacement import torque_of_displacement
from identification.mismatch.effects.dynamics import rigid_torque
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.motion import Motion


class Backlash(Effect):
    """ID(q − ½ ε tanh(τ̂_j/τ₀)) − ID(q): position before the gear misses the play ε, on the side the load presses to.

    The dead zone of the teeth, T = k (θ ∓ ε/2) outside and 0 within, solved for the link's position under a given
    torque; tanh with the width τ₀ stands for the crossing, whose acceleration gives the torque transient. Only where
    position is measured before the gear and only for a joint whose torque changes its sign.
    Usual: 0 for harmonic drives (the iiwa); 0.3 to 3 mrad for planetary and spur gears. Looks like: joint_elasticity,
    torque_sensor_gain, bending_crosstalk. Source: Nordin, Gutman, Controlling mechanical systems with backlash: a
    survey, Automatica 38(10), 2002.
    """

    name = "backlash"
    units = ("rad",)
    separating_experiment = "Rock the joint slowly about the pose where its torque is zero, then about a loaded pose."

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The torque τ₀ over which the flank changes; with more than 0.3 of the largest it would be a spring."""
        scale = max(float(np.abs(rigid_torque(motion).torque[:, joint_index(place)]).max()), 1e-9)
        grid = tuple(share * scale for share in (0.03, 0.1, 0.3))
        return (ShapeParameter("crossing_torque", "Nm", grid, 0.01 * scale, 0.3 * scale),)

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Torque on all joints per rad of play; None where the torque never reverses."""
        joint = joint_index(place)
        torque = rigid_torque(motion).torque[:, joint]
        if not torque.min() < 0.0 < torque.max():
            return None
        values = torque_of_displacement(motion, joint, -0.5 * np.tanh(torque / shape["crossing_torque"]))
        return Columns(tuple(range(motion.n)), values[..., None]) if values.any() else None

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The play ε and the torque of the crossing."""
        return linear("play", estimate, "mrad", scale=1000.0), shaped("crossing_torque", estimate, "Nm")

    def sentence(self, estimate: Estimate) -> str:
        """How much play."""
        play, _ = self.parameters(estimate)
        return (
            f"{joint_name(estimate)}'s gear has play: its link drops by {size(play.value, play.std, 'mrad')} when the "
            "torque changes its sign (backlash)."
        )
