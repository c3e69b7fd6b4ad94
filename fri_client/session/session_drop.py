"""Why a motion's session was lost: the reasons, the numbers that belong to each, and the operator's sentence.

Here only the value object; `session` decides when one is made, `loop` puts it into the records and the report.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from fri_client.messages import (
    ClientCommandMode,
    ConnectionQuality,
    ControlMode,
    DriveState,
    OperationMode,
    OverlayType,
    SafetyState,
    SessionState,
    name_of,
)
from fri_client.session.link_memory import RecentLink


class DropReason(IntEnum):
    """Why the session of a motion was lost."""

    LEFT_COMMANDING_ACTIVE = 1
    SESSION_CLOSED = 2
    QUALITY = 3
    SAFETY_STOP = 4
    DRIVES_OFF = 5
    COMMAND_MODE = 6
    CONTROL_MODE = 7
    OPERATION_MODE = 8
    COUNTER_RESTART = 9
    SILENCE = 10
    PERIOD_CHANGE = 11
    OVERLAY_TYPE = 12


@dataclass(frozen=True, slots=True)
class SessionDrop:
    """The moment a motion's session was lost; states and numbers as the robot reported them.

    cycle: fresh messages since the session began, counted from 1; quality: of the connection then; motion_s: time
    since the motion began, the robot's own where that is simulated; recent: the link in the last second, where
    somebody watched it. value and limit by reason: state now and state needed; quality and GOOD; safety state and
    NORMAL_OPERATION; drive state (of `joint`, from 1)
    and ACTIVE; mode or overlay type now and before (-1: it was not reported before); counter and the counter expected;
    silence in s and the time-out in s; send period in ms now and before, or where that stayed the command period.
    """

    reason: DropReason
    state_before: int
    state_after: int
    cycle: int
    value: float
    limit: float
    joint: int = 0
    quality: int | None = None
    motion_s: float = 0.0
    recent: RecentLink | None = None

    def sentence(self) -> str:
        """Why the session dropped, in one sentence with the numbers."""
        before, after = name_of(SessionState, self.state_before), name_of(SessionState, self.state_after)
        value, limit = self.value, self.limit
        states = f"{before} -> {after}" if before != after else f"still in {after}"
        match self.reason:
            case DropReason.LEFT_COMMANDING_ACTIVE:
                what = f"the robot left {before} for {after} at quality {name_of(ConnectionQuality, self.quality)}"
                states = ""
            case DropReason.SESSION_CLOSED:
                what = f"the robot closed the session ({before} -> {after})"
                states = ""
            case DropReason.QUALITY:
                what = f"the connection quality fell to {name_of(ConnectionQuality, value)}, below GOOD"
            case DropReason.SAFETY_STOP:
                what = f"the robot's safety state became {name_of(SafetyState, value)}"
            case DropReason.DRIVES_OFF:
                what = f"the drive of joint {self.joint} became {name_of(DriveState, value)}"
            case DropReason.COMMAND_MODE:
                what = self._mode("client command mode", ClientCommandMode)
            case DropReason.CONTROL_MODE:
                what = self._mode("control mode", ControlMode)
            case DropReason.OPERATION_MODE:
                what = self._mode("operation mode", OperationMode)
            case DropReason.OVERLAY_TYPE:
                what = self._mode("overlay type", OverlayType)
            case DropReason.COUNTER_RESTART:
                what = f"the robot's sequence counter restarted at {value:.0f} where {limit:.0f} was expected"
            case DropReason.SILENCE:
                what = f"no usable message came for {value:.3g} s (time-out {limit:g} s)"
            case DropReason.PERIOD_CHANGE:
                what = f"the robot's period changed from {limit:g} ms to {value:g} ms"
        tail = "; ".join(part for part in (states, self.recent.clause() if self.recent is not None else "") if part)
        tail = f" ({tail})" if tail else ""
        when = f"at cycle {self.cycle}, {self.motion_s:.2f} s into the motion"
        return f"Session dropped {when}: {what}{tail}; no command follows by itself."

    def _mode(self, name: str, kind: type[IntEnum]) -> str:
        if self.limit < 0:
            return f"the robot says for the first time that the {name} is {name_of(kind, self.value)}"
        return f"the {name} changed from {name_of(kind, self.limit)} to {name_of(kind, self.value)}"
