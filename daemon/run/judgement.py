"""What the judge says of a finished recording; a process of its own, which shares no code with what it judges.

Called once the arm is at rest and the file is closed, by whoever writes run.json: first without it, so that nothing
that happens meanwhile costs the account, then with it.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec

from daemon.api import RunOutcome
from daemon.children import child_environment
from daemon.words import counted

_ALLOWANCE_S = 600.0
"""A run of an hour takes two minutes."""
_JUDGED = (0, 1)
_CLEARLY_BEYOND = 101.0
"""Percent; above the judge's largest tolerance."""


def judge_recording(recording: Path) -> dict[str, Any]:
    """The judgement as `iiwa-ident judge --json` writes it; `{"error": sentence}` where there is none."""
    command = [sys.executable, "-m", "fixtures.judge", str(recording), "--json", "-"]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=_ALLOWANCE_S, env=child_environment(),
            stdin=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        if done.returncode in _JUDGED:
            told: dict[str, Any] = json.loads(done.stdout)
            return told
        words = done.stderr.strip().splitlines() or [f"it ended with exit code {done.returncode}"]
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        words = [str(error)]
    return {"error": f"The recording could not be judged: {words[-1]}"}


def judged(outcome: RunOutcome) -> RunOutcome:
    """The account of a run with the judgement of its recording: peaks of what went out, as the robot had it in its own
    cycles; where a command was beyond a limit a sentence, and on a real arm exit code 1 in place of 0. Unchanged where
    no sample was recorded.
    """
    if not outcome.samples or not outcome.recordings:
        return outcome
    judgement = judge_recording(Path(outcome.recordings[0]))
    loop, peaks = outcome.loop, judgement.get("peaks")
    if loop is not None and peaks:
        loop = msgspec.structs.replace(
            loop,
            peak_command_position=tuple(peaks["position_rad"]),
            peak_command_velocity=tuple(peaks["velocity_rad_s"]),
            peak_command_acceleration=tuple(peaks["acceleration_rad_s2"]),
            peak_command_jerk=tuple(peaks["jerk_rad_s3"]),
        )
    sentences = (*outcome.sentences, *judgement_remarks(judgement))
    # A fake robot that is held up has a clock of its own: when a command reached it cannot be told from the log.
    is_real = outcome.request is None or not outcome.request.simulation
    exit_code = outcome.exit_code or int(is_real and judgement.get("passed") is False)
    return msgspec.structs.replace(outcome, loop=loop, judgement=judgement, sentences=sentences, exit_code=exit_code)


def judgement_remarks(judgement: dict[str, Any]) -> tuple[str, ...]:
    """What the operator has to know of it: nothing where every command is known and was inside the limits."""
    if "error" in judgement:
        return (judgement["error"],)
    holes = judgement.get("holes", 0)
    unjudged = (
        [f"Records are missing in {counted(holes, 'place')}: the commands there could not be judged."] if holes else []
    )
    if judgement.get("passed", True):
        return tuple(unjudged)
    # The lowest derivative says most: a jump of the velocity is one of acceleration and jerk too, by ever more percent.
    beyond = [each for each in judgement["worst"].values() if float(each["percent"]) > _CLEARLY_BEYOND]
    worst = (beyond or judgement["excesses"])[0]
    return (
        *unjudged,
        f"Commands went beyond a limit at the robot, {counted(judgement['excess_count'], 'time')}, first at "
        f"{judgement['excesses'][0]['time_s']:.3f} s; {worst['quantity']} of joint {worst['joint']} at "
        f"{float(worst['percent']):.0f} % of its limit, at {worst['time_s']:.3f} s. "
        f"`iiwa-ident judge {shlex.quote(judgement['file'])}` lists them.",
    )
