"""kill -9 and SIGSTOP of each process of a run, at random moments: is the arm at rest, is every sample accounted for?

Run: python -m benchmarks.kills [--moments 100] [--seed 0] [--only PROCESS]
Real processes against the fake robot in simulated time, at the pace of a real robot at most, so that nothing here
depends on how busy the machine is. Prints a row for each moment and a summary; exit status 1 where one is not as it
should be. What is asked of each moment:

- The arm is judged at the robot's side (`fixtures.judge`): no command beyond a limit, and at the end it stands. It
  comes to rest by our ramp, unless the loop itself was taken away: then nobody can answer, and the robot brakes.
- Every sample that the robot got an answer to is in the file, or counted as lost in run.json. A loop that is killed
  may hold one answer of which it could not tell any more.
- run.json is there when the last process has ended, or after `iiwa-ident recover`.
- No process is left.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from signal import SIGKILL, SIGSTOP

import numpy as np

from tests.end_to_end.fault_account import FaultResult
from tests.end_to_end.fault_case import FaultCase, Step
from tests.end_to_end.fault_runner import run_case
from tests.end_to_end.processes import iiwa_ident

PROCESSES = ("loop", "recorder", "supervisor", "worker")
HOWS = ("kill -9", "stopped for 10 s", "stopped for ever")
MESSAGES = 6500
"""Received in a whole run, from the first one to the confirmed standstill; drawn from all of them."""
REST_RAD_S = 5e-3


@dataclass(frozen=True, slots=True)
class Moment:
    """What happens to which process, and after how many messages; of the worker: as soon as it is seen."""

    process: str
    how: str
    message: int
    periods: int = 2

    def case(self, number: int) -> FaultCase:
        """The run in which it happens."""
        signal, resume = (SIGKILL, None) if self.how == HOWS[0] else (SIGSTOP, None if self.how == HOWS[2] else 10.0)
        place = {"when": r"\[worker\]"} if self.process == "worker" else {"when": "", "at_message": self.message}
        return FaultCase(
            f"moment-{number}",
            str(self),
            arm="held" if self.process == "loop" else "ramp",
            outcome=None,
            exit_code=0,
            steps=(Step(targets=(self.process,), number=signal, resume_after_s=resume, **place),),
            session={"lockstep_cycle_s": 0.001},
            request={"periods": self.periods, "fit": self.process == "worker", "receive_timeout_s": 10.0},
        )

    def __str__(self) -> str:
        at = "in the fit" if self.process == "worker" else f"at message {self.message}"
        return f"{self.process} {self.how} {at}"


def draw(
    count: int, seed: int, processes: tuple[str, ...] = PROCESSES, *, messages: int = MESSAGES, periods: int = 2
) -> list[Moment]:
    """So many moments: each process and each way in turn, the message at random among so many."""
    random = np.random.default_rng(seed)
    kinds = [(process, how) for how in HOWS for process in processes]
    return [Moment(*kinds[number % len(kinds)], int(random.integers(messages)), periods) for number in range(count)]


def play(moment: Moment, number: int, folder: Path) -> tuple[FaultResult, list[str]]:
    """Run it in an empty folder: what was measured, and what is not as it should be."""
    result = run_case(moment.case(number), folder)
    has_account = result.has_account
    if not has_account:
        iiwa_ident("recover", folder / "run")
        has_account = (folder / "run" / "run.json").is_file()
    return result, judge(moment, result, has_account=has_account)


def judge(moment: Moment, result: FaultResult, *, has_account: bool) -> list[str]:
    """What is not as it should be; empty where all is well."""
    wrong = []
    if not result.judged_inside:
        wrong.append("a command beyond a limit")
    if result.rejections:
        wrong.append(f"the robot refused a command ({', '.join(result.rejections)})")
    if result.speed_at_end >= REST_RAD_S:
        wrong.append(f"the arm moves at {result.speed_at_end:.3g} rad/s")
    if moment.process != "loop" and result.arm not in ("none", "ramp", "finished"):
        wrong.append(f"the arm was {result.arm}")
    untold = 1 if moment.process == "loop" else 0
    accounted = result.answered_samples + result.lost
    if accounted < result.robot_answered - untold:
        wrong.append(f"{result.robot_answered - accounted} answered samples are nowhere")
    if not has_account:
        wrong.append("no run.json")
    if result.left_running:
        wrong.append(f"left running: {', '.join(result.left_running)}")
    return wrong


def main() -> int:
    """Play all moments; exit status 1 where one is not as it should be."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--moments", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=PROCESSES, help="one of the processes")
    arguments = parser.parse_args()
    failed = 0
    print("| process, what, when | arm | outcome, exit code | answered · in the file · lost | not as it should be |")
    print("|---|---|---|---|---|", flush=True)
    moments = draw(arguments.moments, arguments.seed, (arguments.only,) if arguments.only else PROCESSES)
    for number, moment in enumerate(moments):
        with tempfile.TemporaryDirectory(prefix="iiwa-ident-kill-", ignore_cleanup_errors=True) as scratch:
            result, wrong = play(moment, number, Path(scratch))
            failed += bool(wrong)
            counts = f"{result.robot_answered} · {result.answered_samples} · {result.lost}"
            print(f"| {moment} | {result.arm} | {result.outcome}, {result.exit_code} | {counts} | {'; '.join(wrong)} |")
            with contextlib.suppress(BrokenPipeError):
                sys.stdout.flush()
    print(f"{len(moments)} moments, seed {arguments.seed}: {failed} not as they should be.")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
