"""A base that does not stand level."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place
from identification.mismatch.effects.describe import harmonic, linear, size
from identification.mismatch.effects.dynamics import across, tilt_torques
from identification.mismatch.motion import Motion


class BaseTilt(Effect):
    """Gravity turned in the base's frame: g − ε × g, ε the small rotation of the base about two level axes.

    Shows first on a joint whose axis should be vertical, which a level base loads with no gravity at all.
    Usual: 0.1 to 1°. Looks like: joint_crosstalk, bending_crosstalk. Source: Pinocchio/Featherstone inverse dynamics,
    linear in gravity; Gautier, Khalil, IEEE Trans. Robot. 6, 1990.
    """

    name = "base_tilt"
    units = ("rad", "rad")
    separating_experiment = "Level the base; or turn joint 1 alone with the arm stretched out."

    def places(self, motion: Motion) -> Sequence[Place]:
        """The base, if there is gravity."""
        return (Place(),) if np.any(motion.robot.gravity) else ()

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Torque per rad about the two axes level with the ground (x and y where gravity is along z)."""
        gravity = motion.robot.gravity
        level = across(gravity / np.linalg.norm(gravity))
        values = tilt_torques(motion) @ level.T
        return Columns(tuple(range(motion.n)), values) if values.any() else None

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The rotation about each axis, and how far the base leans in all."""
        tilt, _ = harmonic(estimate, "rad", called="tilt")
        return (tilt, linear("about_x", estimate, "rad"), linear("about_y", estimate, "rad", index=1))

    def sentence(self, estimate: Estimate) -> str:
        """How far, about which axis."""
        tilt, x, y = self.parameters(estimate)
        lean = size(math.degrees(tilt.value), math.degrees(tilt.std), "°").replace(" °", "°")
        return (
            f"The base is not level: it leans by {lean}, {math.degrees(x.value):z.2f}° about its x axis and "
            f"{math.degrees(y.value):z.2f}° about its y axis (base tilt)."
        )
