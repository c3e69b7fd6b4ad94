"""The gate before the first command: the loop asks whether the start ramp from where the arm stands is clear, the
supervisor looks and answers. Both sides are words in the header page of the hand-over ring.

Here: question, answer and who may write what. Not here: how a ramp is judged (the supervisor's business) and when the
loop asks (`loop`). Nobody waits in here: the loop mirrors the robot until the answer stands there. A ring whose gate
was never closed has no supervisor that would answer, and lets every start pass.

    byte   content                                                            written by
    576    closed flag                                                        supervisor
    584    number of the question, command period ms, samples per command     loop
    608    position that the ramp begins at, 7 x rad                          loop
    664    number of the question answered, allowed flag                      supervisor
    3072   why not: length, UTF-8                                             supervisor
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from fri_client.errors import FriError

_W_CLOSED, _W_NUMBER, _W_PERIOD, _W_SAMPLES = 72, 73, 74, 75
_POSITION_OFFSET = 608
_POSITION = struct.Struct("@7d")
_W_ANSWERED, _W_ALLOWED = 83, 84
_REASON_OFFSET = 3072
_REASON_CAPACITY = 1000

SAME_POSITION_RAD = 2e-4
"""A joint that differs by less from the position asked about moves no part of the arm by more than 1 mm."""


class StartRefused(FriError):
    """The start ramp from where the arm stands was judged unsafe; nothing was moved."""

    exit_code = 1


@dataclass(frozen=True, slots=True)
class StartQuestion:
    """May a motion begin at `position` (7, rad)? samples_per_command: the robot's receive multiplier."""

    number: int
    position: tuple[float, ...]
    command_period_s: float
    samples_per_command: int


class StartGate:
    """Both sides' view of the gate in one header page; words: that page as unsigned 64-bit words."""

    def __init__(self, words: memoryview, header: memoryview) -> None:
        self._words = words
        self._header = header
        self._asked: tuple[float, ...] = ()
        self._asked_pace = (0.0, 0)

    # The loop's side.

    def passes(self, position: Sequence[float], command_period_s: float, samples_per_command: int) -> bool:
        """True when a motion may begin at this position; asks where nobody asked yet. Raises StartRefused."""
        words = self._words
        if not words[_W_CLOSED]:
            return True
        asked, pace = self._asked, (command_period_s, samples_per_command)
        if (
            not asked
            or pace != self._asked_pace
            or any(abs(a - b) > SAME_POSITION_RAD for a, b in zip(position, asked, strict=True))
        ):
            self._asked, self._asked_pace = tuple(position), pace
            _POSITION.pack_into(self._header, _POSITION_OFFSET, *position)
            words[_W_PERIOD] = round(command_period_s * 1e3)
            words[_W_SAMPLES] = samples_per_command
            words[_W_NUMBER] += 1
            return False
        if words[_W_ANSWERED] != words[_W_NUMBER]:
            return False
        if not words[_W_ALLOWED]:
            raise StartRefused(self.reason)
        return True

    # The supervisor's side.

    def close(self) -> None:
        """From now on no motion begins without an answer."""
        self._words[_W_CLOSED] = 1

    @property
    def question(self) -> StartQuestion | None:
        """What the loop wants to know; None where it has asked nothing or has its answer."""
        words = self._words
        number = int(words[_W_NUMBER])
        if number == words[_W_ANSWERED]:
            return None
        position = _POSITION.unpack_from(self._header, _POSITION_OFFSET)
        return StartQuestion(number, position, words[_W_PERIOD] * 1e-3, int(words[_W_SAMPLES]))

    def answer(self, number: int, reason: str = "") -> None:
        """Answer a question: allowed without a reason, refused with one. An older number than asked is no answer."""
        data = reason.encode()[:_REASON_CAPACITY]
        self._header[_REASON_OFFSET + 8 : _REASON_OFFSET + 8 + len(data)] = data
        self._words[_REASON_OFFSET // 8] = len(data)
        self._words[_W_ALLOWED] = int(not data)
        self._words[_W_ANSWERED] = number

    @property
    def reason(self) -> str:
        """Why the last question was answered with no; empty otherwise."""
        length = min(int(self._words[_REASON_OFFSET // 8]), _REASON_CAPACITY)
        return bytes(self._header[_REASON_OFFSET + 8 : _REASON_OFFSET + 8 + length]).decode(errors="replace")
