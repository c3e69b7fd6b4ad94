"""The tests with processes, threads and sockets, again and again beside two busy loops: do they grade the machine?

Run: python -m benchmarks.tests_under_load [--times 10] [--busy 2] [FILE ...]
One file at a time. Exit status 1 if a test failed; each failure is printed with the round in which it came.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
FILES = (
    "tests/daemon/test_control_socket.py",
    "tests/daemon/test_doctor.py",
    "tests/daemon/test_full_disk.py",
    "tests/daemon/test_job_queue.py",
    "tests/daemon/test_link_observation.py",
    "tests/daemon/test_loop_process.py",
    "tests/daemon/test_recorder.py",
    "tests/daemon/test_rescue.py",
    "tests/daemon/test_server.py",
    "tests/daemon/test_service.py",
    "tests/daemon/test_start_check.py",
    "tests/daemon/test_stop_handle.py",
    "tests/daemon/test_systemd_notify.py",
    "tests/daemon/test_worker.py",
    "tests/end_to_end/test_chain.py",
    "tests/end_to_end/test_command_line.py",
    "tests/end_to_end/test_faults_of_host.py",
    "tests/end_to_end/test_faults_of_robot.py",
    "tests/end_to_end/test_wire.py",
    "tests/fixtures/test_command_line.py",
    "tests/fixtures/test_server.py",
    "tests/fri_client/test_handover.py",
    "tests/fri_client/test_loop.py",
    "tests/fri_client/test_realtime.py",
)


def main() -> int:
    """Run the files, print what failed; exit status 1 where something did."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--busy", type=int, default=2, help="busy loops beside the tests")
    parser.add_argument("files", nargs="*", default=FILES)
    arguments = parser.parse_args()
    failed: Counter[str] = Counter()
    with busy_loops(arguments.busy):
        for number in range(1, arguments.times + 1):
            for file in arguments.files:
                last, names = run(file)
                print(f"round {number}, load {os.getloadavg()[0]:.1f}, {file}: {last}", flush=True)
                for name in names:
                    print(f"  failed: {name}", flush=True)
                failed.update(names)
    for name, times in failed.most_common():
        print(f"{times} of {arguments.times}: {name}")
    print(f"{arguments.times} rounds of {len(arguments.files)} files: {failed.total()} failures")
    return 1 if failed else 0


@contextlib.contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """So many processes that do nothing but compute, while the block runs."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def run(file: str) -> tuple[str, list[str]]:
    """The last line of pytest, and the tests that failed; a file that pytest cannot run counts as one."""
    command = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-rfE", "--color=no", "-o", "addopts=", file]
    command.append("--import-mode=importlib")
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    lines = done.stdout.strip().splitlines() or [done.stderr.strip()[-200:]]
    names = [match[1] for line in lines if (match := re.match(r"(?:FAILED|ERROR) (\S+)", line))]
    if done.returncode not in (0, 5) and not names:
        names = [f"{file} (pytest ended with {done.returncode})"]
    return lines[-1], names


if __name__ == "__main__":
    sys.exit(main())
