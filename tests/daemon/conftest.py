"""What a run needs on either side: a ring as the loop makes it, and a fake robot in a process of its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from fri_client.handover.ring import HandoverRing
from tests.ports import free_udp_port

from .service_process import fake_robot


@pytest.fixture
def ring() -> Iterator[HandoverRing]:
    """Room for 4096 samples; closed again when the test is over."""
    handover = HandoverRing.create(4096)
    yield handover
    handover.close()


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[tuple[int, Path]]:
    """Port that the fake robot sends to, and the file of its summary."""
    port, summary = free_udp_port(), tmp_path / "robot.json"
    with fake_robot(port, "--json", summary):
        yield port, summary
