"""The table of injected faults as Markdown: what arm, robot, operator and file had of each.

Run: python -m benchmarks.faults [--out docs/faults.md] [--wire] [--only NAME ...]
--wire: loss, delay, jitter, duplicates, reordering and garbage at 1 %, 5 % and 20 % instead (by the clock: a machine
that does something else beside it adds losses of its own).
The rows are those of tests/end_to_end/fault_cases.py, where each is a test but for those at a robot by the clock, which
would grade the machine. Exit status 1 if one is not as it says.
"""

from __future__ import annotations

import argparse
import platform
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.end_to_end.fault_account import FaultResult
from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.fault_cases import FAULT_CASES
from tests.end_to_end.fault_runner import run_case
from tests.end_to_end.wire_cases import WIRE_CASES

HEAD = """\
# What happens when something goes wrong

{count} faults were injected into real runs: fake robot, loop, recorder and supervisor as processes of their own,
commands judged at the robot's side. Each row is a test (`tests/end_to_end/fault_cases.py`; those that a run goes on
after have two runs together), but for those "robot by the clock"; this page is the output of

    python -m benchmarks.faults --out docs/faults.md

- **Arm**: *finished*: the whole motion was driven. *ramp*: the commands stopped gently and the arm is at rest. *held*:
  the commands ended and the robot held the last one. *dropped*: the robot ended commanding and braked by itself.
  *none*: nothing moved.
- **v, a, j**: largest velocity, acceleration and jerk of the commands the robot accepted, in percent of the
  joint limits ([limits.md](limits.md)), over stretches of commands that came in time. In rows "robot by the clock" this
  machine decides which of the robot's cycles a command reaches, so a and j may be the machine's; what such a robot is
  sent is judged in simulated time (`python -m benchmarks.adversary`).
- **Code**: exit code; 130: interrupted, −9: the supervisor itself was killed.
- **File**: what readers that share no code with the writer found in `recording.mcap`.

kill -9 and SIGSTOP of loop, recorder, supervisor and worker at moments that nobody chose:
`python -m benchmarks.kills --moments 100 --seed 0`.

| fault | arm | v % | a % | j % | code | the operator reads | file |
|---|---|---|---|---|---|---|---|
"""

WIRE_HEAD = """\
# A bad wire

A proxy between fake robot and client spoils {count} runs, in both directions, seeded; the robot keeps its clock (5 ms a
message). Columns as in [faults.md](faults.md). In no cell did the robot refuse a command. A tolerant robot goes on with
a fifth of the answers; the others have the rules of [fake-robot.md](fake-robot.md). Where answers are lost on the way,
the robot's next step is the sum of all that it did not get: the client counts what went out, and does not see that loss
in time. That is why a tolerant robot may see more than 100 % when a fifth is lost. Output of

    python -m benchmarks.faults --wire --out docs/faults-wire.md

on a quiet machine, or after `chrt -f 5`, which keeps other work out of it. Some cells are tests
(`tests/end_to_end/wire_cases.py`).

| trouble | arm | v % | a % | j % | code | the operator reads | file |
|---|---|---|---|---|---|---|---|
"""


def main() -> int:
    """Run every case, print the rows; exit status 1 where one is not as the table says."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--wire", action="store_true")
    parser.add_argument("--only", nargs="+", default=())
    arguments = parser.parse_args()
    cases = [case for case in (WIRE_CASES if arguments.wire else FAULT_CASES) if arguments.only in ((), [])
             or case.name in arguments.only]  # fmt: skip
    rows, failed = [], []
    for case, result in run_all(cases, beside=1 if arguments.wire else 2):
        rows.append(row(case, result))
        print(rows[-1], flush=True)
        if not as_said(case, result):
            failed.append(case.name)
    text = (WIRE_HEAD if arguments.wire else HEAD).format(count=len(rows)) + "\n".join(rows) + "\n"
    if arguments.out is not None:
        arguments.out.write_text(text, encoding="utf-8")
    print(f"{len(rows)} faults, {len(failed)} not as the table says {failed or ''} ({platform.processor()})")
    return 1 if failed else 0


def run_all(cases: Iterable[FaultCase], beside: int) -> Iterable[tuple[FaultCase, FaultResult]]:
    """Each case in a folder of its own, `beside` at a time."""

    def one(case: FaultCase) -> tuple[FaultCase, FaultResult]:
        with tempfile.TemporaryDirectory(prefix="iiwa-ident-fault-") as folder:
            return case, run_case(case, Path(folder))

    with ThreadPoolExecutor(beside) as pool:
        yield from pool.map(one, cases)


def as_said(case: FaultCase, result: FaultResult) -> bool:
    """The short form of what the tests hold each row to."""
    arm = not case.arm or (result.arm, result.outcome, result.exit_code) == (case.arm, case.outcome, case.exit_code)
    inside = result.judged_inside or (case.clock if case.wire is None else result.peaks[0] <= 1.0)
    return arm and inside and result.rejections == case.rejections


def row(case: FaultCase, result: FaultResult) -> str:
    """One line of the table."""
    peaks = " | ".join(f"{100 * peak:.0f}" if result.arm != "none" else "" for peak in result.peaks)
    read = result.read.replace("|", "\\|").replace(case.name, "RUN") or "(the supervisor is gone)"
    return (
        f"| {case.what} | {result.arm} | {peaks} | {str(result.exit_code).replace('-', '−')} | {read} "
        f"| {result.describe_file()} |"
    )


if __name__ == "__main__":
    sys.exit(main())
