"""Claims about recovery: a log cut anywhere gives back every complete chunk, opens with other libraries, and the
original keeps every byte.

Truth: what the mcap library's own low-level reader finds in the uncut file, chunk by chunk.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from daemon.errors import BadLogError, ConfigurationError, LogIOError, MissingInputError
from daemon.log.parts import RECORDING_NAME, state_of_recording
from daemon.log.recover import merge_logs, recover_log
from daemon.run.folder import make_room
from daemon.run.recorder import Recorder
from fri_client.handover.ring import EventCode, HandoverRing

from .producer import Producer, make_job

SAMPLES = 400


class Log(bytes):
    """A file's bytes that do not flood a failure's report."""

    def __repr__(self) -> str:
        return f"<log of {len(self)} bytes>"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("whole")
    ring = HandoverRing.create(1024)
    producer = Producer(ring)
    producer.push(SAMPLES // 2)
    producer.push_event(EventCode.GAP, 3)
    producer.push(SAMPLES // 2, skip=3)
    ring.finish()
    job = make_job(folder)
    with pytest.MonkeyPatch.context() as patch:
        # Chunks of 64 KiB, so that 400 samples fill several.
        patch.setattr("daemon.log.writer.CHUNK_BYTES", 65536)
        assert Recorder(job, HandoverRing.attach(ring.fd), [].append).run() == 0
    ring.close()
    return Log(Path(job.path).read_bytes())


@pytest.fixture(scope="module")
def chunk_ends(log: bytes, tmp_path_factory: pytest.TempPathFactory) -> list[tuple[int, int]]:
    """(byte behind the chunk, samples up to there), found with the library's reader on growing prefixes."""
    ends = []
    samples = 0
    file = tmp_path_factory.mktemp("chunks") / "log.mcap"
    file.write_bytes(log)
    with file.open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=True)
        channels: dict[int, str] = {}
        for record in reader.records:
            if isinstance(record, Chunk):
                for inner in breakup_chunk(record):
                    if hasattr(inner, "topic"):
                        channels[inner.id] = inner.topic
                    elif hasattr(inner, "channel_id"):
                        samples += channels[inner.channel_id] == "/fri/state"
                ends.append((stream.tell(), samples))
    return ends


def counters(path: Path) -> list[int]:
    with AnyReader([path]) as bag:
        wanted = [each for each in bag.connections if each.topic == "/fri/state"]
        messages: list[Any] = [bag.deserialize(raw, connection.msgtype) for connection, _, raw in bag.messages(wanted)]
    return [message.sequence_counter for message in messages]


EXPECTED = [*range(100, 300), *range(303, 503)]


def test_a_whole_log_is_left_alone(log: bytes, tmp_path: Path) -> None:
    file = tmp_path / "recording.mcap"
    file.write_bytes(log)
    report = recover_log(file)
    assert report.whole
    assert report.recovered == file
    assert (report.samples, report.missing, report.missing_in_handover) == (SAMPLES, 3, 0)
    assert list(tmp_path.iterdir()) == [file]


def test_the_log_has_enough_chunks_to_be_cut(chunk_ends: list[tuple[int, int]]) -> None:
    assert len(chunk_ends) >= 5
    assert chunk_ends[-1][1] == SAMPLES


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_cut_at_any_byte_keeps_every_complete_chunk(
    log: bytes, chunk_ends: list[tuple[int, int]], tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    cut = data.draw(st.integers(0, len(log) - 1))
    folder = tmp_path_factory.mktemp("cut")
    file = folder / "recording.mcap"
    file.write_bytes(log[:cut])
    owed = max((samples for end, samples in chunk_ends if end <= cut), default=0)
    # The library may have read a record header ahead; a chunk that ends within it is still owed only when complete.
    try:
        report = recover_log(file)
    except BadLogError:
        assert owed == 0
        return
    assert report.samples >= owed
    assert not report.whole
    found = counters(report.recovered) if report.samples else []
    assert found == EXPECTED[: len(found)]
    assert len(found) == report.samples
    assert file.read_bytes() == log[:cut]


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_the_partial_last_chunk_gives_its_first_messages_where_its_compression_allows(
    log: bytes, tmp_path: Path, compression: CompressionType
) -> None:
    """One chunk of default size, as other recorders write it; zstd gives back whole blocks of 128 KiB only."""
    whole = tmp_path / "whole.mcap"
    with whole.open("wb") as stream:
        writer: Any = Writer(stream, compression=compression)
        writer.start("ros2")
        schema = writer.register_schema("iiwa_ident_msgs/msg/FriState", "ros2msg", b"")
        channel = writer.register_channel("/fri/state", "cdr", schema)
        for _, _, message in make_reader(io.BytesIO(log)).iter_messages("/fri/state"):
            writer.add_message(channel, message.log_time, message.data, message.publish_time)
        writer.finish()
    gained = []
    summary = make_reader(io.BytesIO(whole.read_bytes())).get_summary()
    assert summary is not None
    (chunk,) = summary.chunk_indexes
    for part in (0.5, 0.8, 0.97):
        file = tmp_path / f"{part}.mcap"
        file.write_bytes(whole.read_bytes()[: chunk.chunk_start_offset + int(part * chunk.chunk_length)])
        try:
            gained.append(recover_log(file).samples)
        except BadLogError:
            gained.append(0)
    assert 0 < gained[-1] < SAMPLES
    assert gained == sorted(gained)


def test_what_is_missing_is_said_by_the_counters(log: bytes, chunk_ends: list[tuple[int, int]], tmp_path: Path) -> None:
    file = tmp_path / "recording.mcap"
    file.write_bytes(log[: chunk_ends[-2][0]])
    report = recover_log(file)
    assert report.first_counter == 100
    assert report.missing == 3
    text = " ".join(report.sentences)
    assert "100" in text
    assert str(report.last_counter) in text
    assert report.recovered.name == "recording.recovered.mcap"


def test_a_restarted_controller_is_no_gap_of_two_thousand_million_messages(tmp_path: Path) -> None:
    ring = HandoverRing.create(1024)
    producer = Producer(ring)
    producer.push(150)
    producer.push(150, skip=(1 << 31) - 500)
    ring.finish()
    job = make_job(tmp_path)
    assert Recorder(job, HandoverRing.attach(ring.fd), [].append).run() == 0
    ring.close()
    file = Path(job.path)
    file.write_bytes(file.read_bytes()[:-8])  # not whole any more
    report = recover_log(file)
    assert report.samples == 300
    assert report.missing == 0
    assert report.last_counter == counters(report.recovered)[-1]


def test_attachments_and_metadata_survive(log: bytes, chunk_ends: list[tuple[int, int]], tmp_path: Path) -> None:
    file = tmp_path / "recording.mcap"
    file.write_bytes(log[: chunk_ends[-2][0]])
    with recover_log(file).recovered.open("rb") as stream:
        reader = make_reader(stream)
        assert {each.name for each in reader.iter_attachments()} >= {"request.json", "trajectory.json", "table.npy"}
        assert {each.name for each in reader.iter_metadata()} == {"iiwa_ident", "iiwa_ident_recovery"}
        assert reader.get_header().profile == "ros2"


def test_a_damaged_attachment_is_named_and_costs_nothing_else(log: bytes, tmp_path: Path) -> None:
    """The library gives an attachment as it reads; the truth is which bytes were flipped."""
    with io.BytesIO(log) as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    names = [index.name for index in summary.attachment_indexes]
    assert len(names) > 3
    for index in summary.attachment_indexes:
        broken = bytearray(log)
        broken[index.offset + index.length - 5] ^= 0x20  # the last byte of its data
        file = tmp_path / f"{index.name}.mcap"
        file.write_bytes(broken)
        report = recover_log(file)
        assert not report.whole
        assert f"'{index.name}'" in report.sentences[-1]
        assert "broken off after" not in " ".join(report.sentences)
        assert counters(report.recovered) == EXPECTED
        with report.recovered.open("rb") as stream:
            kept = {each.name: each.data for each in make_reader(stream).iter_attachments()}
        assert set(kept) == set(names) - {index.name}
        assert recover_log(report.recovered).whole


@pytest.mark.parametrize("place", [-5, 20])
def test_a_finished_run_with_a_damaged_attachment_was_not_broken_off(log: bytes, tmp_path: Path, place: int) -> None:
    """place: of the flipped byte in the attachment: the last of its data, or the first of its name's length."""
    with io.BytesIO(log) as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    index = summary.attachment_indexes[0]
    broken = bytearray(log)
    broken[index.offset + (place if place > 0 else index.length + place)] ^= 0x20
    file = tmp_path / RECORDING_NAME
    file.write_bytes(broken)
    assert state_of_recording(tmp_path) == "whole"
    with pytest.raises(ConfigurationError, match="holds a run already"):
        make_room(tmp_path)
    file.write_bytes(log[:-1])
    assert state_of_recording(tmp_path) == "broken"


@settings(max_examples=40, print_blob=False, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_flipped_bytes_never_give_a_false_sample_or_another_exception(
    log: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    broken = bytearray(log)
    for _ in range(data.draw(st.integers(1, 4))):
        broken[data.draw(st.integers(0, len(log) - 1))] ^= data.draw(st.integers(1, 255))
    file = tmp_path_factory.mktemp("flip") / "recording.mcap"
    file.write_bytes(broken)
    try:
        report = recover_log(file)
    except BadLogError:
        return
    if not report.whole and report.samples:
        assert set(counters(report.recovered)) <= set(EXPECTED)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"PK\x03\x04 not a log", bytes(5000)])
def test_a_file_without_samples_is_refused_with_one_sentence(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    file.write_bytes(content)
    with pytest.raises(BadLogError) as caught:
        recover_log(file)
    assert caught.value.exit_code == 65
    assert str(file) in str(caught.value)
    assert list(tmp_path.iterdir()) == [file]


def test_an_absent_file_is_missing_input(tmp_path: Path) -> None:
    with pytest.raises(MissingInputError) as caught:
        recover_log(tmp_path / "no.mcap")
    assert caught.value.exit_code == 66


def test_two_parts_become_one_recording_with_every_sample_once(
    log: bytes, chunk_ends: list[tuple[int, int]], tmp_path: Path
) -> None:
    """A broken first part and a second one that repeats its last samples, as a killed recorder leaves them."""
    first, output = tmp_path / "recording.broken.mcap", tmp_path / "recording.mcap"
    first.write_bytes(log[: chunk_ends[3][0] + 100])
    second = tmp_path / "recording.part1.mcap"
    second.write_bytes(log)
    report = merge_logs([first, second], output)
    assert counters(output) == EXPECTED
    assert (report.samples, report.missing, report.missing_in_handover) == (SAMPLES, 3, 0)
    assert report.messages["/fri/command"] == report.messages["/joint_states"] == SAMPLES
    with pytest.raises(LogIOError):
        merge_logs([first, second], output)
