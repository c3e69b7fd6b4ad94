"""The answer to the next message, made ready while the loop waits for it.

After an answer has left, nearly a millisecond is free, and what the next answer will be is nearly known: the next row
of the path, judged by the guard but for its distance to the measured position, under the counter after the last one.
So it is encoded in advance; when the message is in, a `Glance` says whether it is as expected, and only what really
needs it is left to do. `loop` asks; it goes the whole way for every other message, and after the answer for this one
too.
"""

from __future__ import annotations

from operator import le

from fri_client.errors import CodecError
from fri_client.messages import MonitoringMessage, SessionState
from fri_client.motion.program import Foreseen, MotionProgram
from fri_client.session.robot_counter import WRAP
from fri_client.session.session import Session
from fri_client.wire.codec import Codec
from fri_client.wire.frame import unframed
from fri_client.wire.glance import Glance
from fri_client.wire.primitives import varint

_ACTIVE = int(SessionState.COMMANDING_ACTIVE)
_MOST_GLANCES = 256
"""Made in one run. A robot that shows ever new ones gains nothing by them, and each costs 0.2 ms."""

_AFTER_COUNTER = b"\x18"
"""Tag of the field behind the sequence counter: the counter ends here."""


class AnswerAhead:
    """`prepare` after each tick; `command_for` the next datagram; after it was sent, `Pilot.take(foreseen)`.

    counter: of the message that is answered. foreseen: what the motion foresaw for it.
    """

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._framed = codec.version.is_framed
        self._glances: dict[int, Glance] = {}
        self._made = 0
        self._command: bytes | None = None
        self._counter_bytes = b""
        self.counter = 0
        self.foreseen: Foreseen | None = None

    def command_for(self, datagram: bytes) -> bytes | None:
        """The prepared command, if this datagram is the message it was prepared for; None for any other."""
        command = self._command
        if command is None:
            return None
        self._command = None
        glance = self._glances.get(len(datagram))
        if glance is None:
            return None
        if self._framed:
            try:
                datagram = unframed(datagram)
            except CodecError:
                return None
        numbers, foreseen = glance.read(datagram, self._counter_bytes), self.foreseen
        if numbers is None or foreseen is None:
            return None
        # Without external torque the numbers end after the positions. A map of C functions has no cold bytecode.
        if all(map(le, foreseen.lower, numbers)) and all(map(le, numbers, foreseen.upper)):
            return command
        return None

    @property
    def is_ready(self) -> bool:
        """Whether a command waits for its message."""
        return self._command is not None

    def rehearse(self, datagram: bytes) -> None:
        """Look at an old datagram as at the next one, without any effect but that the code is in the caches."""
        command = self._command
        self.command_for(datagram)
        self._command = command

    def forget(self) -> None:
        """What was prepared holds no longer: the motion was asked to stop or lost its session, or time has passed."""
        self._command = None

    def prepare(self, session: Session, motion: MotionProgram, counter: int) -> None:
        """Make the answer to the message after the fresh one of that counter, where a motion goes on undisturbed."""
        self.forget()
        if (
            session.state == _ACTIVE
            and session.drop is None
            and session.answer_due
            and session.send_period_ms == session.command_period_ms
        ):
            foreseen = self.foreseen = motion.foresee()
            if foreseen is not None:
                self.counter = (counter + 1) & WRAP
                self._counter_bytes = varint(self.counter) + _AFTER_COUNTER
                self._command = self._codec.encode_position_command(
                    session.own_counter, self.counter, foreseen.judged.command
                )

    def learn(self, datagram: memoryview, message: MonitoringMessage) -> None:
        """Expect messages like this one, which the session has found to be in order, from now on."""
        if self._command is not None and self._made < _MOST_GLANCES:
            self._made += 1
            glance = self._codec.glance(datagram, message)
            if glance is not None:
                self._glances[len(datagram)] = glance
