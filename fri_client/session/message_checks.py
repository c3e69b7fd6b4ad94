"""Small questions the session asks about one message; no state, no decision.

`session` judges by the answers.
"""

from __future__ import annotations

from typing import TypeAlias

from fri_client.messages import ConnectionInfo, ConnectionQuality, DriveState, IpoData, MonitorData, RobotInfo
from fri_client.session.refusal import Refusal

NamedArrays: TypeAlias = tuple[tuple[Refusal, tuple[float, ...] | None], ...]


def positions(monitor: MonitorData, ipo: IpoData | None) -> NamedArrays:
    """The positions of a message each with what a wrong one is refused for, rad."""
    return (
        (Refusal.MEASURED_POSITION, monitor.measured_joint_position),
        (Refusal.COMMANDED_POSITION, monitor.commanded_joint_position),
        (Refusal.IPO_POSITION, None if ipo is None else ipo.joint_position),
    )


def torques(monitor: MonitorData) -> NamedArrays:
    """The torques of a message, each with what a wrong one is refused for, Nm."""
    return (
        (Refusal.MEASURED_TORQUE, monitor.measured_torque),
        (Refusal.EXTERNAL_TORQUE, monitor.external_torque),
        (Refusal.COMMANDED_TORQUE, monitor.commanded_torque),
    )


def is_good(quality: int) -> bool:
    """Whether the robot commands at this connection quality."""
    return quality in (ConnectionQuality.GOOD, ConnectionQuality.EXCELLENT)


def changed(now: int | None, then: int | None) -> bool:
    """A field that the robot stops or starts to send is no change of what it says."""
    return now is not None and then is not None and now != then


def send_period(info: ConnectionInfo) -> int:
    """Time from one message to the next, ms; 0 where the robot does not say."""
    return info.send_period or 0


def command_period(info: ConnectionInfo) -> int:
    """Time from one command to the next, ms; 0 where the robot does not say."""
    return send_period(info) * (info.receive_multiplier or 1)


def changed_period(now: ConnectionInfo, then: ConnectionInfo) -> tuple[int, int] | None:
    """The send period now and then, ms, where it changed, else the command period where that did, else None."""
    for period in (send_period, command_period):
        if period(now) != period(then):
            return period(now), period(then)
    return None


def joint_not_driven(robot: RobotInfo) -> int:
    """The first joint, from 1, whose drive is not ACTIVE; 0 when all are or nothing is known."""
    for joint, drive in enumerate(robot.drive_state, start=1):
        if drive != DriveState.ACTIVE:
            return joint
    return 0
