"""Why a decoded monitoring message is not used: the reasons, as a number in a record and as words for an operator."""

from __future__ import annotations

from enum import IntEnum


class Refusal(IntEnum):
    """What is wrong with a message. The joint counts from 1 (0: none), the value is the number that cannot be used."""

    NO_MONITOR_DATA = 1
    NO_CONNECTION_INFO = 2
    NO_MEASURED_POSITION = 3
    NO_IPO_POSITION = 4
    NUMBER_OF_JOINTS = 5
    COUNTER = 6
    MEASURED_POSITION = 7
    COMMANDED_POSITION = 8
    IPO_POSITION = 9
    MEASURED_TORQUE = 10
    EXTERNAL_TORQUE = 11
    COMMANDED_TORQUE = 12


UNREADABLE = frozenset(Refusal) - {
    Refusal.COUNTER,
    Refusal.MEASURED_TORQUE,
    Refusal.EXTERNAL_TORQUE,
    Refusal.COMMANDED_TORQUE,
}
"""Nothing of such a message is used, and its counter stays free. Where only a torque is wrong, the counter counts."""

_MISSING = {
    Refusal.NO_MONITOR_DATA: "monitor data",
    Refusal.NO_CONNECTION_INFO: "connection info",
    Refusal.NO_MEASURED_POSITION: "measured joint position",
    Refusal.NO_IPO_POSITION: "IPO position in a commanding state",
}
_OF_A_JOINT = {
    Refusal.MEASURED_POSITION: "measured joint position",
    Refusal.COMMANDED_POSITION: "commanded joint position",
    Refusal.IPO_POSITION: "IPO position",
    Refusal.MEASURED_TORQUE: "measured torque",
    Refusal.EXTERNAL_TORQUE: "external torque",
    Refusal.COMMANDED_TORQUE: "commanded torque",
}


def refusal_sentence(reason: float, joint: int, value: float) -> str:
    """Why a message was refused, as a clause without a full stop."""
    if reason in _MISSING:
        return f"it lacks its {_MISSING[Refusal(int(reason))]}"
    if reason in _OF_A_JOINT:
        return f"the {_OF_A_JOINT[Refusal(int(reason))]} of joint {joint} is {value:g}, which is impossible"
    if reason == Refusal.NUMBER_OF_JOINTS:
        return f"the robot reports {value:.0f} joints instead of 7"
    if reason == Refusal.COUNTER:
        return f"its sequence counter {value:.0f} does not fit the counters and the time before it"
    return f"the value {value:g} cannot be used"
