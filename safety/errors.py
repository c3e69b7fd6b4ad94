"""Every exception of the package `safety`, and nothing else. Callers: fri_client, daemon, the tests.

    SafetyError                    70  root: catch this to catch all of them
    ├── LimitsError                78  a set of joint limits contradicts itself (joint, value, limit)
    ├── RampError                   1  no ramp inside the limits was found (joint, quantity, value, limit)
    ├── GeometryError               78  the robot's geometry or the workspace settings cannot be used
    └── TrajectoryShapeError       65  a table, a command or a state has the wrong shape or is not finite

The number is the exit code of the command line for an error of that class. Joints are counted from 1. A refused
command is no exception: the guard answers with a `GuardVerdict`, because the loop must go on and stop the arm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from safety.ramps import Ramp


class SafetyError(Exception):
    """Root of all errors of this package."""

    exit_code: ClassVar[int] = 70


class LimitsError(SafetyError):
    """A set of joint limits contradicts itself; says which joint and both numbers."""

    exit_code: ClassVar[int] = 78

    def __init__(
        self, message: str, *, joint: int | None = None, value: float | None = None, limit: float | None = None
    ) -> None:
        super().__init__(message)
        self.joint = joint
        self.value = value
        self.limit = limit


class GeometryError(SafetyError):
    """The robot's geometry file or the workspace settings cannot be used."""

    exit_code: ClassVar[int] = 78


class TrajectoryShapeError(SafetyError):
    """A table, a command or a state has the wrong shape or holds a value that is not finite."""

    exit_code: ClassVar[int] = 65


class RampError(SafetyError):
    """No ramp stays inside the limits.

    joint: counted from 1; quantity: "position", "velocity", "acceleration" or "planner"; value and limit in `unit`.
    firmest: for a stop, the firmest ramp there is although it leaves a position limit. A moving arm is better stopped
    late than not at all, so the caller may still follow it; None where no ramp could be computed.
    """

    exit_code: ClassVar[int] = 1

    def __init__(
        self,
        message: str,
        *,
        joint: int | None = None,
        quantity: str = "planner",
        value: float = float("nan"),
        limit: float = float("nan"),
        unit: str = "",
        firmest: Ramp | None = None,
    ) -> None:
        super().__init__(message)
        self.joint = joint
        self.quantity = quantity
        self.value = value
        self.limit = limit
        self.unit = unit
        self.firmest = firmest
