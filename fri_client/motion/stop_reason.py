"""Why a motion is stopped before its end and how: the value object that travels from whoever asks to the report.

Which reason counts and what the arm then does is decided in `motion`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fri_client.handover.ring import EventCode
from safety.guard import GuardVerdict

StopKind = Literal["path", "joint_space"]
"""How a stop is driven: on the table's own path, slowed; or each joint on its own, off the path."""
_READABLE_NM = 1e6


@dataclass(frozen=True, slots=True)
class StopReason:
    """Why the motion stops or stopped early: code of EventCode, one sentence, joint (from 1, 0: none) and numbers.

    criterion: which of the guard's it is. path_is_good: the stop may keep to the path; not where the path is at fault.
    """

    code: EventCode
    sentence: str
    joint: int = 0
    value: float = 0.0
    limit: float = 0.0
    criterion: str = ""
    path_is_good: bool = True

    @classmethod
    def from_verdict(cls, verdict: GuardVerdict) -> StopReason:
        """The guard refused a command: for what the table asks, or because the arm does not follow it."""
        return cls(
            EventCode.GUARD,
            verdict.sentence(),
            verdict.joint,
            verdict.value,
            verdict.limit,
            verdict.criterion,
            path_is_good=verdict.criterion == "distance_to_measured",
        )


def too_much_torque(joint: int, value: float, limit: float) -> StopReason:
    """The robot reports more external torque, Nm, at a joint (from 1) than its threshold."""
    # A flipped bit can make any number of it; three hundred digits tell nobody anything.
    said = f"{value:.1f}" if abs(value) < _READABLE_NM else f"{value:.1e}"
    return StopReason(
        EventCode.EXTERNAL_TORQUE,
        f"The external torque of joint {joint} is {said} Nm, beyond the limit of {limit:.1f} Nm "
        "(contact, or load data that do not fit).",
        joint,
        value,
        limit,
        "external_torque",
    )


NO_EXTERNAL_TORQUE = StopReason(
    EventCode.EXTERNAL_TORQUE,
    "The robot sends no external torque any more, which is watched in this motion.",
    criterion="external_torque",
)
