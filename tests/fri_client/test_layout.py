"""The quick way gives what the reader gives, for datagrams of a known shape and for no others."""

from __future__ import annotations

import pytest

from fri_client.messages import (
    MONITORING_IDENTIFIER,
    FriVersion,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    RobotInfo,
    TimeStamp,
    Transformation,
)
from fri_client.wire.codec import Codec
from fri_client.wire.layout import LayoutBook
from fri_client.wire.reader import GroupReader
from tests.reference import golden_datagrams

VECTORS = golden_datagrams()


def golden_payloads(version: str) -> list[bytes]:
    datagrams = [bytes.fromhex(entry["hex"]) for entry in VECTORS[version]["monitoring"]]
    return [datagram[4:-4] if version == "2.7" else datagram for datagram in datagrams]


@pytest.mark.parametrize("version", VECTORS)
def test_every_golden_shape_is_learned_and_read_as_the_reader_reads_it(version: str) -> None:
    book = LayoutBook(MonitoringMessage, FriVersion(version))
    reader = GroupReader(MonitoringMessage, FriVersion(version))
    for payload in golden_payloads(version):
        message = reader.read(payload, 0, len(payload))
        book.learn(payload, message)
        assert book.read(payload) == message


def test_a_change_of_any_fixed_bit_is_another_shape() -> None:
    codec = Codec(FriVersion.V1_15)
    message = MonitoringMessage(
        MessageHeader(MONITORING_IDENTIFIER, 300, 2),
        RobotInfo(7, drive_state=(2,) * 7),
        MonitorData((0.5,) * 7, timestamp=TimeStamp(2**31, 5)),
        ipo_data=IpoData(tracking_performance=1.0),
    )
    payload = codec.encode_monitoring(message)
    book = LayoutBook(MonitoringMessage, FriVersion.V1_15)
    book.learn(payload, message)
    assert book.read(payload) == message
    reader = GroupReader(MonitoringMessage, FriVersion.V1_15)
    taken = 0
    for bit in range(8 * len(payload)):
        changed = bytearray(payload)
        changed[bit // 8] ^= 1 << bit % 8
        quick = book.read(bytes(changed))
        if quick is not None:
            taken += 1
            assert quick == reader.read(bytes(changed), 0, len(changed))
    # 8 doubles of 64 bits; 8 numbers of one byte (7 bits), one of two bytes (14), one of five (32), and the counters
    # 2 and 5 of one byte: every other bit belongs to the shape.
    assert taken == 8 * 64 + 8 * 7 + 14 + 32 + 2 * 7


def test_datagrams_that_the_vendor_would_not_write_are_left_to_the_reader() -> None:
    codec = Codec(FriVersion.V1_15)
    connection, header = bytes.fromhex("220408041003"), bytes.fromhex("0a0b08c2a2910110840718c203")
    payload = connection + header
    message = codec.decode_monitoring(payload)
    book = LayoutBook(MonitoringMessage, FriVersion.V1_15)
    book.learn(payload, message)
    assert book.read(payload) is None
    book.learn(header + connection, message)
    assert book.read(header + connection) == message


def test_a_full_book_takes_no_further_page_and_everything_is_still_read() -> None:
    codec = Codec(FriVersion.V1_15)
    messages = [
        MonitoringMessage(
            MessageHeader(MONITORING_IDENTIFIER, number, 0),
            requested_transformations=(Transformation(f"frame {number}"),),
        )
        for number in range(3 * LayoutBook.MOST_PAGES)
    ]
    for _ in range(2):
        for message in messages:
            assert codec.decode_monitoring(codec.encode_monitoring(message)) == message
    book = codec._monitoring_layouts
    assert book._pages == LayoutBook.MOST_PAGES
    assert sum(map(len, book._by_length.values())) == LayoutBook.MOST_PAGES
