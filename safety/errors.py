"""Every exception of the package `safety`, and nothing else.

    SafetyError                    70  root: catch this to catch all of them
    ├── LimitsError                78  a set of joint limits contradicts itself (joint, value, limit)
    ├── RampError                   1  no ramp inside the limits was found (in ramps.py, beside the ramp it carries)
    ├── GeometryError               78  the robot's geometry or the workspace settings cannot be used
    └── TrajectoryShapeError       65  a table, a command or a state has the wrong shape or is not finite

The number is the exit code of the command line for an error of that class. Joints are counted from 1. A refused
command is no exception: the guard answers with a `GuardVerdict`, because the loop must go on and stop the arm.
"""

from __future__ import annotations

from typing import ClassVar


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
