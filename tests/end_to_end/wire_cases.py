"""Runs over a bad wire (`wire_proxy`): six troubles at three shares, and what has to come of them.

Two robots: one with the rules it has by default, which ends a session whose answers come too rarely, and one that
tolerates as much as its rules can. With the second the whole motion has to be driven. With the first the outcome is
the robot's to decide; what holds in every cell is in test_wire.py.
"""

from __future__ import annotations

from collections.abc import Iterator

from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.wire_proxy import TROUBLES

__all__ = ["TESTED", "WIRE_CASES"]

SHARES = (0.01, 0.05, 0.20)
TOLERANT = {
    "quality_window_s": 1.0, "quality_fair": 0.1, "quality_good": 0.2, "quality_excellent": 0.9,
    "missed_commands_tolerated": 100, "mirror_timeout_s": 60.0, "mirror_cycles": 5,
}  # fmt: skip
UNSEEN = {"answers_lost_unseen": True}


def _cases() -> Iterator[FaultCase]:
    for trouble, meaning in TROUBLES.items():
        for share in SHARES:
            yield FaultCase(
                f"{trouble}-{share:.0%}", f"{share:.0%} of {meaning}", "", None, 0, clock=True, wire=(trouble, share),
                session=UNSEEN, request={"periods": 1, "command_timeout_s": 4.0},
            )  # fmt: skip
        if trouble != "flip":
            yield FaultCase(
                f"{trouble}-20%-tolerant", f"20% of {meaning}; tolerant robot", "finished", "completed", 0, clock=True,
                wire=(trouble, 0.2), session=TOLERANT | UNSEEN, request={"periods": 1},
            )  # fmt: skip


WIRE_CASES: tuple[FaultCase, ...] = tuple(_cases())

TESTED = (
    "loss-20%", "flip-5%", "duplicate-20%", "loss-20%-tolerant", "delay-20%-tolerant", "reorder-20%-tolerant",
    "garbage-20%-tolerant",
)  # fmt: skip
"""Cells that are tests; the others are run by benchmarks/faults.py --wire."""
