"""Real processes for the end-to-end tests: the command line as a user starts it, and the fake robot beside it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from tests.watchdog import WATCHDOG_S

COMMAND = [sys.executable, "-c", "from daemon.cli import main; main()"]


def iiwa_ident(
    *words: object, stdin: str | None = None, timeout: float = WATCHDOG_S
) -> subprocess.CompletedProcess[str]:
    """Run `iiwa-ident` with the given words as a process of its own; returns what it printed and its exit code."""
    return subprocess.run(
        [*COMMAND, *map(str, words)], input=stdin, capture_output=True, text=True, timeout=timeout, check=False
    )


def start_iiwa_ident(*words: object) -> subprocess.Popen[str]:
    """Start `iiwa-ident` in a process group of its own and do not wait."""
    return subprocess.Popen(
        [*COMMAND, *map(str, words)],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip


@contextlib.contextmanager
def fake_robot(port: int, summary: Path, *options: object) -> Iterator[subprocess.Popen[bytes]]:
    """A fake robot that sends to `port` while the block runs; its summary is written when the block ends."""
    process = subprocess.Popen(
        [sys.executable, "-m", "fixtures.fake_robot", "--client", f"127.0.0.1:{port}", "--json", str(summary)]
        + [str(option) for option in options],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=os.environ.copy(),
    )  # fmt: skip
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(WATCHDOG_S)
