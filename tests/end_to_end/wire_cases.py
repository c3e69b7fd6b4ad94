"""Runs over a bad wire (`wire_proxy`): seven troubles at three shares, and what has to come of them.

Two robots: one with the rules it has by default, which ends a session whose answers come too rarely, and one that
tolerates as much as its rules can. With the second the whole motion has to be driven. With the first the rules decide:
of 100 messages 90 have to be answered in time for a motion to begin and 88 for it to go on. Where a share leaves 96 or
more, the motion has to be driven; where it leaves 64 or fewer (0.8 squared), none may begin; between them, and where a
flipped byte may claim anything, the outcome is the robot's to decide. What holds in every cell is in test_wire.py.
"""

from __future__ import annotations

from collections.abc import Iterator

from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.wire_proxy import TROUBLES

__all__ = ["REAL", "WIRE_CASES"]

SHARES = (0.01, 0.05, 0.20)
TOLERANT = {
    "quality_window_s": 1.0, "quality_fair": 0.1, "quality_good": 0.2, "quality_excellent": 0.9,
    "missed_commands_tolerated": 100, "mirror_timeout_s": 60.0, "mirror_cycles": 5,
}  # fmt: skip
UNSEEN = {"answers_lost_unseen": True, "closing_idle_messages": 200}
"""The second: a session that is ended while the arm brakes lasts until it stands."""
DRIVEN = ("finished", "completed", 0)
NOT_BEGUN = ("none", "not_started", 69)
UNKNOWN = ("", None, 0)
AT_LEAST_96 = {(trouble, 0.01) for trouble in ("loss", "jitter", "reorder", "garbage")} | {
    ("duplicate", share) for share in SHARES
}
AT_MOST_64 = {(trouble, 0.20) for trouble in ("loss", "delay", "reorder", "garbage")}


def _cases() -> Iterator[FaultCase]:
    for trouble, meaning in TROUBLES.items():
        for share in SHARES:
            cell = (trouble, share)
            arm, outcome, code = DRIVEN if cell in AT_LEAST_96 else NOT_BEGUN if cell in AT_MOST_64 else UNKNOWN
            yield FaultCase(
                f"{trouble}-{share:.0%}", f"{share:.0%} of {meaning}", arm, outcome, code, clock=True, wire=cell,
                session=UNSEEN, request={"periods": 1, "command_timeout_s": 4.0},
            )  # fmt: skip
        if trouble != "flip":
            yield FaultCase(
                f"{trouble}-20%-tolerant", f"20% of {meaning}; tolerant robot", *DRIVEN, clock=True,
                wire=(trouble, 0.2), session=TOLERANT | UNSEEN, request={"periods": 1},
            )  # fmt: skip


WIRE_CASES: tuple[FaultCase, ...] = tuple(_cases())

REAL = ("loss-1%", "delay-1%", "jitter-1%", "duplicate-20%", "reorder-1%", "garbage-1%", "flip-5%")
"""One of each trouble that is run with real processes too; all cells of them: benchmarks/faults.py --wire. Where
answers are lost, so few that no row of them grows to more steps than one cycle may hold, however the machine behaves.
"""
