"""What one record of the hand-over ring says: its fields, its events, and the loop's status in the ring's header.

Values only; how they lie in memory is `handover`. The loop fills them, the recorder and the supervisor read them.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class EventCode(IntEnum):
    """What happened at a record. `event_joint` counts from 1 (0: no joint); the two numbers are named per code."""

    NONE = 0
    # Changes. value: before, limit: after.
    STATE_CHANGE = 1
    PHASE_CHANGE = 2
    QUALITY_CHANGE = 3
    # Reasons of a stop: each leads to a stop ramp. value and limit as the criterion has them.
    OPERATOR_STOP = 10
    SIGNAL_STOP = 11
    GUARD = 12
    EXTERNAL_TORQUE = 13
    SUPERVISOR_LOST = 14
    RECORDER_LOST = 15
    DISK_FULL = 16
    RAMP_ERROR = 17
    FAULT = 18
    TERMINAL_CLOSED = 19
    # The session was lost for this run. value: DropReason, limit: session state after.
    SESSION_DROP = 30
    # How the arm is brought to rest. value: duration in s, limit: rows of the table on the way (0 off the path).
    STOP_ON_PATH = 35
    STOP_IN_JOINT_SPACE = 36
    # Ends. value: spread of the last samples in rad, limit: threshold in rad.
    STANDSTILL_CONFIRMED = 40
    STANDSTILL_NOT_CONFIRMED = 41
    START_TIMEOUT = 42
    # The link. GAP: value messages missing before this one; REFUSED: joint, the wrong number, as limit the Refusal;
    # SILENCE: value and time-out in s; UNDECODABLE: value bytes.
    GAP = 50
    REFUSED = 51
    SILENCE = 52
    UNDECODABLE = 53

    @property
    def is_stop_reason(self) -> bool:
        """True for the codes that ask a moving arm to ramp down."""
        return 10 <= self.value < 30


class Disposition(IntEnum):
    """How the session judged the datagram of a record."""

    FRESH = 0
    DUPLICATE = 1
    STALE = 2
    REFUSED = 3
    """Decoded, but not usable as a sample: a number that is not finite, or a group missing."""
    UNDECODABLE = 4
    """`monitoring` holds the bytes as they came; they are no monitoring message."""
    EVENT_ONLY = 5
    """No datagram: the record only carries an event (a second one at the same tick, or silence)."""


@dataclass(slots=True)
class HandoverRecord:
    """One slot, copied out of the ring.

    index counts pushes from 0, lost ones included, so a step larger than 1 is a gap. receive_ns and send_ns are
    CLOCK_MONOTONIC (send_ns 0: not answered). phase is a MotionPhase; phase, period and sample_in_period label the
    command sent in answer (-1 outside EXCITATION). monitoring holds the raw datagram (empty for EVENT_ONLY),
    command the raw answer (None: not answered).
    """

    index: int
    receive_ns: int
    send_ns: int
    phase: int
    period: int
    sample_in_period: int
    event_code: int
    event_joint: int
    event_value: float
    event_limit: float
    monitoring: bytes
    command: bytes | None
    disposition: int = 0


@dataclass(frozen=True, slots=True)
class LoopStatus:
    """What the loop last said of itself; all counts since its start, time in CLOCK_MONOTONIC ns."""

    time_ns: int = 0
    tick: int = 0
    phase: int = 0
    period: int = -1
    session_state: int = 0
    quality: int = 0
    received: int = 0
    answered: int = 0
    late: int = 0
    missing: int = 0
    duplicates: int = 0
    stale: int = 0
    refused: int = 0
    undecodable: int = 0
    stop_reason: int = 0
    foreign: int = 0
    periods_completed: int = 0
