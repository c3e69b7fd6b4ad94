"""One monitoring message, its labels, and two readers of CDR that share no code with the packer of the log."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from daemon.log import definitions
from daemon.log.cdr import SampleLabels
from fri_client.messages import (
    ConnectionInfo,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    TimeStamp,
)
from tests.reference import golden_datagrams

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


def golden() -> list[tuple[str, str, str, dict[str, Any]]]:
    return [
        (version, direction, vector["hex"], vector["fields"])
        for version, groups in golden_datagrams().items()
        for direction in ("monitoring", "command")
        for vector in groups[direction]
    ]


def number(value: Any) -> float:
    return float(value)


def same(values: Any, expected: list[Any]) -> bool:
    return bool(
        np.array_equal(np.asarray(values)[: len(expected)], [number(each) for each in expected], equal_nan=True)
    )
