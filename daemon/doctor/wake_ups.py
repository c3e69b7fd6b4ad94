"""How late this machine lets a real-time process run: what no gate can hold back (docs/limits.md).

A process of its own, with the real-time settings of the loop, sleeps from millisecond to millisecond and notes by how
much it was woken late. Not here: the verdict (`host_checks`).
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import msgspec

from daemon.children import child_environment
from fri_client.realtime import RealtimeSettings, realtime

PERIOD_NS = 1_000_000
PATIENCE_S = 60.0
"""For a process to start and to end on a busy machine, beside the time it measures; one that hangs takes it all."""


@dataclass(frozen=True, slots=True)
class WakeUps:
    """Of `count` wake-ups 1 ms apart the latest came `latest_s` late; real_time: with the priority of the loop."""

    count: int
    latest_s: float
    real_time: bool


def wake_ups(seconds: float, settings: RealtimeSettings | None = None) -> WakeUps:
    """Sleep from millisecond to millisecond in this thread. settings: default those of the loop."""
    with realtime(settings or RealtimeSettings()) as report:
        count, latest = 0, 0
        due = time.monotonic_ns()
        end = due + round(seconds * 1e9)
        while due < end:
            due += PERIOD_NS
            time.sleep(max(0.0, (due - time.monotonic_ns()) * 1e-9))
            now = time.monotonic_ns()
            latest, count = max(latest, now - due), count + 1
            # One hold-up is one, not the first of many wake-ups that come too late.
            due = max(due, now - PERIOD_NS)
        return WakeUps(count, latest * 1e-9, report.item("scheduler").obtained)


@contextlib.contextmanager
def measured_wake_ups(seconds: float) -> Iterator[Callable[[], WakeUps | None]]:
    """Measure while the block lasts, in a process; what is yielded waits for the result, None where there is none."""
    command = [sys.executable, "-m", "daemon.doctor.wake_ups", "--seconds", str(seconds)]
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=child_environment()
    )

    def result() -> WakeUps | None:
        try:
            said, _ = process.communicate(timeout=seconds + PATIENCE_S)
            return msgspec.json.decode(said, type=WakeUps)
        except (subprocess.TimeoutExpired, msgspec.DecodeError):
            return None

    try:
        yield result
    finally:
        process.kill()
        process.communicate()


def main(arguments: list[str] | None = None) -> int:
    """Entry of the process."""
    parser = argparse.ArgumentParser(
        prog="python -m daemon.doctor.wake_ups", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--seconds", type=float, required=True)
    print(msgspec.json.encode(wake_ups(parser.parse_args(arguments).seconds)).decode(), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
