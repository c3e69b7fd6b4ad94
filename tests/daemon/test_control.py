"""Claims about the inbox's private folder; the process that left one behind is really killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from daemon.run.control import ControlInbox

REPOSITORY = Path(__file__).resolve().parents[2]
HOLDER = "from daemon.run.control import ControlInbox\nwith ControlInbox():\n print('up', flush=True)\n input()"


def test_what_a_killed_run_left_goes_at_the_next_start_and_what_lives_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    holders = [
        subprocess.Popen(
            [sys.executable, "-c", HOLDER], cwd=REPOSITORY, env={**os.environ, "TMPDIR": str(tmp_path)},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )
        for _ in range(2)
    ]  # fmt: skip
    try:
        for holder in holders:
            assert holder.stdout is not None
            assert holder.stdout.readline() == b"up\n"
        assert len(list(tmp_path.iterdir())) == 2
        holders[0].send_signal(signal.SIGKILL)
        holders[0].wait()
        with ControlInbox():
            left = {int(folder.name.split("-")[2]) for folder in tmp_path.iterdir()}
        assert left == {holders[1].pid, os.getpid()}
    finally:
        for holder in holders:
            holder.kill()
            holder.wait()
