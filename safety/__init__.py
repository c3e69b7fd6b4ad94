"""What keeps the arm inside its limits: limits, guard, ramps, preflight. Pure functions and small state machines.

Nothing here opens a socket, a file of the operator or a clock.
"""

from __future__ import annotations

from safety.errors import GeometryError, LimitsError, SafetyError, TrajectoryShapeError
from safety.guard import CommandGuard, GuardVerdict
from safety.limits import IIWA7_R800, IIWA14_R820, JointLimits, limits_for
from safety.ramps import Ramp, RampError, plan_start_ramp, plan_stop_ramp

__all__ = [
    "IIWA7_R800",
    "IIWA14_R820",
    "CommandGuard",
    "GeometryError",
    "GuardVerdict",
    "JointLimits",
    "LimitsError",
    "Ramp",
    "RampError",
    "SafetyError",
    "TrajectoryShapeError",
    "limits_for",
    "plan_start_ramp",
    "plan_stop_ramp",
]
