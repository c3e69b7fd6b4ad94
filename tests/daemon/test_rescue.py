"""Claims about the rescue: what the ring holds when supervisor and recorder are gone ends in one whole file.

Truth: the indexes this test pushed, read back by rosbags. Whole runs with real kills stand in test_service.
"""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from daemon.api import RUN_NAME, LoopReport, RunOutcome
from daemon.errors import LogIOError
from daemon.json_files import read_json
from daemon.log.parts import state_of_recording
from daemon.log.stream import PatientFile, is_being_written
from daemon.run.account import leave_outcome
from daemon.run.folder import prepare_folder
from daemon.run.outcome import loop_report_without_loop
from daemon.run.recorder import Recorder
from daemon.run.rescue import rescue_if_abandoned
from daemon.run.spare_folder import find_run_file, spare_folder, write_run_file
from fri_client.handover.motion_phase import MotionPhase
from fri_client.handover.ring import HandoverRing
from tests.fri_client.scripted_robot import ACTIVE, running
from tests.watchdog import WATCHDOG_S

from .producer import Producer, make_job, make_request
from .recorder_results import read_states, start_process, wait_until


@pytest.fixture
def ring() -> Iterator[HandoverRing]:
    handover = HandoverRing.create(1024)
    yield handover
    handover.close()


@pytest.fixture(autouse=True)
def own_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


def leave_a_broken_part(folder: Path, ring: HandoverRing, samples: int) -> None:
    """As a recorder that was killed leaves it: some flushed and released, the file not closed."""
    recorder = Recorder(make_job(folder), HandoverRing.attach(ring.fd), [].append)
    for record in recorder._ring.read_batch(samples):
        recorder.take(record)
    recorder._keep_safe(final=True)
    recorder._writer._file.close()


def test_the_rest_of_the_ring_is_joined_with_what_the_recorder_left(tmp_path: Path, ring: HandoverRing) -> None:
    Producer(ring).push(300)
    leave_a_broken_part(tmp_path, ring, 120)
    assert state_of_recording(tmp_path) == "broken"
    ring.finish()
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    report = rescue_if_abandoned(make_request(tmp_path), ring)
    assert report is not None
    assert handlers == [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    assert [state.sample_index for state in read_states(tmp_path / "recording.mcap")] == list(range(300))
    assert state_of_recording(tmp_path) == "whole"


def test_without_any_recording_the_ring_becomes_one(tmp_path: Path, ring: HandoverRing) -> None:
    Producer(ring).push(40)
    ring.finish()
    rescue_if_abandoned(make_request(tmp_path), ring)
    assert len(read_states(tmp_path / "recording.mcap")) == 40


def test_a_living_recorder_is_waited_for_and_an_empty_ring_needs_nothing(
    tmp_path: Path, ring: HandoverRing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It closes its file when it has been looked at three times."""
    ring.finish()
    alive = PatientFile(tmp_path / "recording.mcap")
    looks: list[bool] = []

    def look(path: Path) -> bool:
        looks.append(is_being_written(path))
        if len(looks) == 3:
            alive.close()
        return looks[-1]

    monkeypatch.setattr("daemon.run.rescue.is_being_written", look)
    assert rescue_if_abandoned(make_request(tmp_path), ring) is None
    assert looks == [True, True, True, False]
    assert not list(tmp_path.glob("recording.part*"))


def test_a_folder_that_is_gone_sends_the_rest_to_the_spare_one(
    tmp_path: Path, own_temporary_folder: Path, ring: HandoverRing
) -> None:
    Producer(ring).push(40)
    ring.finish()
    request = make_request(tmp_path, out_dir=str(tmp_path / "gone"))
    rescue_if_abandoned(request, ring)
    (found,) = own_temporary_folder.rglob("recording*.mcap")
    assert found.parent == spare_folder(request)
    assert len(read_states(found)) == 40
    assert found.parent.stat().st_mode & 0o077 == 0


def test_small_files_go_to_the_spare_folder_and_are_found_there(tmp_path: Path) -> None:
    request = make_request(tmp_path, out_dir=str(tmp_path / "gone"))
    file = write_run_file(request, "loop_report.json", {"a": 1})
    assert find_run_file(request, "loop_report.json") == file
    assert file.read_bytes() == b'{"a":1}'


def test_what_an_earlier_run_of_the_same_name_left_there_is_kept_and_not_taken_for_this_runs(
    tmp_path: Path, own_temporary_folder: Path
) -> None:
    for _ in range(2):
        request = prepare_folder(make_request(tmp_path / "in", out_dir=str(tmp_path / "run")))
        assert find_run_file(request, RUN_NAME) == tmp_path / "run" / RUN_NAME
        shutil.rmtree(tmp_path / "run")  # as an operator clears a disk that was full
        write_run_file(request, RUN_NAME, {"run": 1})
    assert len(list(own_temporary_folder.rglob(RUN_NAME))) == 2


def test_a_spare_folder_that_others_may_write_is_not_trusted(tmp_path: Path) -> None:
    request = make_request(tmp_path)
    os.chmod(spare_folder(request), 0o777)
    with pytest.raises(LogIOError):
        spare_folder(request)


def test_a_run_without_supervisor_has_an_account_that_says_who_wrote_it(tmp_path: Path, ring: HandoverRing) -> None:
    Producer(ring).push(40)
    ring.finish()
    request = make_request(tmp_path)
    rescue_if_abandoned(request, ring)
    report = LoopReport(outcome="stopped", reason="SUPERVISOR_LOST", sentence="The supervising process was lost.")
    (tmp_path / "recorder0.json").write_text("{}")
    (tmp_path / "recorder.log").touch()
    (tmp_path / "loop.log").write_text("It said something.")
    leave_outcome(request, report, 1, writer="the loop's process", ring=ring)
    outcome = read_json(tmp_path / "run.json", RunOutcome)
    assert (outcome.outcome, outcome.exit_code, outcome.samples) == ("stopped", 1, 40)
    assert outcome.judgement["commands"] == 40
    assert outcome.loop is not None
    assert (outcome.loop.reason, outcome.loop.sentence) == (report.reason, report.sentence)
    assert outcome.loop.peak_command_position == pytest.approx(outcome.judgement["peaks"]["position_rad"])
    assert any("written by the loop's process" in sentence for sentence in outcome.sentences)
    # The producer's commands jump, and the account says so.
    assert "Commands went beyond a limit at the robot" in outcome.sentences[-1]
    assert "recording.mcap" in {file.name for file in outcome.files}
    written = (tmp_path / "run.json").read_bytes()
    leave_outcome(request, report, 70, writer="the loop's process", ring=ring)
    assert (tmp_path / "run.json").read_bytes() == written
    assert not (tmp_path / "recorder0.json").exists()
    assert [file.name for file in tmp_path.glob("*.log")] == ["loop.log"]


def test_what_stands_in_no_file_is_counted_as_lost(tmp_path: Path, ring: HandoverRing) -> None:
    """120 of 300 are in the file; the rest is in the ring alone, which is about to go."""
    Producer(ring).push(300)
    leave_a_broken_part(tmp_path, ring, 120)
    report = LoopReport(outcome="stopped", reason="SUPERVISOR_LOST", sentence="The supervising process was lost.")
    leave_outcome(make_request(tmp_path), report, 1, writer="the loop's process", ring=ring)
    outcome = read_json(tmp_path / "run.json", RunOutcome)
    assert (outcome.samples, outcome.handover_gaps) == (120, 180)
    assert "180 lost between loop and file" in " ".join(outcome.sentences)


def test_a_recorder_that_is_stopped_for_ever_is_ended_and_its_samples_are_written(
    tmp_path: Path, ring: HandoverRing, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.run.rescue.RECORDER_PATIENCE_S", 0.2)
    producer = Producer(ring)
    recorder = start_process(make_job(tmp_path), ring)
    try:
        producer.push(100)
        wait_until(lambda: ring.backlog == 0)
        recorder.send_signal(signal.SIGSTOP)
        producer.push(200)
        ring.finish()
        assert rescue_if_abandoned(make_request(tmp_path), ring) is not None
        recorder.wait(WATCHDOG_S)  # it is gone; raises where it is not
    finally:
        recorder.kill()
        recorder.wait()
    assert [state.sample_index for state in read_states(tmp_path / "recording.mcap")] == list(range(300))


def test_a_loop_killed_after_its_periods_has_driven_them(tmp_path: Path) -> None:
    with running() as (client, robot):
        robot.to_active()
        while client.ring.status.phase < MotionPhase.STOP_RAMP:
            robot.exchange(ACTIVE)
        report = loop_report_without_loop(make_request(tmp_path), client.ring, -9, "")
        watched = loop_report_without_loop(make_request(tmp_path, monitor_only=True), client.ring, -9, "")
        robot.until_done(client)
    assert report.outcome == "fault"
    assert report.periods_completed == 2
    assert "brakes by itself" in report.sentence
    # What only recorded has no motion of its own that could come to rest.
    assert watched.sentence == "The loop process was killed by signal 9; no motion was commanded."
