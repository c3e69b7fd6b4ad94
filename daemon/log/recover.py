"""Recovery of a broken-off log: every complete chunk, and what the last broken chunk still gives, in a new whole file.

Here: a reader of MCAP records that takes nothing for granted, and the writing of the recovered copy. Not here: healthy
files (the mcap library reads those). The command line's `recover` and the supervisor call `recover_log`.

The original is never touched. What is missing is said by the counters in /fri/state: the robot's sequence counter
(lost before the loop) and the loop's sample index (lost between loop and file, or in the part that is gone).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from daemon.errors import BadLogError, LogIOError, MissingInputError
from daemon.log.cdr import event_index, state_counters
from daemon.log.writer import CHUNK_BYTES, count_messages

__all__ = ["RecoverReport", "recover_log"]

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEADER = struct.Struct("<BQ")
MAXIMUM_CHUNK_BYTES = 256 * 1024 * 1024
"""Uncompressed size beyond which a chunk's own claim is not believed."""
_COUNTER_MODULUS = 2**32
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """What a log still held.

    whole: the file was complete and nothing was written; recovered: the file to use (the original when whole).
    samples: messages on /fri/state; missing: gaps in the robot's sequence counter; missing_in_handover: gaps in the
    loop's sample index; bytes_used of bytes_total were readable. damaged_chunks: complete in length, wrong in content.
    """

    source: Path
    recovered: Path
    whole: bool
    samples: int
    messages: dict[str, int]
    first_counter: int | None
    last_counter: int | None
    missing: int
    missing_in_handover: int
    damaged_chunks: int
    bytes_used: int
    bytes_total: int
    sentences: tuple[str, ...] = field(default=())

    def to_json(self) -> dict[str, Any]:
        """The report with plain values."""
        return {**asdict(self), "source": str(self.source), "recovered": str(self.recovered)}


@dataclass(slots=True)
class _Found:
    """Everything the bytes gave, in file order; ids as in the original."""

    profile: str = ""
    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    channels: dict[int, tuple[int, str, str, dict[str, str]]] = field(default_factory=dict)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    damaged_chunks: int = 0
    bytes_used: int = 0
    complete: bool = False


class _Cursor:
    """Reads MCAP primitives from bytes; raises ValueError when they are too few."""

    __slots__ = ("_data", "_position")

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0

    def take(self, length: int) -> bytes:
        end = self._position + length
        if length < 0 or end > len(self._data):
            raise ValueError("record ends early")
        part = self._data[self._position : end]
        self._position = end
        return part

    def integer(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        return self.take(self.integer(4)).decode("utf-8")

    def text_map(self) -> dict[str, str]:
        inner = _Cursor(self.take(self.integer(4)))
        result: dict[str, str] = {}
        while inner.left:
            key = inner.text()
            result[key] = inner.text()
        return result

    @property
    def left(self) -> int:
        return len(self._data) - self._position

    def rest(self) -> bytes:
        return self.take(self.left)


class _Message(NamedTuple):
    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


class _Attachment(NamedTuple):
    log_time: int
    create_time: int
    name: str
    media_type: str
    data: bytes


def recover_log(path: str | Path, output: str | Path | None = None) -> RecoverReport:
    """Make a log whole again as far as its bytes go; see RecoverReport.

    output: defaults to NAME.recovered.mcap beside it; an existing file of that name is replaced in one step. Raises
    MissingInputError, BadLogError when nothing usable is in it, LogIOError when the disk refuses.
    """
    source = Path(path)
    if not source.is_file():
        raise MissingInputError(str(source), "the log to recover")
    total = source.stat().st_size
    if _is_whole(source):
        counts = _Counts()
        with source.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                counts.add(channel.topic, message.data)
        sentence = f"{source} is whole: {counts.samples} samples, nothing had to be recovered."
        return counts.report(source, source, True, 0, total, total, (sentence,))
    target = Path(output) if output is not None else source.with_name(f"{source.stem}.recovered.mcap")
    if target.resolve() == source.resolve():
        raise BadLogError(str(source), "the recovered copy cannot replace the original; choose another name.")
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        counts, found = _rewrite(source, temporary)
        written = count_messages(temporary)
        if written != counts.messages:
            raise BadLogError(str(temporary), f"holds {written} instead of {counts.messages}.")
        os.replace(temporary, target)
    except OSError as error:
        raise LogIOError(str(target), error) from error
    finally:
        temporary.unlink(missing_ok=True)
    sentences = _sentences(source, target, counts, found, total)
    return counts.report(source, target, False, found.damaged_chunks, found.bytes_used, total, sentences)


def _is_whole(source: Path) -> bool:
    """True when the library reads every message and the closing magic stands where it should."""
    try:
        with source.open("rb") as stream:
            stream.seek(-len(MAGIC), os.SEEK_END)
            if stream.read() != MAGIC:
                return False
        count_messages(source)
    except (OSError, BadLogError):
        return False
    return True


@dataclass(slots=True)
class _Counts:
    """Counts messages and gaps while they pass."""

    messages: dict[str, int] = field(default_factory=dict)
    samples: int = 0
    first_counter: int | None = None
    last_counter: int | None = None
    missing: int = 0
    missing_in_handover: int = 0
    next_index: int | None = None

    def add(self, topic: str, data: bytes) -> None:
        self.messages[topic] = self.messages.get(topic, 0) + 1
        try:
            if topic == "/run/events":
                # A record without a sample (an event alone, an undecodable datagram) has an index too.
                self._follow_index(event_index(data))
            if topic != "/fri/state":
                return
            self.samples += 1
            index, counter, _ = state_counters(data)
        except struct.error:
            return
        self._follow_index(index)
        if self.first_counter is None:
            self.first_counter = counter
        if self.last_counter is None:
            self.last_counter = counter
        else:
            ahead = (counter - self.last_counter) % _COUNTER_MODULUS
            if 0 < ahead < _COUNTER_MODULUS // 2:
                self.missing += ahead - 1
                self.last_counter = counter

    def _follow_index(self, index: int) -> None:
        if self.next_index is None:
            self.next_index = index + 1
        elif index >= self.next_index:
            self.missing_in_handover += index - self.next_index
            self.next_index = index + 1

    def report(
        self,
        source: Path,
        recovered: Path,
        whole: bool,
        damaged: int,
        used: int,
        total: int,
        sentences: tuple[str, ...],
    ) -> RecoverReport:
        return RecoverReport(
            source,
            recovered,
            whole,
            self.samples,
            dict(self.messages),
            self.first_counter,
            self.last_counter,
            self.missing,
            self.missing_in_handover,
            damaged,
            used,
            total,
            sentences,
        )


def _rewrite(source: Path, temporary: Path) -> tuple[_Counts, _Found]:
    """Copy everything readable into a new file. Raises BadLogError when there is not even a channel."""
    found, counts = _Found(), _Counts()
    schema_ids: dict[int, int] = {}
    channel_ids: dict[int, int] = {}
    with temporary.open("wb") as stream:
        writer: Any = Writer(cast(IO[bytes], stream), chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        started = False
        for item in _items(source, found):
            if not started:
                writer.start(profile=found.profile, library="iiwa-ident recover")
                started = True
            if isinstance(item, _Attachment):
                writer.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
                continue
            if item.channel not in found.channels:
                continue
            schema, topic, encoding, metadata = found.channels[item.channel]
            if schema and schema not in schema_ids:
                if schema not in found.schemas:
                    continue
                schema_ids[schema] = writer.register_schema(*found.schemas[schema])
            if item.channel not in channel_ids:
                channel_ids[item.channel] = writer.register_channel(
                    topic, encoding, schema_ids.get(schema, 0), metadata
                )
            writer.add_message(channel_ids[item.channel], item.log_time, item.data, item.publish_time, item.sequence)
            counts.add(topic, item.data)
        if not counts.messages:
            raise BadLogError(str(source), "holds no readable message; nothing can be recovered.")
        for name, metadata in found.metadata:
            writer.add_metadata(name, metadata)
        note = {"source": source.name, "bytes_used": str(found.bytes_used), "bytes_total": str(source.stat().st_size)}
        writer.add_metadata("iiwa_ident_recovery", {**note, "samples": str(counts.samples)})
        writer.finish()
        stream.flush()
        os.fsync(stream.fileno())
    return counts, found


def _items(source: Path, found: _Found) -> Iterator[_Message | _Attachment]:
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
                    return
                elif opcode == Opcode.ATTACHMENT:
                    yield _attachment(content)
                else:
                    message = _plain_record(opcode, content, found)
                    if message is not None:
                        yield message
            except (ValueError, UnicodeDecodeError):
                found.damaged_chunks += 1
            if not whole:
                return
            found.bytes_used = stream.tell()


def _chunk_messages(content: bytes, found: _Found, whole: bool) -> Iterator[_Message]:
    """The messages of one chunk; of a broken or damaged one those that stand complete before the damage."""
    if len(content) < _CHUNK.size:
        return
    _, _, uncompressed_size, checksum = _CHUNK.unpack_from(content)
    cursor = _Cursor(content[_CHUNK.size :])
    compression = cursor.text()
    stated = cursor.integer(8)
    packed = cursor.take(min(stated, cursor.left))
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


def _plain_record(opcode: int, content: bytes, found: _Found) -> _Message | None:
    """Note a schema, channel, header or metadata; give back a message. Raises ValueError on a malformed record."""
    cursor = _Cursor(content)
    if opcode == Opcode.MESSAGE:
        channel, sequence, log_time, publish_time = _MESSAGE.unpack(cursor.take(_MESSAGE.size))
        return _Message(channel, sequence, log_time, publish_time, cursor.rest())
    if opcode == Opcode.HEADER:
        found.profile = cursor.text()
    elif opcode == Opcode.SCHEMA:
        number = cursor.integer(2)
        name, encoding = cursor.text(), cursor.text()
        found.schemas[number] = (name, encoding, cursor.take(cursor.integer(4)))
    elif opcode == Opcode.CHANNEL:
        number, schema = cursor.integer(2), cursor.integer(2)
        topic, encoding = cursor.text(), cursor.text()
        found.channels[number] = (schema, topic, encoding, cursor.text_map())
    elif opcode == Opcode.METADATA:
        found.metadata.append((cursor.text(), cursor.text_map()))
    return None


def _attachment(content: bytes) -> _Attachment:
    cursor = _Cursor(content)
    log_time, create_time = cursor.integer(8), cursor.integer(8)
    name, media_type = cursor.text(), cursor.text()
    return _Attachment(log_time, create_time, name, media_type, cursor.take(cursor.integer(8)))


def _sentences(source: Path, target: Path, counts: _Counts, found: _Found, total: int) -> tuple[str, ...]:
    sentences = [
        f"{source} was broken off after {found.bytes_used} of {total} readable bytes; {counts.samples} samples are in "
        f"{target}."
    ]
    if counts.first_counter is not None:
        sentences.append(
            f"They carry the robot's counters {counts.first_counter} to {counts.last_counter} with {counts.missing} "
            f"missing in between and {counts.missing_in_handover} missing between loop and file; what came after "
            f"counter {counts.last_counter} is not in the file."
        )
    if found.damaged_chunks:
        sentences.append(f"{found.damaged_chunks} chunks were damaged and left out.")
    return tuple(sentences)
