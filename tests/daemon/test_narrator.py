"""Claims about what the operator is told while a run goes on; truth: the loop's status as this test sets it."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path

from daemon.api import RunEvent
from daemon.run.narrator import RunNarrator
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.record import LoopStatus
from fri_client.handover.ring import HandoverRing

from .producer import make_request


def test_each_period_is_told_when_it_begins_and_only_then(tmp_path: Path) -> None:
    ring = HandoverRing.create(8)
    told: list[RunEvent] = []
    narrator = RunNarrator(make_request(tmp_path, periods=3), ring, told.append)
    narrator._next_progress = float("inf")  # the count now and then, which comes by the clock
    for period in (-1, 0, 0, 1, 1, 1, 2):
        status = LoopStatus(received=100, phase=int(MotionPhase.EXCITATION), period=period)
        ring.publish_status(astuple(status))
        narrator.follow()
    ring.close()
    progress = [event for event in told if event.kind == "progress"]
    assert [event.period for event in progress] == [0, 1, 2]
    assert progress[1].sentence.startswith("Period 2 of 3: 100 messages")
