"""The records of an MCAP file from front to back, at the speed of the disk: a log has half a million messages.

The messages of a chunk are found at once. Which topics are kept is decided elsewhere (`bag`).
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Schema
from mcap.stream_reader import StreamReader

from identification.arrays import IntArray
from identification.attachments import attachment_name, has_its_checksum
from identification.recordings.unpacking import Allowance

_RECORD = struct.Struct("<BQ")
"""Opcode and length of an MCAP record."""
_HEAD = np.dtype([("kind", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"),
                  ("publish_time", "<u8")])  # fmt: skip
"""What stands before the bytes of a message in a chunk."""
_LOOKED_AT = 24
"""Records of a chunk that are walked one by one before a repetition is looked for."""
_AHEAD = 8
"""Records, and unpacked chunks, that are made ready while those before them are taken apart."""


class MessageSink(Protocol):
    """What takes the messages of a channel."""

    def add(self, data: bytes, starts: IntArray, ends: IntArray, log_times: IntArray) -> None:
        """Messages that stand at some places of a block of bytes."""


def records_of(file: Path, allowance: Allowance, topics: Mapping[int, MessageSink | None]) -> Iterator[McapRecord]:
    """All records of a file, those in chunks too; no chunk becomes more bytes than it states and than may be.

    Messages in chunks go to `topics` by their channel's number at once; those of other channels are passed over.
    """
    with file.open("rb") as stream:
        # A record cannot be longer than the file; a length that says so must not be believed by an allocation.
        records = _WithoutIndexes(stream, emit_chunks=True, record_size_limit=file.stat().st_size).records
        for record in _ahead(_unpacked(records, allowance)):
            if isinstance(record, bytes):
                yield from _in_chunk(record, topics)
            else:
                yield record


def _unpacked(records: Iterator[McapRecord], allowance: Allowance) -> Iterator[McapRecord | bytes]:
    for record in records:
        if isinstance(record, Chunk):
            data = allowance.unpack(record.data, record.compression, record.uncompressed_size)
            # Damaged bytes may unpack all the same, and would pass for positions and torques.
            if record.uncompressed_crc and zlib.crc32(data) != record.uncompressed_crc:
                raise McapError(
                    "a chunk is damaged, its checksum does not fit; `iiwa-ident recover` saves what follows"
                )
            yield data
        else:
            yield record


def _ahead(records: Iterator[McapRecord | bytes]) -> Iterator[McapRecord | bytes]:
    """The records in their order, made by a thread: unpacking needs no interpreter. An error comes in its place."""
    with ThreadPoolExecutor(1) as thread:
        waiting = deque(thread.submit(next, records, None) for _ in range(_AHEAD))
        while (record := waiting.popleft().result()) is not None:
            waiting.append(thread.submit(next, records, None))
            yield record


class _WithoutIndexes(StreamReader):
    """Reads a file from front to back, so that what tells where its messages are need not be taken apart."""

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        if opcode in (Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX):
            self._stream.read(length)
            return None
        if opcode == Opcode.ATTACHMENT:
            return attachment_of(self._stream.read(length))
        return super()._read_record(opcode, length)


class DamagedAttachment(McapRecord):
    """In place of an attachment whose checksum does not fit; its name as far as that can be read."""

    def __init__(self, name: str) -> None:
        self.name = name


def attachment_of(content: bytes) -> Attachment | DamagedAttachment:
    """The attachment of a record's bytes, which the library would give as they are."""
    if has_its_checksum(content):
        attachment: Attachment = Attachment.read(ReadDataStream(BytesIO(content)))
        return attachment
    return DamagedAttachment(attachment_name(content))


def _in_chunk(data: bytes, topics: Mapping[int, MessageSink | None]) -> Iterator[McapRecord]:
    """The schemas and channels of an unpacked chunk; its messages go to `topics`, many at once."""
    bounds = _bounds(data)
    starts, ends = bounds[:-1], bounds[1:]
    kinds = np.frombuffer(data, np.uint8)[starts]
    told = np.flatnonzero((kinds == Opcode.SCHEMA) | (kinds == Opcode.CHANNEL))
    for first, last in itertools.pairwise([0, *(told + 1).tolist(), len(starts)]):
        messages = first + np.flatnonzero(kinds[first:last] == Opcode.MESSAGE)
        _add_messages(data, starts[messages], ends[messages], topics)
        if last - 1 in told:
            kind = Schema if kinds[last - 1] == Opcode.SCHEMA else Channel
            yield kind.read(ReadDataStream(BytesIO(data[starts[last - 1] + _RECORD.size : ends[last - 1]])))
    if bounds[-1] < len(data):
        raise EndOfFile


def _bounds(data: bytes) -> IntArray:
    """(R + 1,) where the records of an unpacked chunk begin, and where the last whole one ends.

    A recorder writes the same few kinds of messages in turns. After some records the sizes of the last turn are
    looked for in all that follows at once; where they end, it goes on one by one.
    """
    found: list[IntArray] = []
    position = 0
    while position < len(data):
        walked: list[int] = []
        while len(walked) < _LOOKED_AT and position + _RECORD.size <= len(data):
            end = position + _RECORD.size + _RECORD.unpack_from(data, position)[1]
            if end > len(data):
                break
            walked.append(position)
            position = end
        found.append(np.array(walked, dtype=np.int64))
        if len(walked) < _LOOKED_AT:
            break
        repeated, position = _repeated(data, walked, position)
        found.append(repeated)
    return np.concatenate([*found, [position]])


def _repeated(data: bytes, walked: list[int], end: int) -> tuple[IntArray, int]:
    """Starts of the records behind `end` whose sizes repeat those of the last turn of the walked ones; their end."""
    starts = np.array([*walked, end])
    sizes = np.diff(starts)
    for turn in range(1, len(sizes) // 2 + 1):
        if not np.array_equal(sizes[turn:], sizes[:-turn]):
            continue
        first = starts[-1 - turn]
        span = int(end - first)
        turns = np.frombuffer(data, np.uint8, (len(data) - end) // span * span, end).reshape(-1, span)
        lengths = (starts[-1 - turn : -1] - first)[:, None] + np.arange(1, _RECORD.size)
        alike = (turns[:, lengths] == np.frombuffer(data, np.uint8, span, first)[lengths]).all(axis=(1, 2))
        count = len(alike) if alike.all() else int(np.argmin(alike))
        places = end + span * np.arange(count)[:, None] + (starts[-1 - turn : -1] - first)
        return places.ravel(), end + span * count
    return np.empty(0, dtype=np.int64), end


def _add_messages(data: bytes, starts: IntArray, ends: IntArray, topics: Mapping[int, MessageSink | None]) -> None:
    if starts.size == 0:
        return
    if np.any(ends - starts < _HEAD.itemsize):
        raise EndOfFile
    heads: npt.NDArray[Any] = np.ndarray(len(data) - _HEAD.itemsize + 1, _HEAD, data, strides=(1,))[starts]
    for channel, topic in topics.items():
        if topic is None or not (own := heads["channel"] == channel).any():
            continue
        times = heads["log_time"][own].astype(np.int64)
        topic.add(data, starts[own] + _HEAD.itemsize, ends[own], times)
