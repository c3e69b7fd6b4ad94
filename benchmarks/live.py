"""What watching costs the loop: turn-around and late answers with `run --live` and two watchers, and without.

Reproduce: `python -m benchmarks.live` (6 runs of 60 s; `--periods 1 --pairs 1` for a short one) on a machine that does
nothing else. Runs without and with watchers take turns, so that what changes on the machine meets both. Prints a table
with the load of the machine; exit status 1 where the p99.9 with watchers is more than 5 % above the one without, or
answers were late that were not without.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.ports import free_udp_port

COMMAND = [sys.executable, "-c", "from daemon.cli import main; main()"]
ALLOWED = 1.05


def main() -> int:
    """Run in turns, print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--periods", type=int, default=6, help="of 10 s, in each run")
    arguments = parser.parse_args()
    found: dict[bool, list[dict[str, Any]]] = {False: [], True: []}
    print("| watched | received | late | missing | turn-around p50 · p99 · p99.9 · largest, µs | load |")
    print("|---|---|---|---|---|---|")
    for _ in range(arguments.pairs):
        for watched in (False, True):
            report = run(arguments.periods, watched=watched)
            found[watched].append(report)
            turn = report["link"]["turn_around"]
            times = " · ".join(f"{turn[name]:.0f}" for name in ("p50_us", "p99_us", "p999_us", "max_us"))
            counts = " | ".join(str(report[name]) for name in ("received", "late", "missing"))
            print(f"| {'yes' if watched else 'no'} | {counts} | {times} | {os.getloadavg()[0]:.1f} |", flush=True)
    without, with_watchers = (
        sum(each["link"]["turn_around"]["p999_us"] for each in found[watched]) / arguments.pairs
        for watched in (False, True)
    )
    late = [sum(each["late"] for each in found[watched]) for watched in (False, True)]
    print(f"\np99.9 with watchers over without: {with_watchers / without:.3f}; late {late[1]} against {late[0]}.")
    return int(with_watchers > ALLOWED * without or late[1] > late[0])


def run(periods: int, *, watched: bool) -> dict[str, Any]:
    """The loop's report of one run from the fake robot, in real time on loopback."""
    port = free_udp_port()
    with tempfile.TemporaryDirectory(prefix="iiwa-ident-live-") as scratch:
        robot = subprocess.Popen([*COMMAND, "-q", "fake-robot", "--client", f"127.0.0.1:{port}"])
        options = ["--bind", f"127.0.0.1:{port}", "--periods", str(periods), "--no-fit", "--out", f"{scratch}/run"]
        watchers: list[subprocess.Popen[bytes]] = []
        try:
            acquisition = subprocess.Popen(
                [*COMMAND, "run", *options, *(["--live"] if watched else [])],
                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            )  # fmt: skip
            assert acquisition.stderr is not None
            for line in acquisition.stderr:
                # From the first message on there is something to see.
                if watched and not watchers and line.startswith(b"[session]"):
                    watch = [*COMMAND, "watch", "--port", str(port), "--json", os.devnull]
                    watchers = [subprocess.Popen(watch, stderr=subprocess.DEVNULL) for _ in range(2)]
            acquisition.wait()
            for watcher in watchers:
                watcher.wait()
        finally:
            robot.terminate()
            robot.wait(30)
        report: dict[str, Any] = json.loads((Path(scratch) / "run" / "loop_report.json").read_text())
    return report


if __name__ == "__main__":
    sys.exit(main())
