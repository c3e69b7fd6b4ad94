"""Claims about counters that the robot cannot have reached: no loss, for loop, recorder and `recover` alike.

Truth: the scripted robot, which knows what it sent and what it left out. It is answered by the real loop, and the
real recorder writes what the loop hands over.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.control_messages import ControlMessage, RecorderFinished
from daemon.log.recover import recover_log
from daemon.run.recorder import Recorder
from fri_client.handover.ring import HandoverRing
from fri_client.loop.result import LoopResult
from tests.daemon.producer import make_job
from tests.daemon.recorder_results import read_states
from tests.fri_client.scripted_robot import ACTIVE, Client, Robot, running


def forge(robot: Robot, ahead: int, **changes: object) -> None:
    """A message whose counter leaps, and whose time does not; the robot itself knows nothing of it."""
    counter, time_ms = robot.counter, robot.time_ms
    robot.counter += ahead
    robot.send(ACTIVE, **changes)
    robot.counter, robot.time_ms = counter, time_ms


def ended(client: Client, robot: Robot, folder: Path) -> tuple[LoopResult, RecorderFinished]:
    """What loop and recorder say of the run, which goes on to its end."""
    robot.until_done(client)
    result = client.finish()
    client.ring.finish()
    said: list[ControlMessage] = []
    assert Recorder(make_job(folder), HandoverRing.attach(client.ring.fd), said.append).run() == 0
    end = said[-1]
    assert isinstance(end, RecorderFinished)
    return result, end


@pytest.mark.parametrize("ahead", [2, 63, 64, 65, 200, 998])
def test_a_forged_counter_is_refused_and_no_loss(tmp_path: Path, ahead: int) -> None:
    with running() as (client, robot):
        robot.to_active()
        for _ in range(5):
            robot.exchange(ACTIVE, 20)
            forge(robot, ahead)
        result, end = ended(client, robot, tmp_path)
        counts = client.loop.session.counts
        assert (counts.refused, counts.missing) == (5, 0)
    assert result.outcome == "completed", result.sentence
    assert end.sequence_gaps == 0
    assert recover_log(tmp_path / "recording.mcap").missing == 0
    assert [state.out_of_order for state in read_states(tmp_path / "recording.mcap")].count(True) == 5


def test_what_is_lost_beside_a_forged_counter_is_counted_by_all_alike(tmp_path: Path) -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 20)
        forge(robot, 300)
        robot.counter, robot.time_ms = robot.counter + 4, robot.time_ms + 4
        robot.exchange(ACTIVE, 20)
        forge(robot, 500, measured=(100.0,) * 7)
        _, end = ended(client, robot, tmp_path)
        counts = client.loop.session.counts
        assert (counts.refused, counts.missing) == (2, 4)
    assert end.sequence_gaps == 4


def test_a_leap_that_goes_on_is_a_restart_for_all_alike(tmp_path: Path) -> None:
    with running() as (client, robot):
        robot.to_active()
        robot.exchange(ACTIVE, 20)
        robot.counter += 400
        for _ in range(9):
            robot.send(ACTIVE)
        result, end = ended(client, robot, tmp_path)
        counts = client.loop.session.counts
        assert (counts.restarts, counts.missing, counts.refused) == (1, 0, 9)
    assert result.reason == "COUNTER_RESTART"
    assert end.sequence_gaps == 0
    assert recover_log(tmp_path / "recording.mcap").missing == 0
