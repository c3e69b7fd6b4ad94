"""Versions, enumerations and value objects, against the numbers of the protocol sheet (section 4)."""

from __future__ import annotations

import msgspec
import pytest

from fri_client.errors import CodecError, FriError, UnknownFriVersion
from fri_client.messages import (
    COMMAND_IDENTIFIER,
    MONITORING_IDENTIFIER,
    ClientCommandMode,
    ConnectionQuality,
    FriVersion,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    SafetyState,
    SessionState,
)


def test_identifiers_are_the_published_ones() -> None:
    assert (MONITORING_IDENTIFIER, COMMAND_IDENTIFIER) == (2380098, 212993)


def test_states_have_the_numbers_of_the_wire() -> None:
    assert [state.name for state in sorted(SessionState)] == [
        "IDLE",
        "MONITORING_WAIT",
        "MONITORING_READY",
        "COMMANDING_WAIT",
        "COMMANDING_ACTIVE",
    ]
    assert [int(quality) for quality in ConnectionQuality] == [0, 1, 2, 3]
    assert ClientCommandMode(4).name == "CARTESIAN_POSE"
    assert ClientCommandMode["POSITION"] is ClientCommandMode["JOINT_POSITION"]


def test_a_stop_of_level_0_is_number_1() -> None:
    assert SafetyState(1).name == "SAFETY_STOP_LEVEL_0"


@pytest.mark.parametrize("text", ["1.15", " 1.15 ", "FRI 1.15", "fri1.15", "v1.15"])
def test_a_version_is_read_as_an_operator_writes_it(text: str) -> None:
    assert FriVersion.parse(text) is FriVersion.V1_15


@pytest.mark.parametrize("text", ["", "1.1", "1.150", "3.0", "latest"])
def test_an_unknown_version_is_named_with_those_that_are_known(text: str) -> None:
    with pytest.raises(UnknownFriVersion) as caught:
        FriVersion.parse(text)
    assert caught.value.exit_code == 78
    assert isinstance(caught.value, ValueError)
    assert all(version.value in str(caught.value) for version in FriVersion)


def test_only_2_7_is_framed() -> None:
    assert [version.value for version in FriVersion if version.is_framed] == ["2.7"]
    assert [version.major for version in FriVersion] == [1, 1, 1, 1, 2, 2]


def test_a_message_cannot_be_changed() -> None:
    message = MonitoringMessage(MessageHeader(MONITORING_IDENTIFIER, 1, 2), monitor_data=MonitorData())
    with pytest.raises(AttributeError):
        message.monitor_data = None  # type: ignore[misc]
    changed = msgspec.structs.replace(message, monitor_data=None)
    assert message.monitor_data == MonitorData()
    assert changed == MonitoringMessage(MessageHeader(MONITORING_IDENTIFIER, 1, 2))


def test_every_error_has_an_exit_code_of_the_contract() -> None:
    def family(error: type[FriError]) -> set[type[FriError]]:
        return {error}.union(*(family(child) for child in error.__subclasses__()))

    assert {error.exit_code for error in family(FriError)} <= {1, 65, 66, 69, 70, 74, 76, 78}
    assert all(error.exit_code == 76 for error in family(CodecError))
