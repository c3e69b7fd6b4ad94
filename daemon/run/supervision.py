"""Whether the supervisor still lives, asked from its children: the loop's process and the recorder; and the other way.

Here: the questions. Not here: what is done when the answer is no (`rescue`, `recorder`). Light enough for the loop's
process, which imports it before it answers a robot.
"""

from __future__ import annotations

import os
import time

from fri_client.handover.ring import HandoverRing

PATIENCE_S = 5.0
"""A supervisor that is stopped (SIGSTOP) may come back; for so long after the loop's end it is waited for."""
POLL_S = 0.02


class Supervision:
    """supervisor: its process number, which a child is told when it is started.

    A child that asks for its parent once it has loaded may ask too late: a supervisor killed before has a successor.
    """

    def __init__(self, ring: HandoverRing, supervisor: int) -> None:
        self._ring = ring
        self._supervisor = supervisor

    @property
    def is_orphan(self) -> bool:
        """True when the supervisor's process is gone."""
        return os.getppid() != self._supervisor

    def has_ended(self) -> bool:
        """True when the supervisor is gone or gives no sign of life for PATIENCE_S; a living one answers within 0.1 s.

        A ring whose supervisor never beat has none that could be waited for.
        """
        last = self._ring.heartbeat_ns
        deadline = time.monotonic() + PATIENCE_S
        while not self.is_orphan:
            if not last or self._ring.heartbeat_ns != last:
                return False
            if time.monotonic() > deadline:
                return True
            time.sleep(POLL_S)
        return True


def silence_s(said_ns: int, began_s: float) -> float:
    """Seconds of the monotonic clock since a loop last spoke (ns, 0: never), or was begun where it never did."""
    return time.monotonic() - (said_ns * 1e-9 if said_ns else began_s)
