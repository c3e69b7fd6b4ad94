"""Claims about the children's question whether their supervisor lives; real ring, the supervisor is this test."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from daemon.children import Child
from daemon.run.supervision import Supervision
from fri_client.handover.ring import HandoverRing


@pytest.fixture
def ring() -> Iterator[HandoverRing]:
    handover = HandoverRing.create(64)
    yield handover
    handover.close()


def test_nobody_ever_beat_so_nobody_is_missed(ring: HandoverRing) -> None:
    assert not Supervision(ring, os.getppid()).has_ended()


def test_a_supervisor_that_beats_again_is_not_gone(ring: HandoverRing) -> None:
    ring.beat(1)
    threading.Timer(0.1, ring.beat, (2,)).start()
    assert not Supervision(ring, os.getppid()).has_ended()


def test_a_supervisor_that_is_held_for_ever_has_ended(ring: HandoverRing, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daemon.run.supervision.PATIENCE_S", 0.1)
    ring.beat(1)
    assert Supervision(ring, os.getppid()).has_ended()


def test_a_process_with_another_parent_is_an_orphan(ring: HandoverRing, monkeypatch: pytest.MonkeyPatch) -> None:
    ring.beat(1)
    supervision = Supervision(ring, os.getppid())
    monkeypatch.setattr(os, "getppid", lambda: 1)
    assert supervision.is_orphan
    assert supervision.has_ended()


def test_a_child_knows_its_supervisor_also_where_it_was_killed_before_the_child_could_ask(
    ring: HandoverRing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The child prints the options that it was started with; this test started it."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "echo.py").write_text("import sys; print(sys.argv[1:])")
    child = Child("echo", "echo", [], ring, tmp_path)
    child.process.wait()
    assert f"'--supervisor', '{os.getpid()}'" in child.last_words
    with subprocess.Popen([sys.executable, "-c", ""]) as gone:
        pass
    assert Supervision(ring, gone.pid).is_orphan
