"""A network and a clock that only a test moves: what the loop is given in place of a socket and CLOCK_MONOTONIC."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from fri_client.loop.channel import Address

ROBOT: Address = ("robot", 30200)
STRANGER: Address = ("stranger", 4711)


@dataclass
class SimulatedClock:
    """CLOCK_MONOTONIC in ns."""

    now: int = 1_000_000_000

    def __call__(self) -> int:
        return self.now


@dataclass
class SimulatedChannel:
    """inbox: datagrams that have arrived, with their senders; sent: what left, with its time; refuse: so many of the
    next datagrams does the network not take.
    """

    clock: SimulatedClock
    inbox: deque[tuple[bytes, Address]] = field(default_factory=deque)
    sent: list[tuple[int, bytes, Address]] = field(default_factory=list)
    refuse: int = 0

    def receive_into(self, buffer: bytearray) -> tuple[int, Address]:
        if not self.inbox:
            self.clock.now += 50_000_000
            raise BlockingIOError
        datagram, address = self.inbox.popleft()
        size = min(len(datagram), len(buffer))
        buffer[:size] = datagram[:size]
        return size, address

    def receive_waiting_into(self, buffer: bytearray) -> tuple[int, Address] | None:
        return self.receive_into(buffer) if self.inbox else None

    def is_waiting(self) -> bool:
        return bool(self.inbox)

    def wait(self, seconds: float) -> bool:
        del seconds
        return bool(self.inbox)

    def send(self, datagram: bytes, address: Address) -> bool:
        if self.refuse > 0:
            self.refuse -= 1
            return False
        self.sent.append((self.clock.now, datagram, address))
        return True
