"""The codec: any message survives the way there and back."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fri_client.errors import MessageTooLong
from fri_client.messages import (
    COMMAND_IDENTIFIER,
    MONITORING_IDENTIFIER,
    Checksum,
    CommandData,
    CommandMessage,
    ConnectionInfo,
    EndOfMessageData,
    FriVersion,
    IoValue,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    QuaternionTransformation,
    RedundancyInformation,
    RobotInfo,
    TimeStamp,
    Transformation,
)
from fri_client.wire.codec import Codec

from .codec_parts import CODECS, SEVEN, same

# ---- arbitrary messages, there and back ----------------------------------------------------------------------------

uint32 = st.integers(0, 2**32 - 1) | st.integers(0, 300)
int32 = st.integers(-(2**31), 2**31 - 1) | st.integers(0, 10)
double = st.floats(allow_nan=True, allow_infinity=True, width=64) | st.sampled_from(SEVEN)
joints = st.none() | st.tuples(*[double] * 7)
name = st.text(max_size=15) | st.just("n" * 63)


def optional(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.none() | strategy


def doubles(limit: int) -> st.SearchStrategy[tuple[float, ...]]:
    return st.lists(double, max_size=limit).map(tuple)


def several(strategy: st.SearchStrategy[Any], limit: int) -> st.SearchStrategy[tuple[Any, ...]]:
    return st.lists(strategy, max_size=limit).map(tuple)


time_stamps = st.builds(TimeStamp, uint32, uint32)
ios = st.builds(IoValue, name, int32, int32, optional(st.integers(0, 2**64 - 1)), optional(double))
endings = st.builds(EndOfMessageData, optional(int32), optional(st.builds(Checksum, optional(int32))))
robot_infos = st.builds(
    RobotInfo, optional(int32), optional(int32), several(int32, 7), optional(int32), optional(int32)
)
connections = st.builds(ConnectionInfo, int32, int32, optional(uint32), optional(uint32))
poses = st.builds(QuaternionTransformation, name, doubles(7), optional(time_stamps))
redundancies = st.builds(RedundancyInformation, int32, double)


def frames(version: FriVersion) -> st.SearchStrategy[tuple[Any, ...]]:
    one = poses if version.major == 2 else st.builds(Transformation, name, doubles(12), optional(time_stamps))
    return several(one, 3)


def headers(identifier: int) -> st.SearchStrategy[MessageHeader]:
    return st.builds(MessageHeader, st.just(identifier), uint32, uint32)


def monitoring_messages(version: FriVersion) -> st.SearchStrategy[MonitoringMessage]:
    two = version.major == 2
    data = st.builds(
        MonitorData,
        joints,
        joints,
        st.none() if two else joints,
        joints,
        joints,
        optional(doubles(6)) if version is FriVersion.V2_7 else st.none(),
        st.just(()) if version is FriVersion.V1_11 else several(ios, 4),
        optional(poses) if two else st.none(),
        optional(redundancies) if two else st.none(),
        optional(time_stamps),
    )
    interpolator = st.builds(
        IpoData,
        joints,
        optional(poses) if two else st.none(),
        optional(redundancies) if two else st.none(),
        optional(int32),
        optional(int32),
        optional(double),
    )
    ending = st.none() if version is FriVersion.V2_7 else optional(endings)
    return st.builds(
        MonitoringMessage,
        headers(MONITORING_IDENTIFIER),
        optional(robot_infos),
        optional(data),
        optional(connections),
        optional(interpolator),
        frames(version),
        ending,
    )


def command_messages(version: FriVersion) -> st.SearchStrategy[CommandMessage]:
    two = version.major == 2
    data = st.builds(
        CommandData,
        joints,
        optional(doubles(6)),
        joints,
        frames(version),
        st.just(()) if version is FriVersion.V1_11 else several(ios, 10),
        optional(poses) if two else st.none(),
        optional(redundancies) if two else st.none(),
    )
    ending = st.none() if version is FriVersion.V2_7 else optional(endings)
    return st.builds(CommandMessage, headers(COMMAND_IDENTIFIER), optional(data), ending)


without_clock = settings(
    deadline=None, max_examples=120, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)


@pytest.mark.parametrize("version", FriVersion)
def test_any_monitoring_message_survives_the_way_there_and_back(version: FriVersion) -> None:
    warm = CODECS[version]

    @without_clock
    @given(monitoring_messages(version))
    def there_and_back(message: MonitoringMessage) -> None:
        try:
            datagram = warm.encode_monitoring(message)
        except MessageTooLong:
            return
        assert same(Codec(version).decode_monitoring(datagram), message)
        assert same(warm.decode_monitoring(datagram), message)
        assert same(warm.decode_monitoring(datagram), message)

    there_and_back()


@pytest.mark.parametrize("version", FriVersion)
def test_any_command_message_survives_the_way_there_and_back(version: FriVersion) -> None:
    warm = CODECS[version]

    @without_clock
    @given(command_messages(version))
    def there_and_back(message: CommandMessage) -> None:
        try:
            datagram = warm.encode_command(message)
        except MessageTooLong:
            return
        assert same(Codec(version).decode_command(datagram), message)
        assert same(warm.decode_command(datagram), message)
        assert same(warm.decode_command(datagram), message)

    there_and_back()


@without_clock
@given(st.sampled_from(FriVersion), uint32, uint32, st.tuples(*[double] * 7))
def test_the_quick_position_command_is_the_general_one(
    version: FriVersion, counter: int, reflected: int, position: tuple[float, ...]
) -> None:
    codec = CODECS[version]
    message = CommandMessage(MessageHeader(COMMAND_IDENTIFIER, counter, reflected), CommandData(position))
    assert codec.encode_position_command(counter, reflected, position) == codec.encode_command(message)


@without_clock
@given(st.data())
def test_numbers_of_any_width_take_the_quick_way_and_mean_the_same(data: st.DataObject) -> None:
    """Messages of one shape whose counters change width: what a codec has read before does not change what it reads."""
    codec = Codec(FriVersion.V1_15)
    for _ in range(5):
        sizes = st.sampled_from([1, 2**7 - 1, 2**7, 2**14 - 1, 2**14, 2**21, 2**28 - 1, 2**28, 2**32 - 1])
        message = MonitoringMessage(
            MessageHeader(MONITORING_IDENTIFIER, data.draw(sizes), data.draw(sizes)),
            RobotInfo(data.draw(int32), drive_state=(2,) * 7),
            MonitorData(data.draw(joints), timestamp=TimeStamp(data.draw(sizes), data.draw(sizes))),
        )
        assert same(codec.decode_monitoring(codec.encode_monitoring(message)), message)
