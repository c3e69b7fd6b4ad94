"""A torque that repeats a few times per turn: eccentricity, magnetic pull, a dress pack."""

from __future__ import annotations

from collections.abc import Mapping

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import harmonic, joint_name, shaped, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.effects.second_harmonic import harmonic_share, second_harmonic, waves
from identification.mismatch.motion import Motion


class PositionDependentTorque(OwnJointEffect):
    """a sin(N q) + b cos(N q) with a low order N, at any speed and in both directions alike.

    No eccentricity makes a pure sine: the second harmonic may go along, at most half as large, where it shows.
    Order 1 is left out: for an axis that is not vertical it is a shift of the link's centre of mass.
    Usual: 0.02 to 0.3 % of full scale, 0.02 to 0.5 Nm. Looks like: torque_offset, cable_spring, joint_crosstalk.
    Source: Chawda, Niemeyer, Toward Torque Control of a KUKA LBR IIWA, IROS 2017 (periodic deflection).
    """

    name = "position_dependent_torque"
    units = ("Nm", "Nm")
    separating_experiment = "Let the joint turn through more than one period of the harmonic (beyond 360°/N)."
    revolute_only = True

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The order N per turn, and the share of its second harmonic."""
        orders = (2.0, 3.0, 4.0, 5.0, 6.0)
        return (ShapeParameter("order", "per turn", orders, 2.0, 12.0, True, False), *second_harmonic())

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Sine and cosine of N q."""
        return waves(shape["order"] * motion.position[:, joint], shape)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Amplitude, phase φ of A sin(N q + φ), order."""
        return (
            *harmonic(estimate),
            shaped("order", estimate, "per turn"),
            *harmonic_share(estimate),
        )

    def sentence(self, estimate: Estimate) -> str:
        """How often per turn, how large."""
        amplitude, _, order, *_ = self.parameters(estimate)
        return (
            f"{joint_name(estimate)} carries a torque that repeats {order.value:.0f} times per turn, amplitude "
            f"{size_of(amplitude)}, at any speed (position-dependent torque)."
        )
