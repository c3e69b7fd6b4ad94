"""Recovery of a broken-off log: every complete chunk, and what the last broken chunk still gives, in a new whole file.

Here: the writing of the recovered copy, the joining of parts, the report. Not here: the tolerant reading
(`raw_reader`). The command line's `recover` calls `recover_log`, the supervisor both.

The original is never touched. What is missing is said by the counters in /fri/state: the robot's sequence counter
(lost before the loop) and the loop's sample index (lost between loop and file, or in the part that is gone).
"""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

from mcap.reader import make_reader
from mcap.records import Attachment, Message, Schema
from mcap.writer import CompressionType, Writer

from daemon.errors import BadLogError, LogIOError, MissingInputError
from daemon.log.cdr import command_index, event_index, is_out_of_order, state_counters
from daemon.log.raw_reader import MAGIC, Found, damaged_attachments, readable_items
from daemon.log.stream import is_being_written
from daemon.log.writer import CHUNK_BYTES, count_messages
from daemon.words import counted
from fri_client.session.replayed_counter import ReplayedCounter


@dataclass(frozen=True, slots=True)
class RecoverReport:
    """What a log still held.

    whole: the file was complete and nothing was written; recovered: the file to use (the original when whole).
    samples: messages on /fri/state, samples_in_periods: of them in recorded periods; missing: gaps in the robot's
    sequence counter; missing_in_handover: gaps in the loop's sample index; next_index: the first index after the last
    one in the file; last_period: the highest number of a period (-1: none). bytes_used of bytes_total were readable.
    damaged_chunks: complete in length, wrong in content.
    """

    source: Path
    recovered: Path
    whole: bool
    samples: int
    samples_in_periods: int
    messages: dict[str, int]
    first_counter: int | None
    last_counter: int | None
    missing: int
    missing_in_handover: int
    next_index: int
    last_period: int
    damaged_chunks: int
    bytes_used: int
    bytes_total: int
    sentences: tuple[str, ...] = field(default=())

    def to_json(self) -> dict[str, Any]:
        """The report with plain values."""
        return {**asdict(self), "source": str(self.source), "recovered": str(self.recovered)}


def recover_log(path: str | Path) -> RecoverReport:
    """Make a log whole again as far as its bytes go, as NAME.recovered.mcap beside it; see RecoverReport.

    An existing file of that name is replaced in one step. Raises MissingInputError, BadLogError when nothing usable is
    in it, LogIOError when the disk refuses or while a recorder writes the file.
    """
    source = Path(path)
    if not source.is_file():
        raise MissingInputError(str(source), "the log to recover")
    if is_being_written(source):
        raise LogIOError(str(source), OSError(errno.EBUSY, "is being recorded right now; wait until the run has ended"))
    total = source.stat().st_size
    if _is_whole(source):
        counts = _Counts()
        with source.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                counts.add(channel.topic, message.data)
        sentence = f"{source} is whole: {counted(counts.samples, 'sample')}, nothing had to be recovered."
        return counts.report(source, source, Found(bytes_used=total), total, (sentence,), whole=True)
    target = source.with_name(f"{source.stem}.recovered.mcap")
    counts, found = _write_copy([source], target)
    return counts.report(source, target, found, total, _sentences(source, target, counts, found, total))


def is_finished(source: Path) -> bool:
    """Whether the closing magic stands at its end, which a killed recorder never wrote; parts may be damaged since."""
    try:
        with source.open("rb") as stream:
            stream.seek(-len(MAGIC), os.SEEK_END)
            return stream.read() == MAGIC
    except OSError:
        return False


def _is_whole(source: Path) -> bool:
    """True when it is finished, the library reads every message and no attachment is damaged."""
    try:
        count_messages(source)
        return is_finished(source) and not damaged_attachments(source)
    except (OSError, BadLogError):
        return False


@dataclass(slots=True)
class _Counts:
    """Counts messages and gaps while they pass."""

    messages: dict[str, int] = field(default_factory=dict)
    samples: int = 0
    samples_in_periods: int = 0
    first_counter: int | None = None
    last_counter: int | None = None
    missing_in_handover: int = 0
    next_index: int | None = None
    last_period: int = -1
    counter: ReplayedCounter = field(default_factory=ReplayedCounter)

    def add(self, topic: str, data: bytes) -> None:
        self.messages[topic] = self.messages.get(topic, 0) + 1
        try:
            if topic == "/run/events":
                # A record without a sample (an event alone, an undecodable datagram) has an index too.
                self._follow_index(event_index(data))
            if topic != "/fri/state":
                return
            self.samples += 1
            index, counter, period = state_counters(data)
        except struct.error:
            return
        self._follow_index(index)
        self.last_period = max(self.last_period, period)
        self.samples_in_periods += period >= 0
        if self.first_counter is None:
            self.first_counter = counter
        self.counter.take(counter, believed=not is_out_of_order(data))
        self.last_counter = self.counter.last

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
        found: Found,
        total: int,
        sentences: tuple[str, ...],
        *,
        whole: bool = False,
    ) -> RecoverReport:
        return RecoverReport(
            source, recovered, whole, self.samples, self.samples_in_periods, dict(self.messages), self.first_counter,
            self.last_counter, self.counter.missing, self.missing_in_handover, self.next_index or 0, self.last_period,
            found.damaged_chunks, found.bytes_used, total, sentences,
        )  # fmt: skip


def merge_logs(parts: Sequence[str | Path], output: str | Path) -> RecoverReport:
    """Join the parts of one recording, each whole or broken off, in their order; a sample in two of them is kept once.

    Raises MissingInputError, BadLogError when no part holds anything usable, LogIOError when the disk refuses or the
    output exists already.
    """
    sources, target = [Path(part) for part in parts], Path(output)
    for source in sources:
        if not source.is_file():
            raise MissingInputError(str(source), "a part of the recording")
    if target.exists():
        raise LogIOError(str(target), FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST)))
    total = sum(source.stat().st_size for source in sources)
    counts, found = _write_copy(sources, target)
    names = ", ".join(source.name for source in sources)
    sentence = f"{target} was joined from {names} and holds {counted(counts.samples, 'sample')}."
    return counts.report(sources[0], target, found, total, (sentence, *_damage_sentences(found)))


def _write_copy(sources: Sequence[Path], target: Path) -> tuple[_Counts, Found]:
    """Write a whole file of everything readable beside the target, count it, and put it in the target's place."""
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        counts, found = _rewrite(sources, temporary)
        written = count_messages(temporary)
        if written != counts.messages:
            raise BadLogError(str(temporary), f"holds {written} instead of {counts.messages}.")
        os.replace(temporary, target)
    except OSError as error:
        raise LogIOError(str(target), error) from error
    finally:
        temporary.unlink(missing_ok=True)
    return counts, found


class _Copy:
    """The file being written: channels by topic, so that the parts of one recording share them."""

    def __init__(self, stream: IO[bytes]) -> None:
        self.writer: Any = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self.counts = _Counts()
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._last: dict[str, int] = {}
        self._known: dict[str, int] = {}

    def begin_part(self) -> None:
        """What earlier parts hold is not taken again."""
        self._known = dict(self._last)

    def add(self, message: Message, found: Found) -> None:
        """Copy one message unless its channel or schema is lost, or an earlier part has it."""
        channel = found.channels.get(message.channel_id)
        if channel is None:
            return
        schema = found.schemas.get(channel.schema_id)
        if (channel.schema_id and schema is None) or self._is_known(channel.topic, message):
            return
        key = (channel.topic, channel.message_encoding)
        if key not in self._channels:
            self._channels[key] = self.writer.register_channel(*key, self._schema(schema), channel.metadata)
        self.writer.add_message(
            self._channels[key], message.log_time, message.data, message.publish_time, message.sequence
        )
        self.counts.add(channel.topic, message.data)

    def _schema(self, schema: Schema | None) -> int:
        if schema is None:
            return 0
        key = (schema.name, schema.encoding, schema.data)
        if key not in self._schemas:
            self._schemas[key] = self.writer.register_schema(*key)
        return self._schemas[key]

    def _is_known(self, topic: str, message: Message) -> bool:
        """True when an earlier part has this sample's message on this topic."""
        try:
            place = _place_in_recording(topic, message)
        except struct.error:
            return False
        if place is None:
            return False
        self._last[topic] = max(self._last.get(topic, place), place)
        return place <= self._known.get(topic, -1)


def _place_in_recording(topic: str, message: Message) -> int | None:
    """A number that grows with the samples of a topic; None for a topic that does not belong to samples."""
    if topic == "/fri/state":
        return state_counters(message.data)[0]
    if topic == "/fri/command":
        return command_index(message.data)
    return message.log_time if topic == "/joint_states" else None


def _rewrite(sources: Sequence[Path], temporary: Path) -> tuple[_Counts, Found]:
    """Copy everything readable into a new file. Raises BadLogError when there is no message at all."""
    total = Found()
    with temporary.open("wb") as stream:
        copy = _Copy(stream)
        started = False
        unreadable: BadLogError | None = None
        for source in sources:
            found = Found()
            copy.begin_part()
            try:
                for item in readable_items(source, found):
                    if not started:
                        # What is recovered is a log of ours, whatever is left of its header.
                        copy.writer.start(profile="ros2", library="iiwa-ident recover")
                        started = True
                    if isinstance(item, Attachment):
                        if source == sources[0]:
                            copy.writer.add_attachment(
                                item.create_time, item.log_time, item.name, item.media_type, item.data
                            )
                    else:
                        copy.add(item, found)
            except BadLogError as error:
                unreadable = error
            known = {each.name for each in total.metadata}
            total.metadata += [each for each in found.metadata if each.name not in known]
            total.bytes_used += found.bytes_used
            total.damaged_chunks += found.damaged_chunks
            total.damaged_attachments += found.damaged_attachments
            total.complete = found.complete
        if not copy.counts.messages:
            raise unreadable or BadLogError(str(sources[0]), "holds no readable message; nothing can be recovered.")
        for each in total.metadata:
            copy.writer.add_metadata(each.name, each.metadata)
        note = {
            "sources": ", ".join(source.name for source in sources),
            "bytes_used": str(total.bytes_used),
            "bytes_total": str(sum(source.stat().st_size for source in sources)),
            "samples": str(copy.counts.samples),
        }
        copy.writer.add_metadata("iiwa_ident_recovery", note)
        copy.writer.finish()
        stream.flush()
        os.fsync(stream.fileno())
    return copy.counts, total


def _sentences(source: Path, target: Path, counts: _Counts, found: Found, total: int) -> tuple[str, ...]:
    damaged = _damage_sentences(found)
    how = (
        f"{source} is not broken off, but parts of it are damaged"
        if found.complete and damaged
        else f"{source} was broken off after {found.bytes_used} of {total} readable bytes"
    )
    sentences = [f"{how}; {counted(counts.samples, 'sample', verb=True)} in {target}."]
    if counts.first_counter is not None:
        after = "" if found.complete else f"; what came after counter {counts.last_counter} is not in the file"
        sentences.append(
            f"They carry the robot's counters {counts.first_counter} to {counts.last_counter} with "
            f"{counts.counter.missing} missing in between and {counts.missing_in_handover} missing between loop and "
            f"file{after}."
        )
    return (*sentences, *damaged)


def _damage_sentences(found: Found) -> tuple[str, ...]:
    sentences = []
    if found.damaged_chunks:
        sentences.append(f"{found.damaged_chunks} chunks were damaged and left out.")
    if found.damaged_attachments:
        names = ", ".join(f"'{name}'" for name in found.damaged_attachments)
        sentences.append(f"Damaged attachments were left out: {names}. No sample stands in them.")
    return tuple(sentences)
