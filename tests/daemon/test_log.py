"""Claims about the log: what two readers that share no code with the packer make of its bytes.

Truth comes from the vendor's golden datagrams (`fields` in vectors.json), decoded here by rosbags and by mcap_ros2.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import small_mcap
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from daemon.errors import LogIOError
from daemon.log import definitions
from daemon.log.cdr import (
    DiagnosticStatus,
    SampleLabels,
    pack_diagnostics,
    pack_event,
    pack_fri_command,
    pack_fri_state,
    pack_joint_state,
    pack_string,
    state_counters,
)
from daemon.log.stream import DiskReserve, PatientFile, is_being_written
from daemon.log.writer import Attachment, LogWriter
from fri_client.errors import FriError
from fri_client.messages import (
    CommandData,
    CommandMessage,
    ConnectionInfo,
    FriVersion,
    IoValue,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    QuaternionTransformation,
    TimeStamp,
    Transformation,
)
from fri_client.wire.codec import Codec

REPOSITORY = Path(__file__).resolve().parents[2]
LABELS = SampleLabels(1_700_000_000_123_456_789, 1_700_000_000_123_556_789, 42, 3, 5, 777, True, False, False, False)
MESSAGES = (
    definitions.FRI_STATE,
    definitions.FRI_COMMAND,
    definitions.RUN_EVENT,
    definitions.DIAGNOSTIC_ARRAY,
    definitions.JOINT_STATE,
    definitions.STRING,
)


@functools.cache
def rosbags_store(message: str) -> Any:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definitions.schema_text(message), message))
    return store


def rosbags_decode(data: bytes, message: str) -> Any:
    return rosbags_store(message).deserialize_cdr(data, message)


@functools.cache
def mcap_ros2_decoder(message: str) -> Any:
    schema = Schema(id=1, name=message, encoding="ros2msg", data=definitions.schema_text(message).encode())
    return DecoderFactory().decoder_for("cdr", schema)


def mcap_ros2_decode(data: bytes, message: str) -> Any:
    return mcap_ros2_decoder(message)(data)


READERS = pytest.mark.parametrize("decode", [rosbags_decode, mcap_ros2_decode], ids=["rosbags", "mcap_ros2"])


def monitoring(counter: int = 1, position: tuple[float, ...] = (0.1,) * 7, nanoseconds: int = 0) -> MonitoringMessage:
    return MonitoringMessage(
        header=MessageHeader(0x245142, counter, max(counter - 1, 0)),
        monitor_data=MonitorData(
            measured_joint_position=position,
            measured_torque=(1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0),
            timestamp=TimeStamp(1_600_000_000 + nanoseconds // 10**9, nanoseconds % 10**9),
        ),
        connection_info=ConnectionInfo(4, 3, 5, 1),
    )


def golden(shared_folder: Path) -> list[tuple[str, str, str, dict[str, Any]]]:
    versions = json.loads((shared_folder / "fri" / "vectors.json").read_text())["versions"]
    return [
        (version, direction, vector["hex"], vector["fields"])
        for version, groups in versions.items()
        for direction in ("monitoring", "command")
        for vector in groups[direction]
    ]


def number(value: Any) -> float:
    return float(value)


def same(values: Any, expected: list[Any]) -> bool:
    return bool(
        np.array_equal(np.asarray(values)[: len(expected)], [number(each) for each in expected], equal_nan=True)
    )


@READERS
def test_every_golden_monitoring_message_reads_back_from_the_log_with_the_vendors_values(
    decode: Any, shared_folder: Path
) -> None:
    seen = 0
    for version, direction, text, fields in golden(shared_folder):
        if direction != "monitoring":
            continue
        message = Codec(FriVersion.parse(version)).decode_monitoring(bytes.fromhex(text))
        state = decode(pack_fri_state(message, LABELS), definitions.FRI_STATE)
        seen += 1
        assert state.sequence_counter == fields["header"]["sequenceCounter"]
        assert state.reflected_sequence_counter == fields["header"]["reflectedSequenceCounter"]
        assert state.message_identifier == fields["header"]["messageIdentifier"]
        monitor, ipo = fields.get("monitorData", {}), fields.get("ipoData", {})
        for name, group, key in (
            ("measured_joint_position", monitor, "measuredJointPosition"),
            ("measured_torque", monitor, "measuredTorque"),
            ("commanded_joint_position", monitor, "commandedJointPosition"),
            ("commanded_torque", monitor, "commandedTorque"),
            ("external_torque", monitor, "externalTorque"),
            ("ipo_joint_position", ipo, "jointPosition"),
        ):
            assert getattr(state, f"{name}_valid") == (key in group), name
            assert same(getattr(state, name), group[key]["value"] if key in group else [math.nan] * 7), name
        assert state.external_force_valid == ("externalForce" in monitor)
        assert same(state.external_force, monitor.get("externalForce", {}).get("element", []))
        assert state.tracking_performance_valid == ("trackingPerformance" in ipo)
        assert same([state.tracking_performance], [ipo.get("trackingPerformance", math.nan)])
        assert state.client_command_mode == ipo.get("clientCommandMode", -1)
        assert state.overlay_type == ipo.get("overlayType", -1)
        connection, robot = fields.get("connectionInfo", {}), fields.get("robotInfo", {})
        assert state.session_state == connection.get("sessionState", -1)
        assert state.connection_quality == connection.get("quality", -1)
        assert state.send_period_ms == connection.get("sendPeriod", 0)
        assert state.receive_multiplier == connection.get("receiveMultiplier", 0)
        assert state.safety_state == robot.get("safetyState", -1)
        assert state.operation_mode == robot.get("operationMode", -1)
        assert state.control_mode == robot.get("controlMode", -1)
        assert state.number_of_joints == robot.get("numberOfJoints", -1)
        assert list(state.drive_state)[: len(robot.get("driveState", []))] == robot.get("driveState", [])
        stamp = monitor.get("timestamp", {"sec": 0, "nanosec": 0})
        assert (state.robot_time_sec, state.robot_time_nanosec) == (stamp["sec"], stamp["nanosec"])
        ios = monitor.get("readIORequest", [])
        assert [io.name for io in state.io_values] == [io["name"] for io in ios]
        assert [io.digital_value for io in state.io_values] == [io.get("digitalValue", 0) for io in ios]
        assert same([io.analog_value for io in state.io_values], [io.get("analogValue", math.nan) for io in ios])
        asked = fields.get("requestedTransformations", [])
        assert [each.name for each in state.requested_transformations] == [each["name"] for each in asked]
        for each, truth in zip(state.requested_transformations, asked, strict=True):
            elements = truth.get("matrix", truth.get("element", []))
            assert each.number_of_elements == len(elements)
            assert same(each.elements, elements)
        poses = [
            group[key] for group, key in ((monitor, "measuredCartesianPose"), (ipo, "cartesianPose")) if key in group
        ]
        assert [each.name for each in state.cartesian_poses] == [each["name"] for each in poses]
        assert (state.motion_phase, state.period, state.sample_in_period, state.sample_index) == (3, 5, 777, 42)
        assert state.answered
        assert not state.duplicate
    assert seen > 40


@READERS
def test_every_golden_command_reads_back_from_the_log_with_the_vendors_values(decode: Any, shared_folder: Path) -> None:
    seen = 0
    for version, direction, text, fields in golden(shared_folder):
        if direction != "command":
            continue
        seen += 1
        message = Codec(FriVersion.parse(version)).decode_command(bytes.fromhex(text))
        command = decode(pack_fri_command(message, LABELS), definitions.FRI_COMMAND)
        data = fields.get("commandData", {})
        assert command.sequence_counter == fields["header"]["sequenceCounter"]
        for name, key in (("joint_position", "jointPosition"), ("joint_torque", "jointTorque")):
            assert getattr(command, f"{name}_valid") == (key in data)
            assert same(getattr(command, name), data[key]["value"] if key in data else [math.nan] * 7)
        assert same(
            command.cartesian_wrench_feed_forward, data.get("cartesianWrenchFeedForward", {}).get("element", [])
        )
        assert [io.name for io in command.write_io_request] == [io["name"] for io in data.get("writeIORequest", [])]
        assert len(command.commanded_transformations) == len(data.get("commandedTransformations", []))
    assert seen > 20


finite = st.floats(allow_nan=True, allow_infinity=True)
seven = st.tuples(*[finite] * 7)
names = st.text(max_size=20).filter(lambda text: "\x00" not in text and text.isprintable())
transformations = st.lists(
    st.one_of(
        st.builds(Transformation, names, st.lists(finite, max_size=12).map(tuple)),
        st.builds(QuaternionTransformation, names, st.lists(finite, max_size=7).map(tuple), st.just(TimeStamp(3, 4))),
    ),
    max_size=3,
).map(tuple)
ios = st.lists(
    st.builds(
        IoValue,
        names,
        st.integers(0, 2),
        st.integers(0, 1),
        st.none() | st.integers(0, 2**64 - 1),
        st.none() | finite,
    ),
    max_size=3,
).map(tuple)


@settings(max_examples=60, deadline=None)
@given(position=seven, names_and_values=ios, asked=transformations, counter=st.integers(0, 2**32 - 1))
def test_parts_of_variable_size_read_back_alike_in_both_readers(
    position: tuple[float, ...],
    names_and_values: tuple[IoValue, ...],
    asked: tuple[Transformation, ...],
    counter: int,
) -> None:
    message = MonitoringMessage(
        header=MessageHeader(0x245142, counter, 0),
        monitor_data=MonitorData(measured_joint_position=position, read_io_request=names_and_values),
        requested_transformations=asked,
    )
    data = pack_fri_state(message, LABELS)
    for decode in (rosbags_decode, mcap_ros2_decode):
        state = decode(data, definitions.FRI_STATE)
        assert same(state.measured_joint_position, list(position))
        assert [io.name for io in state.io_values] == [io.name for io in names_and_values]
        assert [io.digital_value for io in state.io_values] == [io.digital_value or 0 for io in names_and_values]
        assert [each.name for each in state.requested_transformations] == [each.name for each in asked]
        assert [each.robot_time_sec for each in state.requested_transformations] == [
            each.timestamp.sec if each.timestamp else 0 for each in asked
        ]
    assert state_counters(data) == (42, counter, 5)


@settings(max_examples=200, deadline=None)
@given(datagram=st.binary(max_size=200), version=st.sampled_from([FriVersion.V1_15, FriVersion.V2_5]))
def test_whatever_the_codec_decodes_can_be_packed(datagram: bytes, version: FriVersion) -> None:
    header = bytes.fromhex("0a0908c2a2910110011800")
    try:
        message = Codec(version).decode_monitoring(header + datagram)
    except FriError:
        return
    assert rosbags_decode(pack_fri_state(message, LABELS), definitions.FRI_STATE).sequence_counter >= 0


@settings(max_examples=100, deadline=None)
@given(state=st.integers(-(2**63), 2**63 - 1))
def test_an_enumeration_of_any_varint_can_be_packed(state: int) -> None:
    body = bytearray()
    value = state % 2**64
    while value > 127:
        body.append(value & 127 | 128)
        value >>= 7
    body.append(value)
    connection = b"\x08" + bytes(body) + b"\x10\x00"
    datagram = bytes.fromhex("0a0908c2a2910110011800") + b"\x22" + bytes([len(connection)]) + connection
    try:
        message = Codec(FriVersion.V1_15).decode_monitoring(datagram)
    except FriError:
        return
    rosbags_decode(pack_fri_state(message, LABELS), definitions.FRI_STATE)


@READERS
def test_small_messages_read_back(decode: Any) -> None:
    joints = decode(
        pack_joint_state(12_000_000_034, [0.1] * 7, [math.nan] * 7, [1.0, 2, 3, 4, 5, 6, 7]), definitions.JOINT_STATE
    )
    assert (joints.header.stamp.sec, joints.header.stamp.nanosec, joints.header.frame_id) == (12, 34, "")
    assert list(joints.name) == [f"iiwa_joint_{joint}" for joint in range(1, 8)]
    assert [len(joints.position), len(joints.velocity), len(joints.effort)] == [7, 7, 7]
    assert list(joints.effort) == [1, 2, 3, 4, 5, 6, 7]
    event = decode(
        pack_event(
            12, "GUARD", "Gelenk 3 – zu schnell.", host_time_ns=7, sample_index=8, joint=3, value=1.5, limit=1.2
        ),
        definitions.RUN_EVENT,
    )
    assert (event.code, event.name, event.sentence) == (12, "GUARD", "Gelenk 3 – zu schnell.")
    assert (event.joint, event.value, event.limit, event.host_time_ns, event.sample_index) == (3, 1.5, 1.2, 7, 8)
    assert decode(pack_string("<robot/>"), definitions.STRING).data == "<robot/>"
    status = DiagnosticStatus(1, "link", "late answers", (("late", "3"), ("missing", "0")))
    array = decode(pack_diagnostics(5_000_000_006, [status, status], "iiwa14"), definitions.DIAGNOSTIC_ARRAY)
    assert [each.message for each in array.status] == ["late answers"] * 2
    assert [(each.key, each.value) for each in array.status[1].values] == [("late", "3"), ("missing", "0")]
    assert int(array.status[0].level if isinstance(array.status[0].level, int) else array.status[0].level[0]) == 1


def test_schema_texts_name_every_message_of_the_log() -> None:
    for message in MESSAGES:
        text = definitions.schema_text(message)
        assert message in get_types_from_msg(text, message)
        assert text.count("=" * 80) == text.count("MSG: ")


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
