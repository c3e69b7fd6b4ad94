"""Under what a motion was begun, and what in a later message ends it.

Here: the comparison of one message of a living session with the beginning of the motion. Not here: counters, silence
and the latch itself (`session`), what may still be sent (`pilot`).

What the robot says of how it takes commands (operation mode, control mode, command mode, overlay type) holds until it
says something else. A field that it stops to send is no change. One that it begins to send in a motion is judged as it
would have been at its beginning, and holds from then on.
"""

from __future__ import annotations

from typing import NamedTuple

from fri_client.messages import (
    ClientCommandMode,
    ConnectionInfo,
    ConnectionQuality,
    DriveState,
    IpoData,
    MonitoringMessage,
    OperationMode,
    RobotInfo,
    SafetyState,
    SessionState,
)
from fri_client.session.message_checks import changed, changed_period, is_good, joint_not_driven
from fri_client.session.session_drop import DropReason

_IDLE, _COMMANDING_ACTIVE = int(SessionState.IDLE), int(SessionState.COMMANDING_ACTIVE)
_NO_IPO = IpoData()
_NO_ROBOT_INFO = RobotInfo()


class Breach(NamedTuple):
    """Why a motion's session is lost; value, limit and joint as in `SessionDrop`, None for what was not reported."""

    reason: DropReason
    value: float
    limit: float | None
    joint: int = 0


class _Modes(NamedTuple):
    operation: int | None
    control: int | None
    command: int | None
    overlay: int | None

    @classmethod
    def of(cls, message: MonitoringMessage) -> _Modes:
        robot, ipo = message.robot_info or _NO_ROBOT_INFO, message.ipo_data or _NO_IPO
        return cls(robot.operation_mode, robot.control_mode, ipo.client_command_mode, ipo.overlay_type)


class MotionTerms:
    """Made from the message that a motion begins with; `breach` for each later one.

    connection: of that message. test_mode_only: the motion is one for T1. never_in_t1: it is too fast for T1.
    """

    def __init__(self, message: MonitoringMessage, *, test_mode_only: bool, never_in_t1: bool) -> None:
        ipo = message.ipo_data or _NO_IPO
        self.connection = message.connection_info
        self._robot = message.robot_info
        self._command_mode, self._overlay = ipo.client_command_mode, ipo.overlay_type
        self._modes = _Modes.of(message)
        self._test_mode_only, self._never_in_t1 = test_mode_only, never_in_t1

    def breach(self, message: MonitoringMessage, info: ConnectionInfo, state: int) -> Breach | None:
        """What in a fresh message ends the motion; None where nothing does. state: of the session, by that message."""
        ipo = message.ipo_data or _NO_IPO
        if (
            state == _COMMANDING_ACTIVE
            and info == self.connection
            and ipo.client_command_mode == self._command_mode
            and ipo.overlay_type == self._overlay
            and message.robot_info == self._robot
        ):
            return None  # nothing changed, which is what nearly every tick finds
        now, then = _Modes.of(message), self._modes
        found = self._find(message.robot_info or _NO_ROBOT_INFO, info, state, now)
        if found is None:
            self._modes = _Modes(*(old if new is None else new for new, old in zip(now, then, strict=True)))
        return found

    def _find(self, robot: RobotInfo, info: ConnectionInfo, state: int, now: _Modes) -> Breach | None:
        then = self._modes
        # Causes before consequences: a safety stop takes the state away, and leaving takes the drives away.
        if robot.safety_state not in (None, SafetyState.NORMAL_OPERATION):
            return Breach(DropReason.SAFETY_STOP, robot.safety_state, SafetyState.NORMAL_OPERATION)
        is_wrong = self._never_in_t1 if now.operation == OperationMode.TEST_MODE_1 else self._test_mode_only
        if now.operation is not None and (is_wrong or changed(now.operation, then.operation)):
            return Breach(DropReason.OPERATION_MODE, now.operation, then.operation)
        if not is_good(info.quality):
            return Breach(DropReason.QUALITY, info.quality, ConnectionQuality.GOOD)
        if state == _IDLE:
            return Breach(DropReason.SESSION_CLOSED, state, _COMMANDING_ACTIVE)
        if state != _COMMANDING_ACTIVE:
            return Breach(DropReason.LEFT_COMMANDING_ACTIVE, state, _COMMANDING_ACTIVE)
        joint = joint_not_driven(robot)
        if joint:
            return Breach(DropReason.DRIVES_OFF, robot.drive_state[joint - 1], DriveState.ACTIVE, joint)
        if now.command is not None and now.command != ClientCommandMode.POSITION:
            return Breach(DropReason.COMMAND_MODE, now.command, then.command)
        if now.overlay is not None and changed(now.overlay, then.overlay):
            return Breach(DropReason.OVERLAY_TYPE, now.overlay, then.overlay)
        if now.control is not None and changed(now.control, then.control):
            return Breach(DropReason.CONTROL_MODE, now.control, then.control)
        periods = None if self.connection is None else changed_period(info, self.connection)
        return None if periods is None else Breach(DropReason.PERIOD_CHANGE, *periods)
