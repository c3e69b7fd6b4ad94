"""What the operator hears of a run while it goes on: the loop's status turned into events, and what was remarkable.

Here: sentences and when they are said. Not here: who shows them (the command line, the service) and what is done about
anything (`service`). An observer that fails, say because its terminal was closed, ends no run.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable

from daemon.api import RunEvent, RunRequest
from daemon.words import counted
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import Disposition, HandoverRing, LoopStatus
from fri_client.loop.peer import RIVAL_DATAGRAMS
from fri_client.loop.version_evidence import version_doubt
from fri_client.messages import FriVersion, SessionState, name_or_number

PROGRESS_S = 10.0
_STANDS_S = 1.0
"""What hinders a motion for so long is told: the first questions of every start are answered sooner."""

Observer = Callable[[RunEvent], None]


def unfailing(observe: Observer) -> Observer:
    """The observer, whose own errors are logged once and otherwise passed over."""
    failed = False

    def tell(event: RunEvent) -> None:
        nonlocal failed
        try:
            observe(event)
        except Exception as error:
            if not failed:
                failed = True
                with contextlib.suppress(OSError):
                    logging.getLogger(__name__).warning("Events of the run cannot be shown any more: %s", error)

    return tell


class RunNarrator:
    """Tells the events of one run; `follow` is called a few times a second while its loop lives."""

    def __init__(self, request: RunRequest, ring: HandoverRing, observe: Observer) -> None:
        self._periods = request.periods
        self._port = request.bind_port
        self._watches_only = request.monitor_only
        self._version = FriVersion.parse(request.fri_version)
        self._version_judged = False
        self._ring = ring
        self._observe = observe
        self.remarks: list[str] = []
        self._rate_base = (time.monotonic(), 0)
        self._last_phase = -1
        self._last_state = -1
        self._last_period = -1
        self._next_progress = 0.0
        self._next_hindrance: float | None = None

    def tell(self, kind: str, sentence: str, *, period: int = -1) -> None:
        """One event."""
        status = self._ring.status
        self._observe(
            RunEvent(
                kind=kind,
                sentence=sentence,
                phase=name_or_number(MotionPhase, status.phase),
                period=period,
                periods=self._periods,
                samples=status.received,
                missing=status.missing,
                lost_in_handover=self._ring.lost,
                port=self._port,
            )
        )

    def remark(self, sentence: str) -> None:
        """A warning that also belongs into run.json; said once."""
        if sentence not in self.remarks:
            self.remarks.append(sentence)
            self.tell("warning", sentence)

    def has_judged_version(self) -> bool:
        """Say once what speaks against the FRI version of the request in what the robot sends; False: nothing came yet.

        Copies of the newest records while the loop pushes are whole: their slots are taken again a ring's length later.
        """
        if not self._version_judged:
            fresh = [each for each in self._ring.newest(16) if each.disposition == Disposition.FRESH]
            if not fresh:
                return False
            self._version_judged = True
            doubt = version_doubt(fresh[0].monitoring, self._version)
            if doubt:
                self.tell("warning", doubt.strip())
        return True

    def follow(self) -> None:
        """The loop's states, phases and periods as they change, and the count now and then."""
        status = self._ring.status
        if not status.received:
            return
        if status.session_state != self._last_state:
            self._last_state = status.session_state
            self.tell("session", f"Session state: {name_or_number(SessionState, status.session_state)}.")
        if status.phase != self._last_phase:
            self._last_phase = status.phase
            phase = name_or_number(MotionPhase, status.phase).lower().replace("_", " ")
            self.tell("phase", "Recording; nothing is commanded." if self._watches_only else f"Motion: {phase}.")
        if status.foreign >= RIVAL_DATAGRAMS:
            self.remark(
                "Somebody else sends to this port as well, and is passed over: make sure that the arm that moves is "
                "the one that is meant, and that one robot alone sends here."
            )
        now = time.monotonic()
        self._tell_hindrance(status, now)
        begun = status.period != self._last_period and status.period >= 0
        if begun or now >= self._next_progress:
            self._last_period = status.period
            self._next_progress = now + PROGRESS_S
            then, count = self._rate_base
            rate = (status.received - count) / max(now - then, 1e-3)
            self._rate_base = (now, status.received)
            place = f"Period {status.period + 1} of {self._periods}" if status.period >= 0 else "Link"
            self.tell(
                "progress",
                f"{place}: {counted(status.received, 'message')}, {rate:.0f}/s, {status.missing} missing, "
                f"{status.late} late.",
                period=status.period,
            )

    def _tell_hindrance(self, status: LoopStatus, now: float) -> None:
        """Why no motion begins although the robot commands: an operator stands beside it and can help."""
        waits = (status.phase, status.session_state) == (MotionPhase.WAITING, SessionState.COMMANDING_ACTIVE)
        hindrance = self._ring.hindrance if waits else ""
        if not hindrance:
            self._next_hindrance = None
        elif self._next_hindrance is None:
            self._next_hindrance = now + _STANDS_S
        elif now >= self._next_hindrance:
            self._next_hindrance = now + PROGRESS_S
            self.tell("waiting", f"No motion begins yet: {hindrance}.")
