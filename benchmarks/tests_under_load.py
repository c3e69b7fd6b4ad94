"""The tests with processes, threads and sockets, again and again beside two busy loops: do they grade the machine?

Run: python -m benchmarks.tests_under_load [--times 10] [--busy 2] [--processes 1] [FILE ...]
One file at a time, or all at once in several processes: ten rounds in eight of them take two hours of two cores. Exit
status 1 if a test failed; each failure is printed with the round in which it came.

The busy loops belong to the session of the tests. Linux gives sessions equal shares (`sched_autogroup`): a loop with a
session of its own takes as much as all tests together.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
_AT_RISK = re.compile(
    r"^(?:import|from) (?:threading|socket|zmq|signal|multiprocessing|tests\.end_to_end|\.(?:processes|acquisition|"
    r"fault_\w+|wire_\w+|service_\w+|simulated_wire|scripted_\w+)|tests\.ports|benchmarks\.kills|"
    r"daemon\.(?:queue|run\.service))\b"
    r"|subprocess\.Popen\(",
    re.MULTILINE,
)


def main() -> int:
    """Run the files, print what failed; exit status 1 where something did."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--busy", type=int, default=2, help="busy loops beside the tests")
    parser.add_argument("--processes", type=int, default=1, help="in which all files run at once; 1: file by file")
    parser.add_argument("files", nargs="*", help="default: all with processes, threads, sockets or signals")
    arguments = parser.parse_args()
    # Ended from outside, the busy loops must not go on: they would load whatever runs next.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    files = arguments.files or files_at_risk()
    failed: Counter[str] = Counter()
    with busy_loops(arguments.busy):
        for number in range(1, arguments.times + 1):
            for part in [files] if arguments.processes > 1 else [[file] for file in files]:
                last, names = run(part, arguments.processes)
                what = part[0] if len(part) == 1 else f"{len(part)} files"
                print(f"round {number}, load {os.getloadavg()[0]:.1f}, {what}: {last}", flush=True)
                for name in names:
                    print(f"  failed: {name}", flush=True)
                failed.update(names)
    for name, times in failed.most_common():
        print(f"{times} of {arguments.times}: {name}")
    print(f"{arguments.times} rounds of {len(files)} files: {failed.total()} failures")
    return 1 if failed else 0


def files_at_risk() -> list[str]:
    """Test files that start processes or threads, or use sockets or signals: none is left out."""
    found = (REPOSITORY / "tests").rglob("test_*.py")
    return sorted(str(file.relative_to(REPOSITORY)) for file in found if _AT_RISK.search(file.read_text("utf-8")))


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


def run(files: Sequence[str], processes: int = 1) -> tuple[str, list[str]]:
    """The last line of pytest, and the tests that failed; files that pytest cannot run count as one."""
    command = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-rfE", "--color=no", "-o", "addopts=", *files]
    command += ["--import-mode=importlib", "-n", str(processes if processes > 1 else 0)]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    lines = done.stdout.strip().splitlines() or [done.stderr.strip()[-200:]]
    names = [match[1] for line in lines if (match := re.match(r"(?:FAILED|ERROR) (\S+)", line))]
    if done.returncode not in (0, 5) and not names:
        names = [f"{', '.join(files)} (pytest ended with {done.returncode})"]
    return lines[-1], names


if __name__ == "__main__":
    sys.exit(main())
