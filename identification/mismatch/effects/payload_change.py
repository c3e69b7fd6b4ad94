"""Change of payload: the robot takes up, loses or puts down a load while recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import linear, shaped
from identification.mismatch.effects.enveloped import EnvelopedEffect, record_time
from identification.mismatch.effects.payload import columns_of_link
from identification.mismatch.motion import Motion


class PayloadChange(EnvelopedEffect):
    """The ten inertial parameters of the last link change at the time t₀ and stay changed.

    Parameters: mass kg, first moments kg m, and inertia kg m² about the last joint frame's origin; t₀ in s from the
    first sample of the recording. Seen: on every joint that carries the last link, most where gravity acts, from one
    moment on. Looks like: external_contact that lasts to the end, steps of several sensors at once. A payload that does
    not change is absorbed in the last link's parameters and cannot be seen. Source: eq. (3) of the seed paper.
    Usual: 0.05 to 14 kg.
    """

    name: ClassVar[str] = "payload_change"
    units: ClassVar[tuple[str, ...]] = ("kg", *3 * ("kg m",), *6 * ("kg m^2",))
    separating_experiment: ClassVar[str] = "Record once with and once without the load, each without a change."

    def places(self, motion: Motion) -> Sequence[Place]:
        """The last link."""
        return (Place(link=motion.n),)

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The moment of the change."""
        last = float(motion.start_s[-1] + motion.time[-1])
        return (ShapeParameter("time_s", "s", tuple(motion.start_s[1:]), 0.0, last, logarithmic=False),)

    def repeated_columns(
        self, motion: Motion, place: Place, shape: Mapping[str, float]
    ) -> tuple[tuple[int, ...], FloatArray] | None:
        """Regressor of the last link's ten parameters."""
        assert place.link is not None
        return columns_of_link(motion, place.link - 1)

    def envelope(self, motion: Motion, shape: Mapping[str, float]) -> FloatArray:
        """0 before the change, 1 after it; within one sample a linear rise, so that the moment can be refined."""
        step = motion.sampling_period_s
        return np.clip((record_time(motion) - shape["time_s"]) / step + 0.5, 0.0, 1.0)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Mass, first moments and the moment of the change."""
        names = ("mass", "first_moment_x", "first_moment_y", "first_moment_z")
        sizes = (linear(name, estimate, self.units[index], index=index) for index, name in enumerate(names))
        return *sizes, shaped("time_s", estimate, "s", called="time")

    def sentence(self, estimate: Estimate) -> str:
        """One sentence for the operator."""
        mass = float(estimate.coefficients[0])
        verb = "takes up" if mass > 0.0 else "loses"
        return f"The robot {verb} {abs(mass):.3g} kg at the flange at {estimate.shape['time_s']:.4g} s."
