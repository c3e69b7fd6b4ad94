"""`--fri-version auto`: listening to the robot, before anything is started, until its messages tell the FRI version.

Here: whose datagrams count, how long, and what is said. Not here: what the bytes tell (`version_guess`). Nothing is
sent: a cabinet sends by itself and waits. The supervisor asks before it makes the run's folder.
"""

from __future__ import annotations

import time

from daemon.api import AUTO_VERSION, RunRequest
from daemon.errors import ProtocolMismatchError, RobotUnreachableError
from daemon.run.loop_process import bind
from daemon.stop_handle import StopHandle
from daemon.words import counted
from fri_client.loop.channel import UdpChannel
from fri_client.messages import FriVersion
from fri_client.wire.version_guess import VersionGuess, guess_version

_UNDECIDED_S = 1.0
"""So long messages that 1.x and 2.5 would both send are listened to; then they are taken as 1.15, which reads them."""
_MAXIMUM_DATAGRAM_BYTES = 2048


def hear_version(request: RunRequest, stop: StopHandle) -> tuple[FriVersion, str]:
    """The version that the robot speaks, and the sentence for the operator; 1.15 where a stop was asked for meanwhile.

    Raises RobotUnreachableError (69) when nobody sends within start_timeout_s, ProtocolMismatchError (76) when what
    comes is no FRI, PortInUseError (69), ConfigurationError (78) for an address that is not this machine's.
    """
    garbage = 0
    best: VersionGuess | None = None
    until = time.monotonic() + request.start_timeout_s
    buffer = bytearray(_MAXIMUM_DATAGRAM_BYTES)
    with UdpChannel() as channel:
        bind(channel, request.bind_host, request.bind_port)
        while not stop.requested and time.monotonic() < until:
            try:
                size, sender = channel.receive_into(buffer)
            except BlockingIOError:
                continue
            if request.robot_host not in (None, sender[0]):
                continue
            guess = guess_version(bytes(buffer[:size]))
            if len(guess.candidates) == 1:
                return FriVersion.parse(guess.candidates[0]), f"The robot speaks FRI {guess.candidates[0]}."
            if not guess.candidates:
                garbage += 1
            elif best is None:
                best, until = guess, min(until, time.monotonic() + _UNDECIDED_S)
    if best is not None:
        version = FriVersion.parse(best.candidates[0])
        return version, f"{best.sentence()} They are read as FRI {version}; positions and torques are the same."
    if stop.requested:
        return FriVersion.V1_15, "A stop was asked for before the robot had told its FRI version."
    if garbage:
        reason = f"{counted(garbage, 'datagram')} arrived, but none is an FRI monitoring message."
        raise ProtocolMismatchError(AUTO_VERSION, reason)
    raise RobotUnreachableError(request.bind_host, request.bind_port, request.start_timeout_s)
