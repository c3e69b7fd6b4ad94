"""A bad wire makes no wrong command: judged by the robot, which refuses jumps, limits and what is no number.

Where the robot's rules allow it the session is kept; where it is not, the arm rests and the operator reads why.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.end_to_end.fault_case import FaultCase
from tests.end_to_end.fault_check import REST_RAD_S
from tests.end_to_end.fault_runner import matches, run_case
from tests.end_to_end.wire_cases import TESTED, WIRE_CASES
from tests.end_to_end.wire_proxy import Direction

WHY = {
    "completed": "period was driven",
    "stopped": "The arm was stopped by ramp",
    "dropped": "Session dropped at cycle [0-9]+",
    "not_started": "let no motion begin within .*: ",
    "no_robot": "No FRI message",
}
STARTS = 3
"""The robot keeps its own clock here: on a busy machine it may see answers so late that it lets no motion begin."""


@pytest.mark.parametrize("case", [case for case in WIRE_CASES if case.name in TESTED], ids=lambda case: case.name)
def test_a_bad_wire_makes_no_wrong_command(case: FaultCase, tmp_path: Path) -> None:
    for attempt in range(STARTS):
        result = run_case(case, tmp_path / str(attempt))
        assert result.rejections == ()
        assert result.peaks[0] <= 1.0  # what the wire holds up arrives at once: differences of higher order are its own
        assert result.speed_at_end < REST_RAD_S
        assert result.outcome is not None
        assert matches(result.transcript, WHY[result.outcome]), result.transcript
        assert result.answered_samples >= result.robot_answered
        if result.outcome != "not_started":
            break
    if case.arm:
        assert (result.arm, result.outcome, result.exit_code) == (case.arm, case.outcome, 0), result.transcript


def test_the_tested_cells_exist() -> None:
    assert set(TESTED) <= {case.name for case in WIRE_CASES}


@pytest.mark.parametrize("share", [0.01, 0.05, 0.2])
def test_the_proxy_does_to_the_share_of_datagrams_what_it_is_told(share: float) -> None:
    sent = [number.to_bytes(4, "big") * 10 for number in range(20_000)]
    came = {}
    for trouble in ("loss", "delay", "duplicate", "reorder", "garbage"):
        direction = Direction(trouble, share, (1, 0), to_client=True)
        came[trouble] = []
        for number, datagram in enumerate(sent):
            direction.take(datagram, number * 0.005)
            came[trouble] += direction.due(number * 0.005)
        came[trouble] += direction.due(1e9)
    expected = pytest.approx(share * len(sent), rel=0.2)
    assert len(sent) - len(came["loss"]) == expected
    assert len(came["duplicate"]) - len(sent) == expected
    assert sum(spoiled != datagram for spoiled, datagram in zip(came["garbage"], sent, strict=True)) == expected
    assert came["delay"] == sent
    assert sorted(came["reorder"]) == sent[: len(came["reorder"])] != came["reorder"]
