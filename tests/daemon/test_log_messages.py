"""Claims about the log's messages: what two readers that share no code with the packer make of their bytes.

Truth comes from the vendor's golden datagrams (`fields` in vectors.json), decoded here by rosbags and by mcap_ros2.
"""

from __future__ import annotations

import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg

from daemon.log import definitions
from daemon.log.cdr import (
    DiagnosticStatus,
    LoggedEvent,
    pack_diagnostics,
    pack_event,
    pack_fri_command,
    pack_fri_state,
    pack_joint_state,
    pack_string,
    state_counters,
)
from fri_client.errors import FriError
from fri_client.messages import (
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

from .log_readers import (
    LABELS,
    MESSAGES,
    READERS,
    golden,
    mcap_ros2_decode,
    rosbags_decode,
    same,
)


@READERS
def test_every_golden_monitoring_message_reads_back_from_the_log_with_the_vendors_values(decode: Any) -> None:
    seen = 0
    for version, direction, text, fields in golden():
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
def test_every_golden_command_reads_back_from_the_log_with_the_vendors_values(decode: Any) -> None:
    seen = 0
    for version, direction, text, fields in golden():
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
            LoggedEvent(
                12, "GUARD", "Gelenk 3 – zu schnell.", host_time_ns=7, sample_index=8, joint=3, value=1.5, limit=1.2
            )
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
