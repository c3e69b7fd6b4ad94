"""Limits an excitation trajectory is designed for: the value object and where its numbers come from.

Here: positions, velocities, accelerations and torques per joint, from the package's table for the iiwa robots or from
what a URDF states. Not here: the guard's limits with margins (`safety.limits`); callers pass those in as arrays.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from typing import TYPE_CHECKING, Any

import numpy as np

from identification.arrays import FloatArray
from identification.errors import DesignError
from identification.json_values import json_list
from identification.robots.model import refuse_followers

if TYPE_CHECKING:
    from identification.robots import RobotModel

LONGEST_PERIOD_S = 600.0
"""Of a motion, designed or driven: a longer one was meant in ms as a rule, and its table at 1 kHz fills the memory."""


@dataclass(frozen=True, slots=True)
class ExcitationLimits:
    """Limits of n joints, each array (n,): position rad, velocity rad/s, acceleration rad/s², torque Nm.

    Acceleration and torque may be infinite where nobody states one; no torque: infinite. Raises DesignError naming the
    joint whose numbers are unusable (not finite, or an empty range).
    """

    position_lower: FloatArray
    position_upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray | None = None

    def __post_init__(self) -> None:
        """Bring the arrays to float64 and check them once."""
        if self.torque is None:
            object.__setattr__(self, "torque", np.full(np.shape(self.velocity), np.inf))
        names = ("position_lower", "position_upper", "velocity", "acceleration", "torque")
        arrays = [np.array(getattr(self, name), dtype=np.float64) for name in names]
        n = arrays[0].shape
        if len(n) != 1 or any(array.shape != n for array in arrays):
            raise DesignError("the limits must be arrays with one number for each joint")
        for name, array in zip(names, arrays, strict=True):
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        for joint in range(n[0]):
            low, high = arrays[0][joint], arrays[1][joint]
            if not (np.isfinite(low) and np.isfinite(high)):
                raise DesignError(
                    f"joint {joint + 1} has no position limits, as a joint that turns without end; a motion is "
                    "designed in a range: state lower and upper in its <limit>"
                )
            if low >= high:
                raise DesignError(f"joint {joint + 1} has no usable position range: {low:g} to {high:g} rad")
            if not arrays[4][joint] > 0.0:
                raise DesignError(f"joint {joint + 1} has no usable torque limit: {arrays[4][joint]:g} Nm")
            if not (np.isfinite(arrays[2][joint]) and arrays[2][joint] > 0.0 and arrays[3][joint] > 0.0):
                raise DesignError(
                    f"joint {joint + 1} has no usable velocity or acceleration limit: {arrays[2][joint]:g} rad/s, "
                    f"{arrays[3][joint]:g} rad/s²"
                )

    @property
    def torque_nm(self) -> FloatArray:
        """(n,) torque limits, infinite where none is known."""
        assert self.torque is not None, "set when the value is built"
        return self.torque

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return int(self.position_lower.shape[0])

    @property
    def middle(self) -> FloatArray:
        """(n,) rad (m) the middle of each joint's position range, about which it can move furthest: zero of an iiwa."""
        return np.asarray(0.5 * (self.position_lower + self.position_upper))

    def reach(self, offset: FloatArray) -> FloatArray:
        """Largest symmetric excursion about `offset` (n,) rad that stays in the position range: q_max of (14)."""
        reach: FloatArray = np.minimum(self.position_upper - offset, offset - self.position_lower)
        if np.any(reach <= 0.0):
            joint = int(np.argmin(reach))
            raise DesignError(
                f"the offset of joint {joint + 1}, {offset[joint]:g} rad (m), leaves no room inside its position limits"
            )
        return reach

    def to_json(self) -> dict[str, Any]:
        """Plain lists for the trajectory file; an infinite acceleration becomes null."""
        return {
            "position_lower_rad": self.position_lower.tolist(),
            "position_upper_rad": self.position_upper.tolist(),
            "velocity_rad_s": self.velocity.tolist(),
            "acceleration_rad_s2": json_list(self.acceleration),
            "torque_nm": json_list(self.torque_nm),
        }


def columns_of(table: Traversable) -> dict[str, FloatArray]:
    """Columns of a table of the package, a row each joint, by the names in its head."""
    with table.open("r", encoding="utf-8") as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def iiwa_limits(robot: str) -> ExcitationLimits:
    """Limits of "iiwa14" or "iiwa7" from the package's table (KUKA's published positions and velocities).

    KUKA publishes no accelerations; those are of a public description of the iiwa (see the table).
    Raises DesignError for any other name.
    """
    if robot not in ("iiwa14", "iiwa7"):
        raise DesignError(f"no table of limits for robot '{robot}'; give limits, or a URDF that states them")
    column = columns_of(resources.files("identification.excitation.data").joinpath(f"limits_{robot}.csv"))
    return ExcitationLimits(
        np.deg2rad(column["position_lower_deg"]),
        np.deg2rad(column["position_upper_deg"]),
        np.deg2rad(column["velocity_deg_s"]),
        column["acceleration_rad_s2"],
        column["torque_nm"],
    )


def limits_of_robot(robot: RobotModel) -> ExcitationLimits:
    """The table for an iiwa by name, else the URDF's positions, velocities and efforts (acceleration unlimited).

    Raises DesignError naming the first joint whose URDF states no usable limit, RobotError where joints follow others:
    no limit helps there.
    """
    refuse_followers(robot, "design a motion of")
    if robot.name in ("iiwa14", "iiwa7"):
        return iiwa_limits(robot.name)
    return ExcitationLimits(
        np.asarray(robot.position_lower, dtype=np.float64),
        np.asarray(robot.position_upper, dtype=np.float64),
        np.asarray(robot.velocity, dtype=np.float64),
        np.full(robot.n, np.inf),
        # A URDF must state an effort; many state 0 for "not known".
        np.where(np.asarray(robot.effort) > 0.0, robot.effort, np.inf),
    )
