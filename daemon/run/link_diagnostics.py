"""What /diagnostics says once a second of the link and of the recorder; pure."""

from __future__ import annotations

from daemon.log.cdr import DiagnosticStatus
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import HandoverRing
from fri_client.messages import name_or_number

COUNTS = ("received", "answered", "late", "missing", "duplicates", "stale", "refused", "undecodable")
"""What the loop's status counts of the link."""


def diagnostics_of(ring: HandoverRing, samples: int) -> list[DiagnosticStatus]:
    """The link as the loop last saw it, and the way from the loop to the file; samples: in the file so far."""
    status, lost = ring.status, ring.lost
    return [
        DiagnosticStatus(
            int(status.late + status.missing > 0),
            "FRI link",
            f"{name_or_number(MotionPhase, status.phase)}, {status.missing} missing, {status.late} late",
            tuple((name, str(getattr(status, name))) for name in COUNTS),
        ),
        DiagnosticStatus(
            2 if lost else 0,
            "recorder",
            f"{lost} samples lost between loop and file" if lost else "nothing lost",
            (("backlog", str(ring.backlog)), ("samples", str(samples)), ("lost", str(lost))),
        ),
    ]
