"""The FRI client: messages and codec of KUKA's Fast Robot Interface, link statistics, the client's side of the loop.

Names that other packages use are re-exported here as far as they cost nothing to import; `session`, `motion`, `loop`
and `handover` are imported by their own names, so that a reader of recordings does not load the loop.
"""

from __future__ import annotations

from fri_client.errors import CodecError, FriError
from fri_client.messages import (
    COMMAND_IDENTIFIER,
    JOINT_COUNT,
    MONITORING_IDENTIFIER,
    ClientCommandMode,
    CommandData,
    CommandMessage,
    ConnectionInfo,
    ConnectionQuality,
    FriVersion,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    RobotInfo,
    SessionState,
    TimeStamp,
)
from fri_client.wire.codec import MAXIMUM_DATAGRAM_BYTES, Codec

__all__ = [
    "COMMAND_IDENTIFIER",
    "JOINT_COUNT",
    "MAXIMUM_DATAGRAM_BYTES",
    "MONITORING_IDENTIFIER",
    "ClientCommandMode",
    "Codec",
    "CodecError",
    "CommandData",
    "CommandMessage",
    "ConnectionInfo",
    "ConnectionQuality",
    "FriError",
    "FriVersion",
    "IpoData",
    "MessageHeader",
    "MonitorData",
    "MonitoringMessage",
    "RobotInfo",
    "SessionState",
    "TimeStamp",
]
