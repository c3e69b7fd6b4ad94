"""The phases of a motion, which label every sample in the log; `motion` goes through them, loop and log read them."""

from __future__ import annotations

from enum import IntEnum


class MotionPhase(IntEnum):
    """Where the motion is; the value labels every sample in the log."""

    WAITING = 0
    START_RAMP = 1
    LEAD_IN = 2
    EXCITATION = 3
    STOP_RAMP = 4
    HOLD = 5
    LATCHED = 6
    DONE = 7
