"""The sentence for each event of the loop, with its numbers; for the log and for the operator's screen."""

from __future__ import annotations

from enum import IntEnum

from daemon.words import counted
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode, HandoverRecord
from fri_client.messages import ConnectionQuality, SessionState, name_or_number
from fri_client.session.refusal import refusal_sentence

_CHANGES: dict[EventCode, tuple[str, type[IntEnum]]] = {
    EventCode.STATE_CHANGE: ("session", SessionState),
    EventCode.PHASE_CHANGE: ("motion", MotionPhase),
    EventCode.QUALITY_CHANGE: ("connection quality", ConnectionQuality),
}
_SENTENCES = {
    EventCode.SILENCE: "No monitoring message came for {value:.3g} s (limit {limit:.3g} s).",
    EventCode.UNDECODABLE: "A datagram of {value:.0f} bytes is no message that can be read.",
    EventCode.START_TIMEOUT: "No motion began within {value:.1f} s.",
    EventCode.STOP_ON_PATH: "The arm is slowed on its path and comes to rest within {value:.2f} s, {limit:.0f} rows "
    "further on.",
    EventCode.STOP_IN_JOINT_SPACE: "Each joint is stopped on its own, off the path, within {value:.2f} s.",
    EventCode.STANDSTILL_CONFIRMED: "The arm stands still: positions stayed within {value:.2e} rad (limit {limit:.2e} "
    "rad).",
    EventCode.STANDSTILL_NOT_CONFIRMED: "Standstill is NOT confirmed: positions spread over {value:.2e} rad (limit "
    "{limit:.2e} rad).",
}


def event_sentence(record: HandoverRecord, loop_reason: str) -> str:
    """One sentence for the record's event; `loop_reason` is the loop's own sentence, used for stops and drops."""
    code, value, limit = record.event_code, record.event_value, record.event_limit
    if code in _CHANGES:
        what, kind = _CHANGES[EventCode(code)]
        return f"The {what} went from {name_or_number(kind, value)} to {name_or_number(kind, limit)}."
    if code == EventCode.GAP:
        return f"{counted(int(value), 'monitoring message', verb=True)} missing before sample {record.index}."
    if code == EventCode.REFUSED:
        return f"Sample {record.index} was refused: {refusal_sentence(limit, record.event_joint, value)}."
    if code in _SENTENCES:
        return _SENTENCES[EventCode(code)].format(value=value, limit=limit)
    if loop_reason:
        return loop_reason
    name = event_name(code)
    joint = f", joint {record.event_joint}" if record.event_joint else ""
    return f"{name}{joint}: value {value:g}, limit {limit:g}."


def event_name(code: int) -> str:
    """Name of an EventCode; EVENT_n for a number that has none."""
    try:
        return EventCode(code).name
    except ValueError:
        return f"EVENT_{code}"
