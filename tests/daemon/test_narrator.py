"""Claims about what the operator is told while a run goes on; truth: the loop's status as this test sets it."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path

import pytest

from daemon.api import RunEvent
from daemon.run import narrator as narrator_module
from daemon.run.narrator import RunNarrator
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.record import LoopStatus
from fri_client.handover.ring import HandoverRing
from fri_client.messages import SessionState

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


def test_a_second_sender_is_told_once_while_somebody_can_still_look(tmp_path: Path) -> None:
    """Two robots sent to one port for a whole run, one of them moved, and nothing was said of the other."""
    ring = HandoverRing.create(8)
    narrator = RunNarrator(make_request(tmp_path), ring, lambda _: None)
    for foreign in (0, 1, 9, 10, 11, 5000):
        ring.publish_status(astuple(LoopStatus(received=100, foreign=foreign)))
        narrator.follow()
        assert len(narrator.remarks) == (foreign >= 10)
    ring.close()
    assert "Somebody else sends to this port as well" in narrator.remarks[0]


def test_what_hinders_a_motion_is_told_while_somebody_can_still_help(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ring, told, now = HandoverRing.create(8), [], [100.0]
    monkeypatch.setattr(narrator_module.time, "monotonic", lambda: now[0])
    narrator = RunNarrator(
        make_request(tmp_path), ring, lambda event: told.append((now[0], event.kind, event.sentence))
    )

    def status(phase: MotionPhase) -> None:
        state = int(SessionState.COMMANDING_ACTIVE)
        ring.publish_status(astuple(LoopStatus(received=9, phase=int(phase), session_state=state)))

    script = [(100.0, "the start ramp is not cleared yet"), (100.6, ""), (102.0, "the mode is AUT"), (125.0, "")]
    for tenth in range(1000, 1300):
        now[0] = tenth / 10.0
        for since, clause in script:
            if since == now[0]:
                ring.publish_hindrance(clause)
        status(MotionPhase.WAITING)
        narrator.follow()
    ring.publish_hindrance("the mode is AUT")
    status(MotionPhase.START_RAMP)
    now[0] += 60.0
    narrator.follow()
    ring.close()
    sentence = "No motion begins yet: the mode is AUT."
    assert [(at, said) for at, kind, said in told if kind == "waiting"] == [
        (pytest.approx(103.0, abs=0.11), sentence),
        (pytest.approx(113.0, abs=0.21), sentence),
        (pytest.approx(123.0, abs=0.31), sentence),
    ]
