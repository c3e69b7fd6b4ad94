"""Joint limits of the robots as value objects: positions, velocities, torques from KUKA, accelerations and jerks ours.

Lives here: `JointLimits` and the two iiwa models. Lives elsewhere: who applies the limits (guard.py to
each command, ramps.py to each ramp, preflight.py to a whole table). Values and sources: docs/limits.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety.errors import LimitsError

FloatArray = NDArray[np.float64]

JERK_PER_ACCELERATION_HZ = 10.0
"""Ratio of our jerk limits to our acceleration limits, 1/s: the full acceleration is reached in 0.1 s.

A sinusoid of f Hz has the ratio 2 pi f of peak jerk to peak acceleration, so motions up to 1.5 Hz fit."""

EXTERNAL_TORQUE_THRESHOLD_NM = (60.0, 60.0, 60.0, 30.0, 12.0, 12.0, 6.0)
"""External torque, as the robot reports it, that stops a motion unless told otherwise, Nm per joint of an iiwa.

Drake's iiwa driver stops at 60 Nm times 1, 1, 1, 0.5, 0.2, 0.2, 0.1. Generous: the robot's own estimate is wrong by
some Nm in quick motions, by more with wrong load data. It ends a run that pushes against something; it protects
nobody."""


@dataclass(frozen=True, slots=True, eq=False)
class JointLimits:
    """Limits of the n joints of one robot, each array of shape (n,), read-only.

    position_lower, position_upper: rad; velocity: rad/s; acceleration: rad/s²; jerk: rad/s³; torque: Nm. The last four
    are magnitudes, valid in both directions. Raises LimitsError, which names the joint and both numbers.
    """

    position_lower: FloatArray
    position_upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    torque: FloatArray

    def __post_init__(self) -> None:
        for name in self.__slots__:
            array = np.array(getattr(self, name), dtype=np.float64, ndmin=1)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        count = self.position_lower.shape
        for name in self.__slots__:
            array = getattr(self, name)
            if array.ndim != 1 or array.shape != count or array.size == 0:
                raise LimitsError(
                    f"The limit {name} has shape {array.shape}, but position_lower has shape {count}; "
                    "every limit needs one number per joint."
                )
            for joint, value in enumerate(array.tolist(), start=1):
                if not math.isfinite(value):
                    raise LimitsError(
                        f"The limit {name} of joint {joint} is {value}, which is not a finite number.",
                        joint=joint,
                        value=value,
                    )
                if not name.startswith("position") and value <= 0.0:
                    raise LimitsError(
                        f"The limit {name} of joint {joint} is {value:g}, but it has to be above 0.",
                        joint=joint,
                        value=value,
                        limit=0.0,
                    )
        for joint, (lower, upper) in enumerate(
            zip(self.position_lower.tolist(), self.position_upper.tolist(), strict=True), start=1
        ):
            if lower >= upper:
                raise LimitsError(
                    f"Joint {joint} has the lower position limit {lower:.6g} rad, which is not below its "
                    f"upper limit {upper:.6g} rad.",
                    joint=joint,
                    value=lower,
                    limit=upper,
                )

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return int(self.position_lower.size)


def _iiwa(velocity_deg_per_s: list[float], torque: list[float]) -> JointLimits:
    position = np.radians([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
    # Not KUKA's: the public description of the iiwa 14 in Drake, 5 times the velocity limits of the iiwa 7 per second.
    acceleration = np.array([8.57, 8.57, 8.74, 11.36, 12.23, 15.72, 15.72])
    return JointLimits(
        position_lower=-position,
        position_upper=position,
        velocity=np.radians(velocity_deg_per_s),
        acceleration=acceleration,
        jerk=JERK_PER_ACCELERATION_HZ * acceleration,
        torque=np.array(torque),
    )


IIWA14_R820 = _iiwa(
    velocity_deg_per_s=[85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0],
    torque=[320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0],
)
"""Limits of the LBR iiwa 14 R820."""

IIWA7_R800 = _iiwa(
    velocity_deg_per_s=[98.0, 98.0, 100.0, 130.0, 140.0, 180.0, 180.0],
    torque=[176.0, 176.0, 110.0, 110.0, 110.0, 40.0, 40.0],
)
"""Limits of the LBR iiwa 7 R800."""

_BY_NAME = {"iiwa14": IIWA14_R820, "iiwa7": IIWA7_R800}


def limits_for(robot: str) -> JointLimits:
    """Limits of a robot by its short name, "iiwa14" or "iiwa7". Raises LimitsError for any other."""
    try:
        return _BY_NAME[robot]
    except KeyError:
        known = ", ".join(sorted(_BY_NAME))
        raise LimitsError(f"There are no joint limits for a robot named {robot!r}; known are {known}.") from None
