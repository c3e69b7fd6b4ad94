"""Torque sensor drift: the zero of a joint's torque sensor wanders or jumps while recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import linear, shaped
from identification.mismatch.effects.enveloped import EnvelopedEffect, record_time
from identification.mismatch.effects.own_joint import joint_index
from identification.mismatch.motion import Motion

LINEAR, EXPONENTIAL, STEP = 0, 1, 2
"""Values of the shape parameter `course`."""


class TorqueSensorDrift(EnvelopedEffect):
    """A torque that depends on time only: b·t/3600, or b·exp(−t/T), or b from the time t₀ on.

    Parameter b: Nm/h for the linear course, Nm otherwise; T: s; t₀: s from the first sample of the recording.
    Seen: own joint, line 0 of the periods differs from period to period. Looks like: nothing else that repeats;
    thermal_friction changes with the joint's velocity, payload_change reaches all joints. Source: zero drift of the
    LBR's joint torque sensors as reported by its users (lbr_fri_ros2_stack, discussion 246); warm-up of strain gauges.
    Usual: 0.05 to 0.5 Nm per hour; jumps of 0.05 to 1 Nm.
    """

    name: ClassVar[str] = "torque_sensor_drift"
    units: ClassVar[tuple[str, ...]] = ("Nm",)
    separating_experiment: ClassVar[str] = (
        "Hold one pose for half an hour from a cold start: drift goes on at rest, friction does not act there."
    )

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The course, and the time it goes with (time constant or moment of the step, s)."""
        last = float(motion.start_s[-1] + motion.time[-1])
        grid = tuple(float(value) for value in np.geomspace(0.02 * last, last, 5))
        return (
            ShapeParameter("course", "", (LINEAR, EXPONENTIAL, STEP), LINEAR, STEP, integer=True, logarithmic=False),
            ShapeParameter("time_s", "s", grid, grid[0], grid[-1]),
        )

    def repeated_columns(
        self, motion: Motion, place: Place, shape: Mapping[str, float]
    ) -> tuple[tuple[int, ...], FloatArray] | None:
        """A constant torque on one joint."""
        return (joint_index(place),), np.ones((motion.samples, 1, 1))

    def envelope(self, motion: Motion, shape: Mapping[str, float]) -> FloatArray:
        """The chosen course over the whole recording; a step rises within one sample, so that it can be refined."""
        time = record_time(motion)
        match round(shape["course"]):
            case 0:
                return np.asarray(time / 3600.0, dtype=np.float64)
            case 1:
                return np.asarray(np.exp(-time / shape["time_s"]), dtype=np.float64)
            case _:
                return np.clip((time - shape["time_s"]) / motion.sampling_period_s + 0.5, 0.0, 1.0)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Size, and the time that belongs to the course."""
        course = round(estimate.shape["course"])
        if course == LINEAR:
            return (linear("rate", estimate, "Nm/h"),)
        size, when = ("initial_torque", "time_constant") if course == EXPONENTIAL else ("step", "time")
        return linear(size, estimate, "Nm"), shaped("time_s", estimate, "s", called=when)

    def sentence(self, estimate: Estimate) -> str:
        """One sentence for the operator."""
        course, size = round(estimate.shape["course"]), float(estimate.coefficients[0])
        what = {
            LINEAR: f"drifts by {size:+.3g} Nm per hour",
            EXPONENTIAL: f"starts {size:+.3g} Nm off and settles with a time constant of "
            f"{estimate.shape.get('time_s', np.nan):.3g} s",
            STEP: f"jumps by {size:+.3g} Nm at {estimate.shape.get('time_s', np.nan):.4g} s",
        }[course]
        return f"The zero of joint {estimate.place.joint}'s torque sensor {what} during the recording."
