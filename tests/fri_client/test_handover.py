"""The hand-over ring against a plain queue, across two real processes, over its edge, and when it is full."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
from collections import deque
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fri_client.handover.ring import (
    COMMAND_CAPACITY,
    MONITORING_CAPACITY,
    SLOT_BYTES,
    Disposition,
    EventCode,
    HandoverError,
    HandoverRecord,
    HandoverRing,
    LoopStatus,
)


@pytest.fixture
def ring() -> Iterator[HandoverRing]:
    made = HandoverRing.create(8)
    yield made
    made.close()


def push(ring: HandoverRing, number: int, monitoring: bytes = b"m", command: bytes | None = b"c") -> bool:
    return ring.push(number, number + 1, 3, number % 5, number, monitoring, command)


def test_a_record_comes_out_as_it_went_in(ring: HandoverRing) -> None:
    monitoring, command = os.urandom(474), os.urandom(85)
    assert ring.push(11, 12, 3, 4, 9999, monitoring, command, EventCode.GUARD, 7, 1.5, -0.25, Disposition.DUPLICATE)
    assert ring.read_batch() == [
        HandoverRecord(0, 11, 12, 3, 4, 9999, EventCode.GUARD, 7, 1.5, -0.25, monitoring, command, 1)
    ]


def test_no_answer_and_an_empty_answer_stay_apart(ring: HandoverRing) -> None:
    push(ring, 0, command=None)
    push(ring, 1, command=b"")
    assert [record.command for record in ring.read_batch()] == [None, b""]


def test_the_longest_datagram_fits_and_a_longer_one_keeps_its_first_1500_bytes(ring: HandoverRing) -> None:
    longest, longer = os.urandom(MONITORING_CAPACITY), os.urandom(2048)
    push(ring, 0, longest, os.urandom(COMMAND_CAPACITY))
    push(ring, 1, longer, os.urandom(SLOT_BYTES))
    first, second = ring.read_batch()
    assert first.monitoring == longest
    assert second.monitoring == longer[:MONITORING_CAPACITY]
    assert second.command is not None
    assert len(second.command) == COMMAND_CAPACITY


def test_a_full_ring_refuses_at_once_counts_the_loss_and_shows_it_as_a_gap(ring: HandoverRing) -> None:
    assert [push(ring, number) for number in range(11)] == [True] * 8 + [False] * 3
    assert (ring.lost, ring.backlog) == (3, 8)
    ring.read_batch()
    assert not push(ring, 11), "records that are read but not released still hold their slots"
    ring.release()
    assert push(ring, 12)
    assert [record.index for record in ring.read_batch()] == [12]
    assert ring.lost == 4


def test_what_was_not_released_is_there_for_the_next_recorder(ring: HandoverRing) -> None:
    for number in range(6):
        push(ring, number)
    first = HandoverRing.attach(ring.fd)
    first.read_batch(2)
    first.release()
    first.read_batch(2)
    first.close()
    second = HandoverRing.attach(ring.fd)
    assert [record.index for record in second.read_batch()] == [2, 3, 4, 5]
    second.close()


def test_a_loop_that_takes_over_an_existing_ring_goes_on_where_the_other_stopped(ring: HandoverRing) -> None:
    push(ring, 0)
    other = HandoverRing.attach(ring.fd)
    push(other, 1)
    assert [record.index for record in ring.read_batch()] == [0, 1]
    other.close()


# The same operations on a deque are the model: it never loses order, and it is not our code.
_operation = st.one_of(
    st.tuples(st.just("push"), st.binary(max_size=40), st.none() | st.binary(max_size=20)),
    st.tuples(st.just("read"), st.integers(0, 12), st.none()),
    st.tuples(st.just("release"), st.none(), st.none()),
)


@settings(max_examples=200, deadline=None)
@given(st.integers(1, 9), st.lists(_operation, max_size=120))
def test_the_ring_behaves_like_a_bounded_queue(slots: int, operations: list[tuple[str, object, object]]) -> None:
    ring = HandoverRing.create(slots)
    waiting: deque[tuple[int, object, object]] = deque()
    unreleased = attempted = lost = 0
    try:
        for name, first, second in operations:
            if name == "push":
                room = len(waiting) + unreleased < slots
                assert ring.push(1, 2, 0, -1, -1, first, second) is room  # type: ignore[arg-type]
                if room:
                    waiting.append((attempted, first, second))
                else:
                    lost += 1
                attempted += 1
            elif name == "read":
                assert isinstance(first, int)
                expected = [waiting.popleft() for _ in range(min(first, len(waiting)))]
                unreleased += len(expected)
                assert [(r.index, r.monitoring, r.command) for r in ring.read_batch(first)] == expected
            else:
                ring.release()
                unreleased = 0
            assert ring.backlog == len(waiting) + unreleased
            assert ring.lost == lost
    finally:
        ring.close()


_PRODUCER = textwrap.dedent(
    """
    import sys, time
    from fri_client.handover.ring import HandoverRing
    ring = HandoverRing.attach(int(sys.argv[1]))
    for number in range(int(sys.argv[2])):
        body = number.to_bytes(4, "little") * (1 + number % 300)
        while ring.backlog >= ring.slots:
            time.sleep(0.0005)
        ring.push(number, number, 0, -1, -1, body, None)
    ring.publish_reason("the end is reached")
    ring.finish()
    if len(sys.argv) > 3:
        print("pushed", flush=True)
        time.sleep(600)
    """
)


def start_producer(ring: HandoverRing, count: int, *more: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", _PRODUCER, str(ring.fd), str(count), *more], pass_fds=[ring.fd], stdout=subprocess.PIPE
    )


def test_another_process_hands_over_twenty_thousand_records_whole_and_in_order() -> None:
    ring = HandoverRing.create(64)
    count = 20000
    with start_producer(ring, count) as producer:
        seen = 0
        while not (ring.finished and ring.backlog == 0):
            for record in ring.read_batch():
                expected = record.index.to_bytes(4, "little") * (1 + record.index % 300)
                assert record.index == seen
                assert record.monitoring == expected
                seen += 1
            ring.release()
            assert producer.poll() in (None, 0)
        assert seen == count
        assert ring.reason == "the end is reached"
    ring.close()


def test_what_a_killed_process_pushed_is_still_there() -> None:
    ring = HandoverRing.create(64)
    with start_producer(ring, 50, "wait") as producer:
        assert producer.stdout is not None
        producer.stdout.readline()
        os.kill(producer.pid, signal.SIGKILL)
        assert producer.wait() == -signal.SIGKILL
    assert [record.index for record in ring.read_batch()] == list(range(50))
    ring.close()


def test_requests_heartbeat_and_status_reach_the_other_side(ring: HandoverRing) -> None:
    loop = HandoverRing.attach(ring.fd)
    assert (loop.stop_request, loop.heartbeat_ns) == (0, 0)
    ring.request_stop(EventCode.DISK_FULL)
    ring.beat(123456789)
    assert (loop.stop_request, loop.heartbeat_ns) == (EventCode.DISK_FULL, 123456789)
    loop.publish_status(tuple(range(17)))
    assert ring.status == LoopStatus(*range(17))
    loop.publish_reason("ä" * 3000)
    assert ring.reason.startswith("ää")
    assert len(ring.reason.encode()) <= 2000
    loop.close()


def test_a_status_is_never_read_as_zeros_while_it_is_written(ring: HandoverRing) -> None:
    """A recorder whose supervisor was killed read time zero, held the moving loop for gone and closed the recording."""
    ring.publish_status((7,) * 17)
    reader, loop = os.getpid(), os.fork()
    if not loop:
        with contextlib.suppress(BaseException):
            own = HandoverRing.attach(ring.fd)
            while os.getppid() == reader and not own.stop_request:
                own.publish_status((7,) * 17)
        os._exit(0)
    try:
        read = {ring.status for _ in range(100_000)}
    finally:
        ring.request_stop(EventCode.OPERATOR_STOP)
        os.waitpid(loop, 0)
    assert read == {LoopStatus(*(7,) * 17)}


def test_a_recorder_counts_as_stalled_beyond_four_fifths_of_the_ring() -> None:
    ring = HandoverRing.create(100)
    for number in range(80):
        push(ring, number)
    assert not ring.consumer_stalled
    push(ring, 80)
    assert ring.consumer_stalled
    ring.read_batch(5)
    ring.release()
    assert not ring.consumer_stalled
    ring.close()


def test_a_descriptor_that_is_no_ring_is_refused_with_a_sentence(tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("ring") / "file"
    path.write_bytes(bytes(100000))
    with path.open("r+b") as file, pytest.raises(HandoverError, match="no hand-over ring"):
        HandoverRing.attach(file.fileno())
    path.write_bytes(bytes(10))
    with path.open("r+b") as file, pytest.raises(HandoverError, match="no hand-over ring"):
        HandoverRing.attach(file.fileno())
    reading, writing = os.pipe()
    with pytest.raises(HandoverError):
        HandoverRing.attach(reading)
    os.close(reading)
    os.close(writing)


def test_nobody_can_shrink_the_memory_under_another_process(ring: HandoverRing) -> None:
    with pytest.raises(PermissionError):
        os.ftruncate(ring.fd, 4096)
