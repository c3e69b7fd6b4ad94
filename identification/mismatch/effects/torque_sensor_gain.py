"""A torque sensor that reads a fixed share too much or too little."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place
from identification.mismatch.effects.describe import joint_name, linear, size_of
from identification.mismatch.motion import Motion


class TorqueSensorGain(Effect):
    """g · τ̂ on one joint, or the same g on all joints (joint null).

    A gain that all joints share is the same as heavier links: the fit takes it up whole. It stands here so that the
    tool says so.
    """

    name = "torque_sensor_gain"
    code = "gain"
    equation = "τ_j = g τ̂_j"
    source = "calibration error of strain-gauge sensors: Lee, Kim, Song, calibration of joint torque sensors, 2010"
    units = ("1",)
    plausible = "0.5 to 2 %"
    look_alikes = ("bending_crosstalk", "cable_spring", "distal_rotor_reaction", "payload")
    separating_experiment = "Hold a known mass at rest in several poses: the gain shows as a constant ratio."

    def places(self, motion: Motion) -> Sequence[Place]:
        """Each joint, and all joints together."""
        return (*(Place(joint=joint + 1) for joint in range(motion.n)), Place())

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """The nominal torque itself."""
        del shape
        joints = tuple(range(motion.n)) if place.joint is None else (place.joint - 1,)
        values = motion.torque[:, list(joints), None]
        return Columns(joints, values) if values.any() else None

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The gain error in per cent."""
        return (linear("gain_error", estimate, "%", scale=100.0),)

    def sentence(self, estimate: Estimate) -> str:
        """By how many per cent the sensor reads too much."""
        (gain,) = self.parameters(estimate)
        direction = "more" if gain.value > 0.0 else "less"
        return (
            f"{joint_name(estimate)}'s torque sensor reads {size_of(gain)} off, {direction} than the torque that the "
            "model needs (gain error)."
        )
