"""A reader of MCAP records that takes nothing for granted: it gives what is readable and notes what is not.

Here: bytes to records, of files that may be cut or damaged anywhere. Not here: healthy files (the mcap library reads
those), and writing.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Metadata, Schema

from daemon.errors import BadLogError
from identification.attachments import attachment_name, has_its_checksum

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEADER = struct.Struct("<BQ")
MAXIMUM_CHUNK_BYTES = 256 * 1024 * 1024
"""Uncompressed size beyond which a chunk's own claim is not believed."""
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")


@dataclass(slots=True)
class Found:
    """Everything the bytes gave, in file order; ids as in the original."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    damaged_chunks: int = 0
    damaged_attachments: list[str] = field(default_factory=list)
    bytes_used: int = 0
    complete: bool = False


class _Cursor(ReadDataStream):
    """Reads MCAP primitives from bytes as the library does, but raises ValueError when they are too few."""

    def __init__(self, data: bytes) -> None:
        super().__init__(BytesIO(data))
        self._size = len(data)

    def read(self, length: int) -> bytes:
        if length > self.left:
            raise ValueError("record ends early")
        return super().read(length)

    @property
    def left(self) -> int:
        return self._size - self.count


def readable_items(source: Path, found: Found) -> Iterator[Message | Attachment]:
    """Messages and attachments in file order, as far as the bytes go; the rest is noted in `found`."""
    with source.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise BadLogError(str(source), "does not begin like an MCAP file; nothing can be recovered.")
        found.bytes_used = len(MAGIC)
        size = source.stat().st_size
        while True:
            head = stream.read(RECORD_HEADER.size)
            if len(head) < RECORD_HEADER.size:
                return
            opcode, length = RECORD_HEADER.unpack(head)
            left = size - stream.tell()
            content = stream.read(min(length, left))
            whole = length <= left
            try:
                if opcode == Opcode.CHUNK:
                    yield from _chunk_messages(content, found, whole)
                elif not whole:
                    return
                elif opcode in (Opcode.DATA_END, Opcode.FOOTER):
                    found.bytes_used = stream.tell()
                    found.complete = True
                    return
                elif opcode == Opcode.ATTACHMENT:
                    if has_its_checksum(content):
                        yield Attachment.read(_Cursor(content))
                    else:
                        found.damaged_attachments.append(attachment_name(content))
                else:
                    message = _plain_record(opcode, content, found)
                    if message is not None:
                        yield message
            except (ValueError, UnicodeDecodeError):
                found.damaged_chunks += 1
            if not whole:
                return
            found.bytes_used = stream.tell()


def _chunk_messages(content: bytes, found: Found, whole: bool) -> Iterator[Message]:
    """The messages of one chunk; of a broken or damaged one those that stand complete before the damage."""
    if len(content) < _CHUNK.size:
        return
    _, _, uncompressed_size, checksum = _CHUNK.unpack_from(content)
    cursor = _Cursor(content[_CHUNK.size :])
    compression = cursor.read_prefixed_string()
    stated = cursor.read8()
    packed = cursor.read(min(stated, cursor.left))
    if uncompressed_size > MAXIMUM_CHUNK_BYTES:
        raise ValueError("implausible chunk size")
    data = _decompress(packed, compression, uncompressed_size)
    if whole and (len(data) != uncompressed_size or (checksum and zlib.crc32(data) != checksum)):
        # A checksum that fails leaves no message in it trustworthy.
        found.damaged_chunks += 1
        return
    position = 0
    while position + RECORD_HEADER.size <= len(data):
        opcode, length = RECORD_HEADER.unpack_from(data, position)
        position += RECORD_HEADER.size
        if position + length > len(data):
            return
        message = _plain_record(opcode, data[position : position + length], found)
        if message is not None:
            yield message
        position += length


def _decompress(packed: bytes, compression: str, size: int) -> bytes:
    """As many uncompressed bytes as the compressed ones give. Raises ValueError for an unknown compression."""
    if compression == "":
        return packed
    result = bytearray()
    try:
        if compression == "zstd":
            reader = zstandard.ZstdDecompressor().stream_reader(packed)
            while len(result) < size and (part := reader.read1(min(65536, size - len(result)))):
                result += part
        else:
            raise ValueError(f"compression {compression} is not known")
    except zstandard.ZstdError:
        pass
    return bytes(result)


def _plain_record(opcode: int, content: bytes, found: Found) -> Message | None:
    """Note a schema, channel or metadata; give back a message. Raises ValueError on a malformed record."""
    if opcode == Opcode.MESSAGE:
        if len(content) < _MESSAGE.size:
            raise ValueError("record ends early")
        channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(content)
        return Message(channel, log_time, content[_MESSAGE.size :], publish_time, sequence)
    cursor = _Cursor(content)
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(cursor)
        found.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(cursor)
        found.channels[channel.id] = channel
    elif opcode == Opcode.METADATA:
        found.metadata.append(Metadata.read(cursor))
    return None


def damaged_attachments(source: Path) -> list[str]:
    """Names of the attachments of a log whose checksums do not fit; nothing else of it is looked at. Raises OSError."""
    found = []
    with source.open("rb") as stream:
        stream.seek(len(MAGIC))
        while len(head := stream.read(RECORD_HEADER.size)) == RECORD_HEADER.size:
            opcode, length = RECORD_HEADER.unpack(head)
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                break
            if opcode != Opcode.ATTACHMENT:
                stream.seek(length, os.SEEK_CUR)
            elif not has_its_checksum(content := stream.read(min(length, source.stat().st_size))):
                found.append(attachment_name(content))
    return found
