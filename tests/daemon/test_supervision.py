"""Claims about the children's question whether their supervisor lives; real ring, the supervisor is this test."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator

import pytest

from daemon.run.supervision import Supervision
from fri_client.handover.ring import HandoverRing


@pytest.fixture
def ring() -> Iterator[HandoverRing]:
    handover = HandoverRing.create(64)
    yield handover
    handover.close()


def test_nobody_ever_beat_so_nobody_is_missed(ring: HandoverRing) -> None:
    assert not Supervision(ring).has_ended()


def test_a_supervisor_that_beats_again_is_not_gone(ring: HandoverRing) -> None:
    ring.beat(1)
    threading.Timer(0.1, ring.beat, (2,)).start()
    assert not Supervision(ring).has_ended()


def test_a_supervisor_that_is_held_for_ever_has_ended(ring: HandoverRing, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daemon.run.supervision.PATIENCE_S", 0.1)
    ring.beat(1)
    assert Supervision(ring).has_ended()


def test_a_process_with_another_parent_is_an_orphan(ring: HandoverRing, monkeypatch: pytest.MonkeyPatch) -> None:
    ring.beat(1)
    supervision = Supervision(ring)
    monkeypatch.setattr(os, "getppid", lambda: 1)
    assert supervision.is_orphan
    assert supervision.has_ended()
