"""A constant load on the last link that the model does not have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place
from identification.mismatch.effects.describe import linear, size_of
from identification.mismatch.motion import Motion
from identification.regressor import INERTIAL_SYMBOLS, link_columns

_UNITS = ("kg", *3 * ("kg m",), *6 * ("kg m²",))


class Payload(Effect):
    """The ten parameters of the last link: a constant payload is the same as another last link.

    A fit with free link parameters takes it up whole, so it shows only against parameters from elsewhere. It stands
    here so that the tool says so. A payload that changes during the recording is payload_change.
    Usual: 0 to 14 kg. Looks like: torque_sensor_gain, joint_zero_offset, joint_elasticity. Source: Khalil, Gautier,
    Lemoine, Identification of the payload inertial parameters, ICRA 2007.
    """

    name = "payload"
    sees_torque = False
    units = _UNITS
    separating_experiment = "Record the same motion with and without the load, or take the last link from CAD."

    def places(self, motion: Motion) -> Sequence[Place]:
        """The last link of every branch."""
        parents = {int(parent) for parent in motion.robot.kinematics.parent}
        return tuple(Place(link=link + 1) for link in range(motion.n) if link not in parents)

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """The link's ten columns of the regressor, on the joints that carry it."""
        assert place.link is not None, "a payload sits on a link"
        return Columns(*columns_of_link(motion, place.link - 1))

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Mass, first moments and inertia tensor about the link frame's origin."""
        return tuple(
            linear(f"delta_{symbol}", estimate, unit, index=index)
            for index, (symbol, unit) in enumerate(zip(INERTIAL_SYMBOLS, _UNITS, strict=True))
        )

    def sentence(self, estimate: Estimate) -> str:
        """The mass."""
        mass = self.parameters(estimate)[0]
        return f"Link {estimate.place.link} carries {size_of(mass)} more than the model has (constant payload)."


def columns_of_link(motion: Motion, link: int) -> tuple[tuple[int, ...], FloatArray]:
    """Joints (from 0) that carry a link (from 0), and their torque per unit of its ten parameters (S, joints, 10)."""
    joints = motion.robot.kinematics.upstream(link)
    states = (motion.position, motion.velocity, motion.acceleration)
    return joints, np.take(link_columns(motion.robot, *states, link, range(len(INERTIAL_SYMBOLS))), joints, axis=1)
