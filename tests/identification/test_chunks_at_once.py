"""Claims about reading a chunk's messages many at once: the same messages as one by one, whatever their order and size.

Truth: `breakup_chunk` of the mcap library, which walks record by record.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Chunk, Message
from mcap.stream_reader import breakup_chunk

from identification.recordings.bag import JOINT_STATE, Topic
from identification.recordings.fixed_columns import FixedColumns
from identification.recordings.mcap_records import _ahead, _in_chunk

CHANNELS = (1, 2, 3)


def record(channel: int, size: int, number: int) -> bytes:
    """A message of so many bytes; what it says is its number."""
    body = struct.pack("<HIQQ", channel, number, 10**9 + number, number) + bytes(
        (number + k) % 251 for k in range(size)
    )
    return struct.pack("<BQ", Opcode.MESSAGE, len(body)) + body


def read_at_once(data: bytes) -> dict[int, list[tuple[int, bytes]]]:
    topics = {channel: Topic(str(channel), JOINT_STATE, None) for channel in CHANNELS}
    list(_in_chunk(data, dict(topics)))
    return {channel: topic.messages for channel, topic in topics.items()}


def read_one_by_one(data: bytes) -> dict[int, list[tuple[int, bytes]]]:
    found: dict[int, list[tuple[int, bytes]]] = {channel: [] for channel in CHANNELS}
    for message in breakup_chunk(Chunk("", data, 0, 0, 0, len(data))):
        if isinstance(message, Message) and message.channel_id in found:
            found[message.channel_id].append((message.log_time, message.data))
    return found


turns = st.tuples(
    st.lists(st.tuples(st.integers(1, 4), st.integers(0, 40)), min_size=1, max_size=5), st.integers(1, 40)
)


@settings(max_examples=150, deadline=None)
@given(st.lists(turns, min_size=1, max_size=4))
def test_messages_in_turns_are_those_that_a_walk_finds(pattern: list[tuple[list[tuple[int, int]], int]]) -> None:
    sizes = [each for turn, times in pattern for _ in range(times) for each in turn]
    data = b"".join(record(channel, size, number) for number, (channel, size) in enumerate(sizes))
    assert read_at_once(data) == read_one_by_one(data)


@pytest.mark.parametrize("missing", [1, 8, 30, 45, 46, 47, 200])
def test_of_a_chunk_that_ends_within_a_record_the_whole_ones_are_kept(missing: int) -> None:
    whole = b"".join(record(1 + number % 2, 15, number) for number in range(120))
    cut = whole[:-missing]
    topics = {channel: Topic(str(channel), JOINT_STATE, None) for channel in CHANNELS}
    length = len(record(1, 15, 0))
    if len(cut) % length:
        with pytest.raises(EndOfFile):
            list(_in_chunk(cut, dict(topics)))
    else:
        list(_in_chunk(cut, dict(topics)))
    assert sum(len(topic) for topic in topics.values()) == len(cut) // length


@given(st.integers(0, 30))
def test_records_made_ready_ahead_come_in_their_order_and_an_error_in_its_place(count: int) -> None:
    def records() -> Iterator[bytes]:
        for number in range(count):
            yield bytes([number])
        raise EndOfFile

    ahead = _ahead(records())
    assert [next(ahead) for _ in range(count)] == [bytes([number]) for number in range(count)]
    with pytest.raises(EndOfFile):
        next(ahead)


def test_fixed_fields_are_those_of_each_message_and_a_short_message_is_refused() -> None:
    columns = FixedColumns("bool first\nfloat64[3] second\nint32 third # of all\nstring rest\n")
    rows = [(bool(k % 2), (0.1 * k, np.pi, -float(k)), 7 - k) for k in range(50)]
    bodies = [
        b"\0\1\0\0" + struct.pack("<?7x3di", first, *second, third) + b"x" * (k % 5)
        for k, (first, second, third) in enumerate(rows)
    ]
    ends = np.cumsum([len(body) for body in bodies])
    columns.add(b"".join(bodies), ends - [len(body) for body in bodies], ends)
    found = columns.columns(("third", "first", "second"))
    assert found["first"].tolist() == [row[0] for row in rows]
    assert found["second"].tolist() == [list(row[1]) for row in rows]
    assert found["third"].tolist() == [row[2] for row in rows]
    columns.add(bodies[0][:-1], np.array([0]), np.array([len(bodies[0]) - 1]))
    with pytest.raises(ValueError, match="39 bytes does not hold its 40"):
        columns.columns(("first",))
