"""What a ROS 2 bag or one of this project's logs holds, as bytes by topic: from .mcap, .db3 and bag folders.

Only topics that can be a recording are kept (/fri/state and every JointState). Unpacking is bounded. Messages are
decoded elsewhere (`fri_log`, `joint_states`).
"""

from __future__ import annotations

import itertools
import struct
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from identification.errors import RecordingError
from identification.recordings import archive
from identification.recordings.fixed_columns import FixedColumns
from identification.recordings.unpacking import Allowance

__all__ = [
    "BAG_SUFFIXES",
    "FRI_STATE_TOPIC",
    "JOINT_STATE",
    "METADATA_RECORD",
    "Bag",
    "Topic",
    "bag_files",
    "entries_of",
    "read_bag",
]

IntArray = npt.NDArray[np.int64]

FRI_STATE_TOPIC = "/fri/state"
JOINT_STATE = "sensor_msgs/msg/JointState"
METADATA_RECORD = "iiwa_ident"
BAG_SUFFIXES = (".mcap", ".db3")
COMPRESSED = ".zstd"
MOST_ENTRIES = 5000
"""In a folder: a bag that is split every minute has as many in three days, and a run's folder has some twenty."""
_COPY_BYTES = 2**20
_RECORD = struct.Struct("<BQ")
"""Opcode and length of an MCAP record."""
_MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence, log time and publish time of a message."""
_HEAD = np.dtype([("kind", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"),
                  ("publish_time", "<u8")])  # fmt: skip
"""What stands before the bytes of a message in a chunk."""
_LOOKED_AT = 24
"""Records of a chunk that are walked one by one before a repetition is looked for."""


@dataclass(slots=True)
class Topic:
    """Messages of one topic in the order of the file, and the text of their definition.

    definition: None where the file has none and the type is the standard one. messages: (log time ns, bytes) each.
    columns: the fields of fixed size of all messages in place of `messages`; of /fri/state.
    """

    name: str
    type: str
    definition: str | None
    messages: list[tuple[int, bytes]] = field(default_factory=list)
    columns: FixedColumns | None = None

    def __len__(self) -> int:
        return len(self.messages) if self.columns is None else len(self.columns)

    def add(self, data: bytes, starts: IntArray, ends: IntArray, log_times: IntArray) -> None:
        """Messages that stand at some places of a block of bytes."""
        if self.columns is not None:
            self.columns.add(data, starts, ends)
            return
        places = zip(log_times.tolist(), starts.tolist(), ends.tolist(), strict=True)
        self.messages.extend((time, data[start:end]) for time, start, end in places)

    def decoded(self, path: Path) -> Iterator[Any]:
        """The messages, one by one. Raises RecordingError where one does not fit the definition."""
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # slow to load; our own logs do without

        store = get_typestore(Stores.EMPTY if self.definition is not None else Stores.ROS2_HUMBLE)
        try:
            if self.definition is not None:
                store.register(get_types_from_msg(self.definition, self.type))
            for _, data in self.messages:
                yield store.deserialize_cdr(data, self.type)
        except Exception as error:  # a parser of another library; whatever it raises, the message is unusable
            raise RecordingError(
                f"{path.name}: the messages on {self.name} do not fit their schema {self.type} ({error})",
                file=path,
                field=self.name,
            ) from error


@dataclass(slots=True)
class Bag:
    """Topics by name, the run's metadata, the import's arrays where there are any, and what ended the reading early."""

    topics: dict[str, Topic] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    archive: bytes | None = None
    broken_off: str = ""

    @property
    def messages(self) -> int:
        """Number of messages kept."""
        return sum(len(topic) for topic in self.topics.values())

    def topic(self, name: str, type_: str, definition: str | None) -> Topic:
        """The topic of this name, made where it is new."""
        if name not in self.topics:
            columns = FixedColumns(definition or "") if name == FRI_STATE_TOPIC else None
            self.topics[name] = Topic(name, type_, definition, columns=columns)
        return self.topics[name]


def bag_files(folder: Path) -> tuple[Path, ...]:
    """The data files of a bag's folder in their order, .mcap or .db3 or these compressed; empty where it is no bag.

    Raises RecordingError for a folder that holds more than one bag or more files than a bag can.
    """
    files = [
        file
        for file in entries_of(folder)
        if file.name.removesuffix(COMPRESSED).endswith(BAG_SUFFIXES) and file.is_file()
    ]
    names = list(dict.fromkeys(_name_of_bag(file.name) for file in files))
    if len(names) > 1:
        raise RecordingError(
            f"{folder}: holds {len(files)} logs of different names ({', '.join(sorted(names)[:3])}, …), which are not "
            "one recording; name those that are meant",
            file=folder,
        )
    # rosbag2 numbers them NAME_0, NAME_1, … NAME_10: by number, not by letter.
    return tuple(sorted(files, key=lambda file: [int(x) if x.isdigit() else x for x in _number_parts(file.name)]))


def entries_of(folder: Path) -> list[Path]:
    """What lies in a folder. Raises RecordingError where it is more than a run or a bag has, before all is listed."""
    found = list(itertools.islice(folder.iterdir(), MOST_ENTRIES + 1))
    if len(found) > MOST_ENTRIES:
        raise RecordingError(
            f"{folder}: holds more than {MOST_ENTRIES} files, which neither a run nor a ROS 2 bag does; name the "
            "recording itself",
            file=folder,
        )
    return found


def _name_of_bag(file: str) -> str:
    stem = file.split(".")[0]
    head, _, tail = stem.rpartition("_")
    return head if tail.isdigit() else stem


def _number_parts(name: str) -> list[str]:
    stem = name.split(".")[0]
    head, _, tail = stem.rpartition("_")
    return [head, tail if tail.isdigit() else "0", name]


def read_bag(files: tuple[Path, ...], path: Path) -> Bag:
    """The contents of the files of one bag (one log: a single file); path: what to call it in messages.

    Raises RecordingError where nothing can be read, or where it unpacks to more than a recording can be.
    """
    bag = Bag()
    for file in files:
        with ExitStack() as stack:
            plain = file
            if file.name.endswith(COMPRESSED):
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="iiwa-ident-")))
                plain = _unpacked_file(file, folder)
            allowance = Allowance(file)
            if plain.suffix == ".mcap":
                _read_mcap(plain, path, allowance, bag)
            else:
                _read_database(plain, path, allowance, bag)
    return bag


def _unpacked_file(file: Path, folder: Path) -> Path:
    allowance = Allowance(file)
    target = folder / file.name.removesuffix(COMPRESSED)
    with file.open("rb") as packed, target.open("wb") as plain:
        try:
            for block in zstandard.ZstdDecompressor().read_to_iter(packed, write_size=_COPY_BYTES):
                allowance.take(len(block))
                plain.write(block)
        except zstandard.ZstdError as error:
            raise RecordingError(f"{file.name}: cannot be unpacked ({error})", file=file) from error
    return target


def _read_mcap(file: Path, path: Path, allowance: Allowance, bag: Bag) -> None:
    schemas: dict[int, Schema] = {}
    topics: dict[int, Topic | None] = {}
    complete, trouble = False, ""
    try:
        for record in _records(file, allowance, topics):
            if isinstance(record, Message):
                topic = topics.get(record.channel_id)
                if topic is not None:
                    times = np.array([record.log_time], dtype=np.int64)
                    topic.add(record.data, np.array([0]), np.array([len(record.data)]), times)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                topics[record.id] = _topic_of(record, schemas.get(record.schema_id), path, bag)
                if FRI_STATE_TOPIC in bag.topics:  # nothing else is read of a run's log
                    others = [key for key, item in topics.items() if item is not bag.topics[FRI_STATE_TOPIC]]
                    topics.update(dict.fromkeys(others))
            elif isinstance(record, Metadata) and record.name == METADATA_RECORD:
                bag.metadata.update(record.metadata)
            elif isinstance(record, Attachment) and record.name == archive.ATTACHMENT_NAME:
                bag.archive = record.data
            elif isinstance(record, Footer):
                complete = True
    except RecordingError:
        raise
    except Exception as error:  # the library leaks struct.error, zstd and lz4 errors besides its own
        trouble = _cause(error)
        if not bag.messages and bag.archive is None:
            raise RecordingError(
                f"{path.name}: no complete chunk of an MCAP log could be read ({trouble})", file=path
            ) from error
    if not complete:
        bag.broken_off = trouble or "the footer is missing"


def _records(file: Path, allowance: Allowance, topics: Mapping[int, Topic | None]) -> Iterator[McapRecord]:
    """All records of a file, those in chunks too; no chunk becomes more bytes than it states and than may be.

    Messages in chunks go to `topics` by their channel's number at once; those of other channels are passed over.
    """
    with file.open("rb") as stream:
        # A record cannot be longer than the file; a length that says so must not be believed by an allocation.
        for record in _WithoutIndexes(stream, emit_chunks=True, record_size_limit=file.stat().st_size).records:
            if isinstance(record, Chunk):
                data = allowance.unpack(record.data, record.compression, record.uncompressed_size)
                yield from _in_chunk(data, topics)
            else:
                yield record


class _WithoutIndexes(StreamReader):
    """Reads a file from front to back, so that what tells where its messages are need not be taken apart."""

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        if opcode in (Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX):
            self._stream.read(length)
            return None
        return super()._read_record(opcode, length)


def _in_chunk(data: bytes, topics: Mapping[int, Topic | None]) -> Iterator[McapRecord]:
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


def _add_messages(data: bytes, starts: IntArray, ends: IntArray, topics: Mapping[int, Topic | None]) -> None:
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


def _topic_of(channel: Channel, schema: Schema | None, path: Path, bag: Bag) -> Topic | None:
    if schema is None or not (channel.topic == FRI_STATE_TOPIC or schema.name == JOINT_STATE):
        return None
    if schema.encoding != "ros2msg" or channel.message_encoding != "cdr":
        raise RecordingError(
            f"{path.name}: {channel.topic} is encoded as {channel.message_encoding} with a {schema.encoding} schema; "
            "cdr with a ros2msg schema is needed",
            file=path,
            field=channel.topic,
        )
    return bag.topic(channel.topic, schema.name, schema.data.decode())


def _cause(error: Exception) -> str:
    """What ended the reading, in words: the library's end-of-file error has none of its own."""
    if isinstance(error, EndOfFile):
        return "the file ends in the middle of a record"
    return str(error) if isinstance(error, McapError) and str(error) else f"{type(error).__name__}: {error}"


def _read_database(file: Path, path: Path, allowance: Allowance, bag: Bag) -> None:
    """A .db3 of rosbag2; messages may be compressed one by one."""
    from rosbags.interfaces import MessageDefinitionFormat  # slow to load; our own logs do without
    from rosbags.rosbag2 import Reader

    try:
        reader = Reader(file)
        reader.open()
        try:
            wanted = [item for item in reader.connections if item.msgtype == JOINT_STATE]
            for item in wanted:
                known = item.msgdef.format == MessageDefinitionFormat.MSG
                bag.topic(item.topic, item.msgtype, item.msgdef.data if known else None)
            for item, time, data in reader.messages(wanted) if wanted else ():
                plain = bytes(data)
                if plain.startswith(zstandard.FRAME_HEADER):
                    claimed = zstandard.frame_content_size(plain)
                    plain = allowance.unpack(plain, "zstd", claimed if claimed > 0 else allowance.left)
                bag.topics[item.topic].messages.append((time, plain))
        finally:
            reader.close()
    except RecordingError:
        raise
    except Exception as error:  # as above: apsw, zstd and struct errors come through
        if not bag.messages:
            raise RecordingError(f"{path.name}: cannot be read as a bag of ROS 2 ({error})", file=path) from error
        bag.broken_off = str(error)
