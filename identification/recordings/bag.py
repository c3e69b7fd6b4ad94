"""What a ROS 2 bag or one of this project's logs holds, as bytes by topic: from .mcap, .db3 and bag folders.

Only topics that can be a recording are kept (/fri/state and every JointState). Unpacking is bounded. Messages are
decoded elsewhere (`fri_log`, `joint_states`).
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Attachment, Channel, Footer, Message, Metadata, Schema

from identification.arrays import IntArray
from identification.errors import RecordingError
from identification.recordings import archive
from identification.recordings.fixed_columns import FixedColumns
from identification.recordings.mcap_records import DamagedAttachment, records_of
from identification.recordings.unpacking import Allowance

FRI_STATE_TOPIC = "/fri/state"
JOINT_STATE = "sensor_msgs/msg/JointState"
METADATA_RECORD = "iiwa_ident"
BAG_SUFFIXES = (".mcap", ".db3")
COMPRESSED = ".zstd"
MOST_ENTRIES = 5000
"""In a folder: a bag that is split every minute has as many in three days, and a run's folder has some twenty."""
_COPY_BYTES = 2**20


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
            raise RecordingError.named(
                path, f"the messages on {self.name} do not fit their schema {self.type} ({error})", field=self.name
            ) from error


@dataclass(slots=True)
class Bag:
    """Topics by name, the run's metadata, the import's arrays where there are any, the names of attachments whose bytes
    are damaged, and what ended the reading early.
    """

    topics: dict[str, Topic] = field(default_factory=dict)
    metadata: dict[str, str] = field(default_factory=dict)
    archive: bytes | None = None
    damaged: list[str] = field(default_factory=list)
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
    names = list(dict.fromkeys(_number_parts(file.name)[0] for file in files))
    if len(names) > 1:
        raise RecordingError.at(
            folder,
            f"holds {len(files)} logs of different names ({', '.join(sorted(names)[:3])}, …), which are not "
            "one recording; name those that are meant",
        )
    # rosbag2 numbers them NAME_0, NAME_1, … NAME_10: by number, not by letter.
    return tuple(sorted(files, key=lambda file: [int(x) if x.isdigit() else x for x in _number_parts(file.name)]))


def entries_of(folder: Path) -> list[Path]:
    """What lies in a folder. Raises RecordingError where it is more than a run or a bag has, before all is listed."""
    found = list(itertools.islice(folder.iterdir(), MOST_ENTRIES + 1))
    if len(found) > MOST_ENTRIES:
        raise RecordingError.at(
            folder,
            f"holds more than {MOST_ENTRIES} files, which neither a run nor a ROS 2 bag does; name the "
            "recording itself",
        )
    return found


def _number_parts(name: str) -> list[str]:
    """Name of the bag, number of the file in it, name of the file."""
    stem = name.split(".")[0]
    head, _, tail = stem.rpartition("_")
    return [head, tail, name] if tail.isdigit() else [stem, "0", name]


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
            raise RecordingError.named(file, f"cannot be unpacked ({error})") from error
    return target


def _read_mcap(file: Path, path: Path, allowance: Allowance, bag: Bag) -> None:
    schemas: dict[int, Schema] = {}
    topics: dict[int, Topic | None] = {}
    complete, trouble = False, ""
    try:
        for record in records_of(file, allowance, topics):
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
            elif isinstance(record, DamagedAttachment):
                bag.damaged.append(record.name)
            elif isinstance(record, Footer):
                complete = True
    except RecordingError:
        raise
    except Exception as error:  # the library leaks struct.error, zstd and lz4 errors besides its own
        trouble = _cause(error)
        if not bag.messages and bag.archive is None:
            raise RecordingError.named(path, f"no complete chunk of an MCAP log could be read ({trouble})") from error
    if not complete:
        bag.broken_off = trouble or "the footer is missing"


def _topic_of(channel: Channel, schema: Schema | None, path: Path, bag: Bag) -> Topic | None:
    if schema is None or not (channel.topic == FRI_STATE_TOPIC or schema.name == JOINT_STATE):
        return None
    if schema.encoding != "ros2msg" or channel.message_encoding != "cdr":
        raise RecordingError.named(
            path,
            f"{channel.topic} is encoded as {channel.message_encoding} with a {schema.encoding} schema; "
            "cdr with a ros2msg schema is needed",
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
            raise RecordingError.named(path, f"cannot be read as a bag of ROS 2 ({error})") from error
        bag.broken_off = str(error)
