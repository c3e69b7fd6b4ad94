"""Claims about the recorder: what was pushed into the ring stands in the file, with all that belongs to it.

Truth: the counters and values this test pushed, read back by rosbags and by the mcap library's own reader.
"""

from __future__ import annotations

import importlib.metadata
import itertools
import json
import os
import platform
import signal
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from daemon.api import LoopReport, RunOutcome
from daemon.control_messages import ControlMessage, RecorderFinished, RecorderProgress, RecorderReady
from daemon.errors import LogIOError
from daemon.json_files import read_json, write_json
from daemon.log.stream import PatientFile
from daemon.run.recorder import Recorder, main
from daemon.run.supervision import Supervision
from fri_client.handover.ring import EventCode, HandoverRing

from .producer import Producer, make_job
from .recorder_results import read_events, read_states, record_all


def test_every_pushed_sample_stands_in_the_file_with_its_labels(tmp_path: Path, ring: HandoverRing) -> None:
    producer = Producer(ring)
    assert producer.push(250) == 250
    said = record_all(tmp_path, ring)
    states = read_states(tmp_path / "recording.mcap")
    assert [state.sequence_counter for state in states] == list(range(100, 350))
    assert [state.sample_index for state in states] == list(range(250))
    assert [state.period for state in states] == [index // 100 for index in range(250)]
    assert [state.sample_in_period for state in states] == [index % 100 for index in range(250)]
    assert all(state.host_receive_time_ns > 1_500_000_000_000_000_000 for state in states)
    assert all(state.host_send_time_ns - state.host_receive_time_ns == 50_000 for state in states)
    assert isinstance(said[0], RecorderReady)
    end = said[-1]
    assert isinstance(end, RecorderFinished)
    assert (end.samples, end.sequence_gaps, end.handover_gaps) == (250, 0, 0)
    assert (end.last_index, end.samples_in_periods) == (249, 250)
    assert ring.backlog == 0


def test_a_hole_in_the_robots_counter_and_one_in_the_ring_are_told_apart(tmp_path: Path) -> None:
    ring = HandoverRing.create(64)
    producer = Producer(ring)
    producer.push(10)
    producer.push(10, skip=5)
    assert producer.push(60) == 44
    consumer = HandoverRing.attach(ring.fd)
    said: list[ControlMessage] = []
    recorder = Recorder(make_job(tmp_path), consumer, said.append)
    for record in consumer.read_batch():
        recorder.take(record)
    consumer.release()
    producer.push(3)
    ring.finish()
    recorder.run()
    end = said[-1]
    assert isinstance(end, RecorderFinished)
    assert end.handover_gaps == 16
    # What found the ring full is missing in the robot's counter too: 5 on the wire, 16 in the hand-over.
    assert end.sequence_gaps == 5 + 16
    assert end.samples == 10 + 10 + 44 + 3
    ring.close()


@pytest.mark.parametrize("jump", [100_000, -60])
def test_a_counter_that_begins_anew_is_a_restart_for_recorder_and_loop_alike(tmp_path: Path, jump: int) -> None:
    ring = HandoverRing.create(64)
    producer = Producer(ring)
    producer.push(20)
    producer.push(20, skip=jump)
    producer.push(5, skip=3)
    ring.finish()
    said: list[ControlMessage] = []
    Recorder(make_job(tmp_path), HandoverRing.attach(ring.fd), said.append).run()
    end = said[-1]
    assert isinstance(end, RecorderFinished)
    assert (end.sequence_gaps, end.samples) == (3, 45)
    ring.close()


def test_duplicates_garbage_and_events_are_kept_and_flagged(tmp_path: Path, ring: HandoverRing) -> None:
    producer = Producer(ring)
    producer.push(5)
    producer.push(1, disposition=1)
    producer.push(1, disposition=2)
    producer.push_garbage(b"\xde\xad\xbe\xef")
    producer.push_event(EventCode.STATE_CHANGE, 2, 3)
    ring.publish_reason("Joint 4 is commanded to 2.1 rad, its limit is 2.09 rad.")
    producer.push(1, event=int(EventCode.GUARD))
    said = record_all(tmp_path, ring)
    states = read_states(tmp_path / "recording.mcap")
    assert [state.duplicate for state in states] == [False] * 5 + [True, False, False]
    assert [state.out_of_order for state in states] == [False] * 6 + [True, False]
    events = {event.name: event for event in read_events(tmp_path / "recording.mcap")}
    assert "deadbeef" in events["UNDECODABLE"].sentence
    assert events["STATE_CHANGE"].sentence == "The session went from MONITORING_READY to COMMANDING_WAIT."
    assert events["GUARD"].sentence.startswith("Joint 4")
    end = said[-1]
    assert isinstance(end, RecorderFinished)
    with (tmp_path / "recording.mcap").open("rb") as stream:
        told = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}["iiwa_ident_end"]
    assert (told["undecodable"], end.sequence_gaps) == ("1", 0)


def test_the_sentence_of_a_stop_is_given_to_the_stop_alone(tmp_path: Path, ring: HandoverRing) -> None:
    stop = "The operator asked for a stop."
    ring.publish_reason(stop)
    producer = Producer(ring)
    for code in EventCode:
        if code != EventCode.NONE:
            producer.push_event(code, 1, 1)
    record_all(tmp_path, ring)
    told = {event.name for event in read_events(tmp_path / "recording.mcap") if event.sentence == stop}
    assert told == {code.name for code in EventCode if code.is_stop_reason} | {"SESSION_DROP"}


def test_the_file_carries_request_table_trajectory_and_host(tmp_path: Path, ring: HandoverRing) -> None:
    urdf = tmp_path / "robot.urdf"
    urdf.write_text("<robot name='iiwa'/>")
    Producer(ring).push(1)
    record_all(tmp_path, ring, urdf_file=str(urdf), seed=7, tool="gripper 1.2 kg")
    with (tmp_path / "recording.mcap").open("rb") as stream:
        reader = make_reader(stream)
        attachments = {each.name: each.data for each in reader.iter_attachments()}
        metadata = {each.name: each.metadata for each in reader.iter_metadata()}["iiwa_ident"]
        topics = {channel.topic for _, channel, _ in reader.iter_messages()}
    assert attachments.keys() == {"request.json", "host_report.json", "trajectory.json", "table.npy", "robot.urdf"}
    assert json.loads(attachments["request.json"])["seed"] == 7
    host = json.loads(attachments["host_report.json"])
    assert host["kernel_version"] == platform.version()
    assert {"realtime_kernel", "governors", "rtprio_limit", "memlock_limit", "software"} <= host.keys()
    truth = {
        "run_id": "test-run",
        "robot": "iiwa14",
        "fri_version": "1.15",
        "send_period_ms": "1",
        "period_s": "0.1",
        "periods": "2",
        "samples_per_period": "100",
        "tool": "gripper 1.2 kg",
        "seed": "7",
    }
    assert {key: metadata[key] for key in truth} == truth
    assert metadata["software_version"] == importlib.metadata.version("iiwa-ident")
    assert "inverse dynamics" in metadata["torque_sign_convention"]
    assert metadata["schema_version"] == "1"
    assert "/robot_description" in topics


def test_what_the_loop_leaves_in_the_folder_travels_in_the_log(tmp_path: Path, ring: HandoverRing) -> None:
    (tmp_path / "loop_report.json").write_text('{"realtime": {"scheduler": "refused"}}')
    (tmp_path / "last_samples.csv").write_text("tick,q1\n1,0.1\n")
    (tmp_path / "other.csv").write_text("not ours")
    Producer(ring).push(1)
    record_all(tmp_path, ring)
    with (tmp_path / "recording.mcap").open("rb") as stream:
        found = {each.name: (each.media_type, each.data) for each in make_reader(stream).iter_attachments()}
    assert found["last_samples.csv"] == ("text/csv", b"tick,q1\n1,0.1\n")
    assert json.loads(found["loop_report.json"][1]) == {"realtime": {"scheduler": "refused"}}
    assert "other.csv" not in found


def test_diagnostics_come_about_once_a_second_and_say_whether_anything_was_lost(
    tmp_path: Path, ring: HandoverRing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recorder whose clock advances 10 ms at every look, for 10 s of it."""
    now = itertools.count()
    recorder = Recorder(make_job(tmp_path), HandoverRing.attach(ring.fd), [].append)
    begin = time.monotonic()
    monkeypatch.setattr("daemon.run.recorder.time.monotonic", lambda: begin + next(now) * 0.01)
    producer = Producer(ring)
    for _ in range(1000):
        producer.push(1)
        recorder.take(recorder._ring.read_batch(1)[0])
        recorder._tell()
    ring.finish()
    monkeypatch.undo()
    assert recorder.run() == 0
    with AnyReader([tmp_path / "recording.mcap"]) as bag:
        wanted = [each for each in bag.connections if each.topic == "/diagnostics"]
        found: list[Any] = [bag.deserialize(raw, each.msgtype) for each, _, raw in bag.messages(wanted)]
    assert 8 <= len(found) <= 12
    assert [status.message for status in found[0].status if status.name == "recorder"] == ["nothing lost"]


def test_a_folder_that_cannot_be_written_is_said_before_anything_moves(tmp_path: Path, ring: HandoverRing) -> None:
    job = make_job(tmp_path)
    absent = msgspec.structs.replace(job, path=str(tmp_path / "no such folder" / "recording.mcap"))
    with pytest.raises(LogIOError) as caught:
        Recorder(absent, ring, [].append)
    assert caught.value.exit_code == 74
    (tmp_path / "recording.mcap").write_bytes(b"precious")
    with pytest.raises(LogIOError):
        Recorder(job, ring, [].append)
    assert [each.name for each in tmp_path.iterdir() if each.name.startswith(".")] == []


def test_progress_tells_what_is_in_the_file(tmp_path: Path, ring: HandoverRing) -> None:
    Producer(ring).push(40)
    said = record_all(tmp_path, ring)
    progress = [each for each in said if isinstance(each, RecorderProgress)]
    assert progress
    assert progress[-1].samples == 40


def test_a_patient_file_is_not_created_over_another(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x")
    with pytest.raises(LogIOError):
        PatientFile(tmp_path / "a")


@pytest.mark.parametrize("watched", [False, True])
def test_a_recorder_that_is_left_alone_writes_the_account_of_the_run(
    tmp_path: Path, ring: HandoverRing, monkeypatch: pytest.MonkeyPatch, watched: bool
) -> None:
    """Loop and supervisor were killed together, before the recorder was there: the ring was never finished."""
    monkeypatch.setattr("daemon.run.recorder.ORPHAN_PATIENCE_S", 0.1)
    with subprocess.Popen([sys.executable, "-c", ""]) as supervisor:
        pass
    Producer(ring).push(250)
    write_json(tmp_path / "recorder0.json", make_job(tmp_path, monitor_only=watched))
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM)}
    try:
        options = ["--ring-fd", str(ring.fd), "--supervisor", str(supervisor.pid)]
        assert main(["--request", str(tmp_path / "recorder0.json"), *options]) == 0
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    outcome = read_json(tmp_path / "run.json", RunOutcome)
    assert (outcome.outcome, outcome.exit_code, outcome.samples, outcome.handover_gaps) == ("fault", 70, 250, 0)
    assert ("brakes by itself" in outcome.sentences[0]) == (not watched)
    assert ("no motion was commanded" in outcome.sentences[0]) == watched
    assert any("written by the recorder" in sentence for sentence in outcome.sentences)
    assert not (tmp_path / "recorder0.json").exists()


def test_a_supervisor_killed_between_the_motion_and_its_account_leaves_that_to_the_recorder(
    tmp_path: Path, ring: HandoverRing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop ended well, reported and left; the supervisor lived until the recording was closed, and is killed then.

    Truth: the 250 samples of this test, the report that it wrote for the loop.
    """
    Producer(ring).push(250)
    write_json(tmp_path / "recorder0.json", make_job(tmp_path))
    report = LoopReport(outcome="completed", reason="", sentence="Two periods were driven.", received=250)
    write_json(tmp_path / "loop_report.json", report)
    ring.finish()
    looked: list[bool] = []

    def killed_meanwhile(_: float) -> None:
        looked.append((tmp_path / "run.json").exists())
        monkeypatch.setattr(os, "getppid", lambda: 1)

    monkeypatch.setattr("daemon.run.recorder.time.sleep", killed_meanwhile)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM)}
    try:
        options = ["--ring-fd", str(ring.fd), "--endpoint", f"ipc://{tmp_path}/nobody"]
        assert main(["--request", str(tmp_path / "recorder0.json"), *options]) == 0
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert not looked[0]  # as long as the supervisor lives it is to write the account itself
    outcome = read_json(tmp_path / "run.json", RunOutcome)
    assert (outcome.outcome, outcome.samples, outcome.handover_gaps) == ("completed", 250, 0)
    assert outcome.sentences[0] == report.sentence
    assert any("written by the recorder" in sentence for sentence in outcome.sentences)


def test_a_recorder_waits_for_a_loop_that_was_still_being_started_when_the_supervisor_was_killed(
    tmp_path: Path, ring: HandoverRing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such a loop answers the robot until it misses the supervisor: what it hears is no "nothing came"."""
    with subprocess.Popen([sys.executable, "-c", ""]) as supervisor:
        pass
    recorder = Recorder(make_job(tmp_path), ring, [].append, supervision=Supervision(ring, supervisor.pid))
    assert ring.status.time_ns == 0  # the loop has not said a word
    assert not recorder.is_abandoned
    monkeypatch.setattr("daemon.run.recorder.ORPHAN_PATIENCE_S", 0.0)
    assert recorder.is_abandoned
    assert recorder.run() == 0


def test_the_metadata_name_arm_date_and_load(tmp_path: Path, ring: HandoverRing) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text("tool: {name: gripper, mass_kg: 2.5, center_of_mass_m: [0, 0, 0.06]}\n")
    Producer(ring).push(5)
    record_all(tmp_path, ring, serial="K-77", tool="gripper", workspace_file=str(cell))
    with (tmp_path / "recording.mcap").open("rb") as stream:
        told = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}["iiwa_ident"]
    assert (told["serial"], told["tool"], told["tool_mass_kg"]) == ("K-77", "gripper", "2.5")
    assert told["tool_center_of_mass_m"] == "0.0, 0.0, 0.06"
    assert datetime.fromisoformat(told["date"]).tzinfo is not None
