"""Thermal friction: a cold joint rubs more, and the excess fades while the joint warms up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import linear, shaped
from identification.mismatch.effects.enveloped import EnvelopedEffect, record_time
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.motion import Motion

REFERENCE_VELOCITY = 0.5
"""rad/s at which the two frictions are added up into one number."""


class ThermalFriction(EnvelopedEffect):
    """Friction that fades with time: exp(−t/T) · (ΔFV · q̇ + ΔFS · sign(q̇)).

    Parameters ΔFV in Nm s/rad and ΔFS in Nm, the excess at the start of the recording, each estimated by itself (the
    two need not change in proportion); T in s, searched over [10, 1200]. Seen: own joint, changes over the periods with
    the joint's velocity; the mean of the periods hides it wholly in FV and FS. Looks like: wear, redistribution of
    grease (same course, but does not come back after a night). Source: Bittencourt, Wernholt, Sander-Tavallaey,
    Brogårdh, IROS 2010; Simoni, Beschi, Legnani, Visioli.
    Usual: 10 to 50 % of the warm friction, T 30 to 600 s.
    """

    name: ClassVar[str] = "thermal_friction"
    units: ClassVar[tuple[str, ...]] = ("Nm s/rad", "Nm")
    separating_experiment: ClassVar[str] = (
        "Record for half an hour from a cold start, and again at once: only warm-up is absent the second time."
    )

    def places(self, motion: Motion) -> Sequence[Place]:
        """Every joint that moves."""
        moving = np.ptp(motion.position, axis=0) > 1e-3
        return tuple(Place(joint=int(joint) + 1) for joint in np.flatnonzero(moving))

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The time constant."""
        return (ShapeParameter("time_constant_s", "s", (30.0, 65.0, 140.0, 300.0, 600.0), 10.0, 1200.0),)

    def repeated_columns(
        self, motion: Motion, place: Place, shape: Mapping[str, float]
    ) -> tuple[tuple[int, ...], FloatArray] | None:
        """Velocity and its sign on one joint."""
        joint = joint_index(place)
        velocity = motion.velocity[:, joint]
        if not np.any(velocity):
            return None
        return (joint,), np.stack([velocity, motion.direction[:, joint]], axis=1)[:, None, :]

    def envelope(self, motion: Motion, shape: Mapping[str, float]) -> FloatArray:
        """exp(−t/T)."""
        return np.asarray(np.exp(-record_time(motion) / shape["time_constant_s"]), dtype=np.float64)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Excess of both frictions at the start, of their sum at one speed (better known than each), time constant."""
        speed = np.array([REFERENCE_VELOCITY, 1.0])
        spread = float(np.sqrt(max(0.0, float(speed @ estimate.covariance @ speed))))
        return (
            Parameter("excess_at_0.5_rad_per_s", float(speed @ estimate.coefficients), spread, "Nm"),
            linear("viscous_excess", estimate, "Nm s/rad"),
            linear("coulomb_excess", estimate, "Nm", index=1),
            shaped("time_constant_s", estimate, "s", called="time_constant"),
        )

    def sentence(self, estimate: Estimate) -> str:
        """One sentence for the operator."""
        viscous, coulomb = estimate.coefficients
        return (
            f"Joint {estimate.place.joint} warms up: at the start of the recording its friction differs by "
            f"{coulomb:+.3g} Nm and {viscous:+.3g} Nm s/rad, fading with a time constant of "
            f"{estimate.shape['time_constant_s']:.3g} s."
        )
