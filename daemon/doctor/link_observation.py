"""Listening to a robot for a few seconds, and answering it where that is asked for and moves nothing.

Here: the socket, the datagrams as they came, and the mirror that answers monitoring states. Not here: what is said
about them (`link_checks`).
"""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass, field

from fri_client.errors import CodecError
from fri_client.loop.pilot import monitoring_echo
from fri_client.messages import COMMAND_IDENTIFIER, CommandMessage, FriVersion, MessageHeader, SessionState
from fri_client.session.session import Session
from fri_client.wire.codec import Codec
from fri_client.wire.version_guess import guess_version

MAXIMUM_DATAGRAMS = 200_000


@dataclass(frozen=True, slots=True)
class LinkObservation:
    """What was heard during duration_s: (arrival in s since the start, sender, datagram) in order.

    clock_step_s: how far CLOCK_REALTIME moved against CLOCK_MONOTONIC meanwhile. mirror: who answered, if anybody did.
    """

    datagrams: tuple[tuple[float, tuple[str, int], bytes], ...]
    duration_s: float
    clock_step_s: float = 0.0
    mirror: Mirror | None = None


@dataclass(slots=True)
class Mirror:
    """Answers MONITORING_WAIT and MONITORING_READY as a client does that wants nothing; never a commanding state.

    version: None until the bytes tell it. qualities: (seconds since the first message, quality) at each change.
    delays_s: from receiving a message to having answered it. not_answered: messages in commanding states.
    """

    version: FriVersion | None = None
    qualities: list[tuple[float, int]] = field(default_factory=list)
    delays_s: list[float] = field(default_factory=list)
    not_answered: int = 0
    _session: Session | None = None
    _codec: Codec | None = None

    def reply(self, datagram: bytes, now_ns: int) -> bytes | None:
        """The datagram to send back, None for none."""
        if self.version is None:
            candidates = guess_version(datagram).candidates
            if len(candidates) != 1:
                return None
            self.version = FriVersion.parse(candidates[0])
        if self._session is None or self._codec is None:
            self._session, self._codec = Session(), Codec(self.version)
        session = self._session
        try:
            message = self._codec.decode_monitoring(datagram)
        except CodecError:
            return None
        session.judge(message, now_ns)
        if not self.qualities or self.qualities[-1][1] != session.quality:
            self.qualities.append(((now_ns - (session.first_fresh_ns or now_ns)) * 1e-9, session.quality))
        if session.state >= SessionState.COMMANDING_WAIT:
            self.not_answered += 1
            return None
        if not session.answer_due:
            return None
        counter = message.header.sequence_counter
        position = monitoring_echo(message, self.version).position
        if position is not None:
            return self._codec.encode_position_command(session.own_counter, counter, position)
        return self._codec.encode_command(
            CommandMessage(MessageHeader(COMMAND_IDENTIFIER, session.own_counter, counter))
        )

    def sent(self, delay_s: float) -> None:
        """The reply went out."""
        assert self._session is not None
        self._session.sent()
        self.delays_s.append(delay_s)


def observe_link(host: str, port: int, seconds: float, mirror: Mirror | None = None) -> LinkObservation:
    """Listen on an address; without a mirror nothing is sent. Raises OSError where the address cannot be bound."""
    heard: list[tuple[float, tuple[str, int], bytes]] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as channel:
        channel.bind((host, port))
        clocks = time.time() - time.monotonic()
        start = time.monotonic()
        end = start + seconds
        while (left := end - time.monotonic()) > 0 and len(heard) < MAXIMUM_DATAGRAMS:
            channel.settimeout(left)
            try:
                data, sender = channel.recvfrom(2048)
            except TimeoutError:
                break
            now = time.monotonic()
            heard.append((now - start, (str(sender[0]), int(sender[1])), data))
            if mirror is not None:
                answer = mirror.reply(data, int(now * 1e9))
                if answer is not None:
                    channel.sendto(answer, sender)
                    mirror.sent(time.monotonic() - now)
        duration = time.monotonic() - start
    return LinkObservation(tuple(heard), duration, time.time() - time.monotonic() - clocks, mirror)
