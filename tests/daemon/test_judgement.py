"""Claims about a run whose recording the judge has seen. Truth: logs of straight lines, far below and above a limit."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from daemon.api import RunOutcome
from daemon.run.judgement import judged
from tests.daemon.producer import make_request
from tests.fixtures.judged_log import line, write_log


def outcome_of(recording: Path, exit_code: int) -> RunOutcome:
    return RunOutcome(
        run_id="one", outcome="completed", exit_code=exit_code, sentences=("All periods were driven.",),
        out_dir=str(recording.parent), recordings=(str(recording),), samples=400,
    )  # fmt: skip


# A2 of the iiwa 14 may turn at 1.48 rad/s; 0.2 is far below, 1.6 beyond.
@pytest.mark.parametrize(
    ("speed", "before", "after", "said"), [(0.2, 0, 0, 0), (1.6, 0, 1, 1), (1.6, 130, 130, 1), (1.6, 69, 69, 1)]
)
def test_a_command_beyond_a_limit_is_no_good_end_of_a_run(
    tmp_path: Path, speed: float, before: int, after: int, said: int
) -> None:
    told = judged(outcome_of(write_log(tmp_path / "recording.mcap", line(400, speed)), before))
    assert told.judgement["passed"] is (not said)
    assert told.exit_code == after
    assert len(told.sentences) == 1 + said


@pytest.mark.parametrize(("simulation", "exit_code"), [(False, 1), (True, 0)])
def test_the_exit_code_is_that_of_a_real_arm(tmp_path: Path, simulation: bool, exit_code: int) -> None:
    """A fake robot on a busy machine stands still now and then, which the log does not tell; its own judge does."""
    outcome = outcome_of(write_log(tmp_path / "recording.mcap", line(400, 1.6)), 0)
    asked = msgspec.structs.replace(outcome, request=make_request(tmp_path / "run", simulation=simulation))
    told = judged(asked)
    assert told.exit_code == exit_code
    assert "Commands went beyond a limit" in told.sentences[-1]


def test_a_recording_that_cannot_be_judged_is_said_and_changes_no_exit_code(tmp_path: Path) -> None:
    broken = tmp_path / "recording.mcap"
    broken.write_bytes(b"no log")
    told = judged(outcome_of(broken, 0))
    assert told.exit_code == 0
    assert "could not be judged" in told.sentences[-1]


def test_what_could_not_be_judged_for_want_of_records_is_said(tmp_path: Path) -> None:
    messages = line(400)
    for each in messages[:200]:
        each.recorded = False
    told = judged(outcome_of(write_log(tmp_path / "recording.mcap", messages), 0))
    assert (told.judgement["passed"], told.judgement["holes"], told.exit_code) == (True, 1, 0)
    assert told.sentences[-1] == "Records are missing in 1 place: the commands there could not be judged."
