"""Claims about the log as a file: every library opens it, each sample stands in it once, and nothing is overwritten."""

from __future__ import annotations

import itertools
import math
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_mcap
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from daemon.errors import LogIOError
from daemon.log import definitions
from daemon.log.stream import DiskReserve, PatientFile, is_being_written
from daemon.log.writer import Attachment, LogWriter
from fri_client.messages import (
    CommandData,
    CommandMessage,
    ConnectionInfo,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    TimeStamp,
)

from .log_readers import (
    LABELS,
    REPOSITORY,
    monitoring,
    rosbags_store,
)


def write_log(path: Path, samples: int) -> LogWriter:
    writer = LogWriter(
        path,
        metadata={"run_id": "r1", "period_s": "10.0", "robot": "iiwa14"},
        attachments=[Attachment("request.json", "application/json", b"{}")],
        robot_description="<robot name='x'/>",
    )
    for index in range(samples):
        command = CommandMessage(MessageHeader(0x34001, index, index), CommandData(joint_position=(0.1,) * 7))
        labels = LABELS._replace(
            receive_time_ns=1_700_000_000_000_000_000 + index * 500_000,
            send_time_ns=1_700_000_000_000_100_000 + index * 500_000,
            sample_index=index,
        )
        writer.write_sample(monitoring(index, (0.001 * index,) * 7, index * 1_000_000), command, labels)
        writer.flush_when_due()
    return writer


def test_a_log_opens_with_every_library_and_holds_each_sample_once(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    assert write_log(path, 300).finish({"outcome": "completed"}) == 300
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
        assert all("offered_qos_profiles" in channel.metadata for channel in summary.channels.values())
        assert {channel.topic for channel in summary.channels.values()} == {
            "/fri/state",
            "/fri/command",
            "/joint_states",
            "/run/events",
            "/diagnostics",
            "/robot_description",
        }
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        assert records["iiwa_ident"]["send_period_ms"] == "5"
        assert records["iiwa_ident"]["samples_per_period"] == "2000"
        assert records["iiwa_ident_end"]["samples"] == "300"
        assert [each.name for each in reader.iter_attachments()] == ["request.json"]
    with AnyReader([path]) as bag:
        counters = []
        efforts = []
        stamps = []
        velocities = []
        for connection, _, raw in bag.messages():
            if connection.topic == "/fri/state":
                counters.append(bag.deserialize(raw, connection.msgtype).sequence_counter)  # type: ignore[attr-defined]
            if connection.topic == "/joint_states":
                joints: Any = bag.deserialize(raw, connection.msgtype)
                efforts.append(joints.effort[0])
                stamps.append(joints.header.stamp.sec * 10**9 + joints.header.stamp.nanosec)
                velocities.append(joints.velocity[0])
    assert counters == list(range(300))
    # Vendor's measured torque is +1.0 on joint 1: the inverse-dynamics sign is −1.0.
    assert set(efforts) == {-1.0}
    # The robot's clock advances 1 ms per sample though the host saw one each 0.5 ms (simulated time).
    assert set(np.diff(stamps)) == {1_000_000}
    assert math.isnan(velocities[0])
    assert np.allclose(velocities[1:], 1.0)


def test_no_chunk_holds_more_than_the_time_we_may_lose_and_none_is_large(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that advances 1 ms per sample: the chunks' own first and last times tell how much one flush holds."""
    ticks = itertools.count()
    monkeypatch.setattr("daemon.log.writer.time.monotonic", lambda: next(ticks) * 0.001)
    path = tmp_path / "recording.mcap"
    write_log(path, 3000).finish({})
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) > 5
    assert all(index.uncompressed_size < 600_000 for index in summary.chunk_indexes)
    spans = [index.message_end_time - index.message_start_time for index in summary.chunk_indexes[1:]]
    # write_log's samples are 0.5 ms apart on the host's clock.
    assert max(spans) <= 0.25e9 / 2 + 1e6


def test_half_an_hour_of_chunks_costs_the_writer_less_than_two_megabytes(tmp_path: Path) -> None:
    """7200 flushes are 30 minutes at one each quarter of a second; counted by Python's own allocator."""
    writer = LogWriter(tmp_path / "recording.mcap", metadata={})
    tracemalloc.start()
    try:
        for index in range(7200):
            writer.write_sample(monitoring(index), None, LABELS)
            writer.flush()
            if index == 100:
                begin = tracemalloc.get_traced_memory()[0]
        grown = tracemalloc.get_traced_memory()[0] - begin
    finally:
        tracemalloc.stop()
    assert grown < 2_000_000
    assert writer.finish({}) == 7200
    with (tmp_path / "recording.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count == 7201


def test_a_reader_that_shares_no_code_with_the_writer_finds_every_message_through_the_index(tmp_path: Path) -> None:
    """small-mcap reads container, checksums, summary and message indexes by code of its own."""
    path = tmp_path / "recording.mcap"
    write_log(path, 700).finish({})
    with path.open("rb") as stream:
        summary = small_mcap.get_summary(stream)
        assert summary is not None
        assert small_mcap.get_header(stream).profile == "ros2"
        found: dict[str, list[int]] = {}
        for _, channel, message in small_mcap.read_message(stream, validate_crc=True):
            found.setdefault(channel.topic, []).append(message.sequence)
        middle = 1_700_000_000_000_000_000 + 350 * 500_000
        late = [
            message.sequence
            for _, channel, message in small_mcap.read_message(stream, start_time_ns=middle)
            if channel.topic == "/fri/state"
        ]
        assert {each.name for each in summary.metadata_indexes} == {"iiwa_ident", "iiwa_ident_end"}
        stream.seek(0)
        rebuilt = small_mcap.rebuild_summary(
            stream, validate_crc=True, calculate_channel_sizes=False, exact_sizes=False
        )
    assert found["/fri/state"] == found["/joint_states"] == found["/fri/command"] == list(range(700))
    assert late == list(range(350, 700))
    assert summary.statistics is not None
    assert rebuilt.summary.statistics.message_count == summary.statistics.message_count
    assert rebuilt.summary.chunk_indexes == summary.chunk_indexes


def test_a_robot_clock_gone_mad_does_not_break_the_log(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "a.mcap", metadata={})
    for seconds in (0, 2**32 - 1, 5, 2**31):
        message = MonitoringMessage(
            MessageHeader(0x245142, 1, 0),
            monitor_data=MonitorData(
                measured_joint_position=(0.0,) * 7,
                measured_torque=(0.0,) * 7,
                timestamp=TimeStamp(seconds, 2**32 - 1),
            ),
        )
        writer.write_sample(message, None, LABELS)
    assert writer.finish({}) == 4


def test_the_send_period_in_the_metadata_is_that_of_the_motion(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "a.mcap", metadata={"period_s": "2.0"})
    for counter, (period_ms, phase) in enumerate([(5, 0), (5, 0), (1, 0), (1, 1), (1, 3), (5, 6)]):
        message = MonitoringMessage(
            MessageHeader(0x245142, counter, 0), connection_info=ConnectionInfo(4, 3, period_ms)
        )
        writer.write_sample(message, None, LABELS._replace(motion_phase=phase))
    writer.finish({})
    with (tmp_path / "a.mcap").open("rb") as stream:
        noted = [each.metadata for each in make_reader(stream).iter_metadata() if each.name == "iiwa_ident"]
    assert [each["send_period_ms"] for each in noted] == ["5", "1"]
    assert noted[-1]["samples_per_period"] == "2000"


def test_a_refused_flush_leaves_a_whole_file_and_forgets_nothing(tmp_path: Path, monkeypatch: Any) -> None:
    import os

    path = tmp_path / "file"
    stream = PatientFile(path)
    stream.write(b"first")
    stream.flush()
    real, calls = os.pwrite, []

    def short_then_full(descriptor: int, data: bytes, offset: int) -> int:
        if not calls:
            calls.append(1)
            return real(descriptor, bytes(data)[:3], offset)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "pwrite", short_then_full)
    stream.write(b"second")
    with pytest.raises(LogIOError) as caught:
        stream.flush()
    assert caught.value.exit_code == 74
    assert path.read_bytes() == b"first"
    monkeypatch.setattr(os, "pwrite", real)
    stream.flush()
    assert path.read_bytes() == b"firstsecond"


def test_a_log_never_overwrites_another(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(LogIOError):
        LogWriter(path, metadata={})
    assert path.read_bytes() == b"precious"


def test_the_reserve_is_really_allocated_and_gone_with_its_process(tmp_path: Path) -> None:
    reserve = DiskReserve(tmp_path, ".reserve", 65536)
    assert reserve.bytes_held >= 65536
    assert list(tmp_path.iterdir()) == []
    assert reserve.give_back()
    assert not reserve.give_back()
    assert reserve.bytes_held == 0


def test_a_file_that_is_being_written_is_told_from_one_that_was_left(tmp_path: Path) -> None:
    stream = PatientFile(tmp_path / "a")
    assert is_being_written(tmp_path / "a")
    stream.close()
    assert not is_being_written(tmp_path / "a")
    assert not is_being_written(tmp_path / "no such file")


def test_the_page_on_the_log_names_every_field_and_its_example_runs(tmp_path: Path) -> None:
    page = (REPOSITORY / "docs" / "log.md").read_text(encoding="utf-8")
    for message in (definitions.FRI_STATE, definitions.FRI_COMMAND, definitions.RUN_EVENT):
        for field in rosbags_store(message).fielddefs[message][1]:
            assert f"`{field[0]}`" in page, (message, field[0])
    path = tmp_path / "recording.mcap"
    write_log(path, 20).finish({})
    code = page.split("```python\n")[1].split("```")[0]
    told = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert told.stdout.startswith("20 samples")
