"""What a run needs on either side: a ring as the loop makes it, and a fake robot in a process of its own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from fri_client.handover.ring import HandoverRing
from tests.ports import free_udp_port
from tests.watchdog import WATCHDOG_S

from .service_runs import REPOSITORY


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
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "fixtures.fake_robot", "--client", f"127.0.0.1:{port}", "--lockstep"),
            *("--duration", "600", "--seed", "3", "--json", str(summary)),
        ],
        cwd=REPOSITORY,
        stderr=subprocess.DEVNULL,
    )
    yield port, summary
    process.terminate()
    process.wait(WATCHDOG_S)
