"""A torque sensor that reads a fixed share too much or too little."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import joint_name, linear, shaped, size_of
from identification.mismatch.motion import Motion

TURNING = 0.6
"""Largest share of a gain error that may turn with the angle, in cosine and in sine: it stays an error of the gain."""


class TorqueSensorGain(Effect):
    """g · τ̂ on one joint, or the same g on all joints (joint null).

    A gain that all joints share is the same as heavier links: the fit takes it up whole. It stands here so that the
    tool says so. The gain of one sensor may turn with the joint, as its spokes are not alike:
    g (1 + u cos q + v sin q); most of the constant part is taken up by the parameters, of the turning one little.
    Usual: 0.5 to 2 %. Looks like: bending_crosstalk, cable_spring, distal_rotor_reaction, payload. Source: calibration
    error of strain-gauge sensors: Lee, Kim, Song, calibration of joint torque sensors, 2010.
    """

    name = "torque_sensor_gain"
    units = ("1",)
    separating_experiment = "Hold a known mass at rest in several poses: the gain shows as a constant ratio."

    def places(self, motion: Motion) -> Sequence[Place]:
        """Each joint, and all joints together."""
        return (*(Place(joint=joint + 1) for joint in range(motion.n)), Place())

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """Share of the gain error that turns with one joint's angle."""
        if place.joint is None or not motion.robot.kinematics.revolute[place.joint - 1]:
            return ()
        return tuple(
            ShapeParameter(name, "1", (-0.4, 0.0, 0.4), -TURNING, TURNING, logarithmic=False, textbook=0.0)
            for name in ("turning_cosine", "turning_sine")
        )

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """The nominal torque itself, with what of it turns with the angle."""
        joints = tuple(range(motion.n)) if place.joint is None else (place.joint - 1,)
        values = motion.torque[:, list(joints), None]
        if any(shape.values()) and place.joint is not None:
            angle = motion.position[:, joints[0]]
            turning = shape["turning_cosine"] * np.cos(angle) + shape["turning_sine"] * np.sin(angle)
            values = values * (1.0 + turning)[:, None, None]
        return Columns(joints, values) if values.any() else None

    def is_impossible(self, coefficients: FloatArray, std: FloatArray | None = None) -> bool:
        """Whether the sensor would read the other way round: a sign is told as such, it is no error of a gain."""
        return bool(coefficients[0] <= -1.0)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The gain error in per cent, and the shares of it that turn with the angle where these are not zero."""
        turning = tuple(shaped(name, estimate, "1") for name, value in estimate.shape.items() if value != 0.0)
        return (linear("gain_error", estimate, "%", scale=100.0), *turning)

    def sentence(self, estimate: Estimate) -> str:
        """By how many per cent the sensor reads too much."""
        gain, *turning = self.parameters(estimate)
        direction = "more" if gain.value > 0.0 else "less"
        return (
            f"{joint_name(estimate)}'s torque sensor reads {size_of(gain)} off, {direction} than the torque that the "
            f"model needs (gain error{', which changes over the turn of the joint' if turning else ''})."
        )
