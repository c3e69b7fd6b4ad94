"""The ring in memory between the 1 kHz loop and whoever writes its samples to disk.

Here live the layout of the ring (a header page and fixed slots in an anonymous memory file), its single producer
and its single consumer; what a record says stands in `record`. Files, formats and processes live
elsewhere: the supervisor creates the ring and hands its file descriptor to the loop (producer) and to the recorder
(consumer).

Rules kept here: `push` never blocks, never allocates more than it frees, and never loses a record unseen (a full
ring raises the lost counter, and the gap shows in `HandoverRecord.index`). The memory belongs to the kernel, not to
a process: when a process is killed, what was pushed stays readable through any other open descriptor.

Memory order. Every counter is one aligned 64-bit word touched through `memoryview.cast("Q")`, which CPython
compiles to one 8-byte load or store (struct with "<Q" would write byte by byte and could tear). The producer fills
the slot first and publishes its counter last; the consumer reads the counter first and the slot afterwards. x86-64
keeps stores in order and loads in order, and no compiler moves memory accesses across the calls the interpreter
makes between two statements. On an architecture with weaker order (arm64) this needs a fence that Python cannot
express; `create` refuses to run there.

    byte   content                                       written by
    0      magic, layout version, slot size, slots       create
    64     produced (records published)                  loop
    128    consumed (records released)                   recorder
    192    attempted (records pushed or lost), lost      loop
    256    stop request (EventCode), heartbeat ns        supervisor
    320    monotonic -> epoch offset ns                  create
    384    closed flag, LoopStatus                       loop
    576    may the motion begin: see `start_gate`        loop, supervisor
    688    what hinders the motion: length, UTF-8        loop
    1024   reason: length, UTF-8                         loop
    4096   slot 0, slot 1, ...
"""

from __future__ import annotations

import fcntl
import mmap
import os
import platform
import struct
import time

from fri_client.handover.errors import HandoverError, NoMemoryForHandover
from fri_client.handover.record import Disposition, EventCode, HandoverRecord, LoopStatus
from fri_client.handover.start_gate import StartGate

__all__ = [
    "COMMAND_CAPACITY",
    "MONITORING_CAPACITY",
    "SLOT_BYTES",
    "Disposition",
    "EventCode",
    "HandoverError",
    "HandoverRecord",
    "HandoverRing",
    "LoopStatus",
    "NoMemoryForHandover",
]

SLOT_BYTES = 2048
MONITORING_CAPACITY = 1500
"""No FRI datagram is longer (PROTOCOL §1); of a longer one the first 1500 bytes are kept."""

_HEADER_BYTES = 4096
_MAGIC = 0x474E4952_49524649  # "IFRIRING" in memory
_LAYOUT_VERSION = 1
_SLOT = struct.Struct("@QqqiiiiiIddHHI")  # index .. lengths; native order, one machine
_PAYLOAD_OFFSET = 80
COMMAND_CAPACITY = SLOT_BYTES - _PAYLOAD_OFFSET - MONITORING_CAPACITY
_STATUS = struct.Struct("@17q")
_HINDRANCE_OFFSET, _HINDRANCE_CAPACITY = 688, 328
_REASON_OFFSET, _REASON_CAPACITY = 1024, 2000

# Places in the header, counted in 8-byte words.
_W_MAGIC, _W_VERSION, _W_SLOT_BYTES, _W_SLOTS = 0, 1, 2, 3
_W_PRODUCED = 8
_W_CONSUMED = 16
_W_ATTEMPTED, _W_LOST = 24, 25
_W_STOP_REQUEST, _W_HEARTBEAT = 32, 33
_W_EPOCH_OFFSET = 40
_W_CLOSED = 48
_STATUS_OFFSET = 49 * 8


class HandoverRing:
    """Single-producer single-consumer ring of fixed slots in an anonymous memory file (layout: see the module's
    text). fd: descriptor of the memory file; slots: capacity in records.
    """

    def __init__(self, fd: int, *, owns_fd: bool) -> None:
        self.fd = fd
        self._owns_fd = owns_fd
        size = os.fstat(fd).st_size
        if size < _HEADER_BYTES + SLOT_BYTES:
            raise HandoverError(f"descriptor {fd} holds {size} bytes, which is no hand-over ring")
        # MAP_POPULATE: no page fault inside the loop.
        self._map = mmap.mmap(
            fd, size, flags=mmap.MAP_SHARED | mmap.MAP_POPULATE, prot=mmap.PROT_READ | mmap.PROT_WRITE
        )
        self._bytes = memoryview(self._map)
        self._words = self._bytes[:_HEADER_BYTES].cast("Q")
        self._signed_words = self._bytes[:_HEADER_BYTES].cast("q")
        self._status = self._bytes[_STATUS_OFFSET : _STATUS_OFFSET + _STATUS.size]
        self._next_status = bytearray(_STATUS.size)
        words = self._words
        slots = words[_W_SLOTS]
        if (
            words[_W_MAGIC] != _MAGIC
            or words[_W_VERSION] != _LAYOUT_VERSION
            or words[_W_SLOT_BYTES] != SLOT_BYTES
            or size != _HEADER_BYTES + slots * SLOT_BYTES
        ):
            self.close()
            raise HandoverError(f"descriptor {fd} is no hand-over ring of layout version {_LAYOUT_VERSION}")
        self.gate = StartGate(words, self._bytes)
        self.slots = slots
        self._stop_level = slots * 8 // 10
        self._produced = words[_W_PRODUCED]
        self._attempted = words[_W_ATTEMPTED]
        self._cursor = words[_W_CONSUMED]

    @classmethod
    def create(cls, slots: int) -> HandoverRing:
        """Make an empty ring of `slots` slots; its `fd` is to be inherited by the loop and the recorder (pass_fds).

        All its memory is reserved now, so that a machine short of memory says so here and not as a bus error in the
        loop. Raises NoMemoryForHandover when it is not there, HandoverError on a processor whose memory order the ring
        does not suit.
        """
        if slots < 1:
            raise HandoverError(f"a ring needs at least 1 slot, not {slots}")
        if platform.machine() not in ("x86_64", "AMD64"):
            raise HandoverError(f"the hand-over ring relies on the memory order of x86-64, not {platform.machine()}")
        size = _HEADER_BYTES + slots * SLOT_BYTES
        fd = os.memfd_create("fri-handover", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            try:
                os.posix_fallocate(fd, 0, size)
            except OSError as error:
                raise NoMemoryForHandover(size=size, error=error) from error
            # No process may shrink the file under another one's feet.
            fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
            header = struct.pack("@4Q", _MAGIC, _LAYOUT_VERSION, SLOT_BYTES, slots)
            os.pwrite(fd, header, 0)
            os.pwrite(fd, struct.pack("@q", _epoch_offset_ns()), _W_EPOCH_OFFSET * 8)
            return cls(fd, owns_fd=True)
        except BaseException:
            os.close(fd)
            raise

    @classmethod
    def attach(cls, fd: int) -> HandoverRing:
        """Map the ring behind an inherited descriptor; the descriptor stays the caller's. Raises HandoverError."""
        try:
            return cls(fd, owns_fd=False)
        except OSError as error:
            raise HandoverError(f"descriptor {fd} cannot be mapped as a hand-over ring: {error.strerror}") from error

    def close(self) -> None:
        """Unmap; the memory itself lives on while any process has its descriptor open."""
        for view in ("_words", "_signed_words", "_status", "_bytes"):
            if hasattr(self, view):
                getattr(self, view).release()
        self._map.close()
        if self._owns_fd:
            os.close(self.fd)
            self._owns_fd = False

    # The producer's side: the loop, and nobody else.

    def push(
        self,
        receive_ns: int,
        send_ns: int,
        phase: int,
        period: int,
        sample_in_period: int,
        monitoring: bytes | bytearray | memoryview,
        command: bytes | bytearray | memoryview | None,
        event_code: int = 0,
        event_joint: int = 0,
        event_value: float = 0.0,
        event_limit: float = 0.0,
        disposition: int = 0,
    ) -> bool:
        """Publish one record. Returns False, and counts it as lost, when the ring is full; never waits."""
        words = self._words
        index = self._attempted
        self._attempted = index + 1
        words[_W_ATTEMPTED] = index + 1
        produced = self._produced
        if produced - words[_W_CONSUMED] >= self.slots:
            words[_W_LOST] += 1
            return False
        start = _HEADER_BYTES + produced % self.slots * SLOT_BYTES
        monitoring_length = len(monitoring)
        if monitoring_length > MONITORING_CAPACITY:
            monitoring_length = MONITORING_CAPACITY
            monitoring = monitoring[:MONITORING_CAPACITY]
        # A command is stored with its length plus one, so that "not answered" and "empty" stay apart.
        command_mark = 0 if command is None else min(len(command), COMMAND_CAPACITY) + 1
        _SLOT.pack_into(
            self._bytes, start, index, receive_ns, send_ns, phase, period, sample_in_period, event_code, event_joint,
            disposition, event_value, event_limit, monitoring_length, command_mark, 0,
        )  # fmt: skip
        place = start + _PAYLOAD_OFFSET
        if monitoring_length:
            self._bytes[place : place + monitoring_length] = monitoring
        if command is not None:
            place += MONITORING_CAPACITY
            self._bytes[place : place + command_mark - 1] = command[: command_mark - 1]
        self._produced = produced + 1
        words[_W_PRODUCED] = produced + 1
        return True

    def publish_status(self, status: tuple[int, ...]) -> None:
        """Store the loop's status: the 17 integers of LoopStatus in its order. Readers may see a mix of two ticks, but
        no zeros: `pack_into` clears its target first, and a recorder that reads a zero time takes the loop for dead.
        """
        _STATUS.pack_into(self._next_status, 0, *status)
        self._status[:] = self._next_status

    def publish_reason(self, sentence: str) -> None:
        """Store why the loop stops or stopped, in one sentence (cut at 2000 bytes)."""
        self._write_text(sentence, _REASON_OFFSET, _REASON_CAPACITY)

    def publish_hindrance(self, clause: str) -> None:
        """Store why no motion begins yet, as a clause (cut at 328 bytes); empty where nothing hinders it."""
        self._write_text(clause, _HINDRANCE_OFFSET, _HINDRANCE_CAPACITY)

    def _write_text(self, text: str, offset: int, capacity: int) -> None:
        data = text.encode()[:capacity]
        self._bytes[offset + 8 : offset + 8 + len(data)] = data
        self._words[offset // 8] = len(data)

    def finish(self) -> None:
        """Say that no record will follow; the consumer ends once it has read the rest."""
        self._words[_W_CLOSED] = 1

    @property
    def consumer_stalled(self) -> bool:
        """True when the backlog is beyond 80 % of the ring: the recorder is gone or cannot follow."""
        return self._produced - self._words[_W_CONSUMED] > self._stop_level

    # The consumer's side: the recorder, and nobody else.

    def read_batch(self, max_records: int = 1024) -> list[HandoverRecord]:
        """Copy out up to `max_records` records not read yet, oldest first; their slots stay taken until `release`.

        A recorder that is killed before `release` leaves its records to the next one that attaches.
        """
        produced = self._words[_W_PRODUCED]
        end = min(produced, self._cursor + max_records)
        records = [self._record(position) for position in range(self._cursor, end)]
        self._cursor = end
        return records

    def newest(self, count: int) -> list[HandoverRecord]:
        """Copies of the newest `count` records, oldest first, released or not; only while no producer is at work."""
        produced = self._words[_W_PRODUCED]
        return [self._record(position) for position in range(max(0, produced - min(count, self.slots)), produced)]

    def release(self) -> None:
        """Give back the slots of all records read so far (call it when they are safe)."""
        self._words[_W_CONSUMED] = self._cursor

    def _record(self, position: int) -> HandoverRecord:
        start = _HEADER_BYTES + position % self.slots * SLOT_BYTES
        (
            index, receive_ns, send_ns, phase, period, sample_in_period, event_code, event_joint, disposition,
            event_value, event_limit, monitoring_length, command_mark, _,
        ) = _SLOT.unpack_from(self._bytes, start)  # fmt: skip
        place = start + _PAYLOAD_OFFSET
        monitoring = bytes(self._bytes[place : place + monitoring_length])
        place += MONITORING_CAPACITY
        command = bytes(self._bytes[place : place + command_mark - 1]) if command_mark else None
        return HandoverRecord(
            index, receive_ns, send_ns, phase, period, sample_in_period, event_code, event_joint, event_value,
            event_limit, monitoring, command, disposition,
        )  # fmt: skip

    @property
    def backlog(self) -> int:
        """Records published and not released yet."""
        return int(self._words[_W_PRODUCED] - self._words[_W_CONSUMED])

    @property
    def produced(self) -> int:
        """Records published so far."""
        return int(self._words[_W_PRODUCED])

    @property
    def lost(self) -> int:
        """Records that found the ring full, so far."""
        return int(self._words[_W_LOST])

    @property
    def finished(self) -> bool:
        """True once the loop said that no record will follow."""
        return bool(self._words[_W_CLOSED])

    # The supervisor's side.

    def request_stop(self, code: int = EventCode.OPERATOR_STOP) -> None:
        """Ask the loop for a stop ramp for a stop reason of EventCode; it obeys at its next tick, whoever lives."""
        self._words[_W_STOP_REQUEST] = int(code)

    @property
    def stop_request(self) -> int:
        """The stop reason asked for, 0 when none."""
        return int(self._words[_W_STOP_REQUEST])

    def beat(self, monotonic_ns: int | None = None) -> None:
        """The supervisor lives (call it a few times a second; 0 s since `create` means: not supervised)."""
        self._words[_W_HEARTBEAT] = time.monotonic_ns() if monotonic_ns is None else monotonic_ns

    @property
    def heartbeat_ns(self) -> int:
        """CLOCK_MONOTONIC of the supervisor's last beat; 0 when it never beat, then nobody supervises."""
        return int(self._words[_W_HEARTBEAT])

    @property
    def epoch_offset_ns(self) -> int:
        """What to add to CLOCK_MONOTONIC to get Unix time, both in ns, as measured at creation."""
        return int(self._signed_words[_W_EPOCH_OFFSET])

    @property
    def status(self) -> LoopStatus:
        """What the loop last said of itself."""
        return LoopStatus(*_STATUS.unpack_from(self._bytes, _STATUS_OFFSET))

    @property
    def reason(self) -> str:
        """Why the loop stops or stopped; empty while it does not."""
        return self._read_text(_REASON_OFFSET, _REASON_CAPACITY)

    @property
    def hindrance(self) -> str:
        """Why no motion begins yet, as a clause; empty where the loop has nothing against it."""
        return self._read_text(_HINDRANCE_OFFSET, _HINDRANCE_CAPACITY)

    def _read_text(self, offset: int, capacity: int) -> str:
        length = min(int(self._words[offset // 8]), capacity)
        return bytes(self._bytes[offset + 8 : offset + 8 + length]).decode(errors="replace")


def _epoch_offset_ns() -> int:
    """Unix time minus CLOCK_MONOTONIC in ns: the tightest of a few bracketed readings."""
    best_width, best = None, 0
    for _ in range(16):
        before = time.monotonic_ns()
        epoch = time.time_ns()
        after = time.monotonic_ns()
        if best_width is None or after - before < best_width:
            best_width, best = after - before, epoch - (before + after) // 2
    return best
