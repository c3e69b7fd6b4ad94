"""The sentence for each event of the loop, with its numbers; for the log and for the operator's screen."""

from __future__ import annotations

from daemon.words import counted
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import EventCode, HandoverRecord
from fri_client.messages import ConnectionQuality, SessionState, name_or_number
from fri_client.session.refusal import refusal_sentence


def event_sentence(record: HandoverRecord, loop_reason: str) -> str:
    """One sentence for the record's event; `loop_reason` is the loop's own sentence, used for stops and drops."""
    code, value, limit = record.event_code, record.event_value, record.event_limit
    if code == EventCode.STATE_CHANGE:
        return f"The session went from {name_or_number(SessionState, value)} to {name_or_number(SessionState, limit)}."
    if code == EventCode.PHASE_CHANGE:
        return f"The motion went from {name_or_number(MotionPhase, value)} to {name_or_number(MotionPhase, limit)}."
    if code == EventCode.QUALITY_CHANGE:
        before, after = (name_or_number(ConnectionQuality, quality) for quality in (value, limit))
        return f"The connection quality went from {before} to {after}."
    if code == EventCode.GAP:
        return f"{counted(int(value), 'monitoring message', verb=True)} missing before sample {record.index}."
    if code == EventCode.REFUSED:
        return f"Sample {record.index} was refused: {refusal_sentence(limit, record.event_joint, value)}."
    if code == EventCode.SILENCE:
        return f"No monitoring message came for {value:.3g} s (limit {limit:.3g} s)."
    if code == EventCode.UNDECODABLE:
        return f"A datagram of {value:.0f} bytes is no message that can be read."
    if code == EventCode.START_TIMEOUT:
        return f"No motion began within {value:.1f} s."
    if code == EventCode.STOP_ON_PATH:
        return f"The arm is slowed on its path and comes to rest within {value:.2f} s, {limit:.0f} rows further on."
    if code == EventCode.STOP_IN_JOINT_SPACE:
        return f"Each joint is stopped on its own, off the path, within {value:.2f} s."
    if code == EventCode.STANDSTILL_CONFIRMED:
        return f"The arm stands still: positions stayed within {value:.2e} rad (limit {limit:.2e} rad)."
    if code == EventCode.STANDSTILL_NOT_CONFIRMED:
        return f"Standstill is NOT confirmed: positions spread over {value:.2e} rad (limit {limit:.2e} rad)."
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
