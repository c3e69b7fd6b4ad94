"""Robot, bad wire and loop in simulated time: the fake robot's session and the proxy's troubles, no socket, no clock.

Robot and loop each run as they are, in threads of their own of which one runs at a time: the loop until it waits for a
message, the robot until it waits for an answer or for its next cycle. Time is what both wait for, so nothing here
depends on the machine, and a seed gives the same run to the last bit.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from fixtures.fake_robot.server import FakeRobot
from fri_client.loop.channel import Address
from tests.end_to_end.wire_proxy import Direction
from tests.watchdog import WATCHDOG_S

__all__ = ["SimulatedWire"]

ROBOT: Address = ("robot", 30200)
POLL_NS = 50_000_000
"""After so long without a message the loop's channel says that there is none, as the real one does."""
EPOCH_S = 1_700_000_000.0


@dataclass
class SimulatedWire:
    """The loop's channel and clock; `link` is the robot's end."""

    trouble: str
    share: float
    seed: int
    now_ns: int = 1_000_000_000
    beside: Callable[[], None] = lambda: None
    """Called in each of the robot's cycles, for what other processes do beside the loop."""
    held_up: tuple[int, int] | None = None
    """Every so many waits the robot's process wakes up so much later than it wanted to, ns."""

    def __post_init__(self) -> None:
        self._forth = Direction(self.trouble, self.share, (self.seed, 0), to_client=True)
        self._back = Direction(self.trouble, self.share, (self.seed, 1), to_client=False)
        self._inbox: deque[bytes] = deque()
        self._robot_wakes_ns: int | None = self.now_ns
        self._robot_hears = False
        self._robots_turn, self._loops_turn = threading.Semaphore(0), threading.Semaphore(0)
        self._failure: BaseException | None = None
        self.link = RobotEnd(self)

    @contextmanager
    def robot(self, robot: FakeRobot) -> Iterator[dict[str, Any]]:
        """The robot's session, as long as the block runs a loop; the summary is filled in when the block ends."""
        summary: dict[str, Any] = {}

        def serve() -> None:
            self._robots_turn.acquire()
            try:
                summary.update(robot.run())
            except BaseException as error:
                self._failure = error
            self._robot_wakes_ns = None
            self._loops_turn.release()

        thread = threading.Thread(target=serve, name="fake robot", daemon=True)
        thread.start()
        try:
            yield summary
        finally:
            robot.stop("ended by the test")
            while self._robot_wakes_ns is not None:
                self.now_ns = max(self.now_ns, self._robot_wakes_ns)
                self._let_the_robot_run()
            thread.join()

    # The loop's clock and channel.

    def __call__(self) -> int:
        return self.now_ns

    def receive_into(self, buffer: bytearray) -> tuple[int, Address]:
        if not self._pass_time(self.now_ns + POLL_NS):
            raise BlockingIOError
        datagram = self._inbox.popleft()
        size = min(len(datagram), len(buffer))
        buffer[:size] = datagram[:size]
        return size, ROBOT

    def receive_waiting_into(self, buffer: bytearray) -> tuple[int, Address] | None:
        return self.receive_into(buffer) if self.is_waiting() else None

    def is_waiting(self) -> bool:
        self._inbox.extend(self._forth.due(self.now_ns * 1e-9))
        return bool(self._inbox)

    def wait(self, seconds: float) -> bool:
        return self._pass_time(self.now_ns + int(seconds * 1e9))

    def send(self, datagram: bytes, address: Address) -> bool:
        assert address == ROBOT
        self._back.take(datagram, self.now_ns * 1e-9)
        return True

    def _pass_time(self, until_ns: int) -> bool:
        """Let time pass until a message for the loop is there or `until_ns`; whether one is."""
        while not self.is_waiting():
            due = [until_ns, self.now_ns + _ns(self._forth.wait_s(self.now_ns * 1e-9))]
            if self._robot_wakes_ns is not None:
                due.append(self._robot_wakes_ns)
                if self._robot_hears:
                    due.append(self.now_ns + _ns(self._back.wait_s(self.now_ns * 1e-9)))
            self.now_ns = max(self.now_ns, min(due))
            answered = self._robot_hears and self._back.wait_s(self.now_ns * 1e-9) <= 0.0
            if self._robot_wakes_ns is not None and (answered or self.now_ns >= self._robot_wakes_ns):
                self._let_the_robot_run()
            elif self.now_ns >= until_ns and not self.is_waiting():
                return False
        return True

    # Whose turn it is.

    def _let_the_robot_run(self) -> None:
        self.beside()
        self._robots_turn.release()
        assert self._loops_turn.acquire(timeout=WATCHDOG_S), "the robot hangs"
        if self._failure is not None:
            raise self._failure

    def let_the_loop_run(self, until_ns: int, *, hears: bool) -> None:
        """Called by the robot: nothing to do until then, or until an answer comes."""
        self._robot_wakes_ns, self._robot_hears = until_ns, hears
        self._loops_turn.release()
        assert self._robots_turn.acquire(timeout=WATCHDOG_S), "the loop hangs"


class RobotEnd:
    """See `fixtures.fake_robot.link.Link`."""

    port = ROBOT[1]
    foreign = 0
    send_failures = 0

    def __init__(self, wire: SimulatedWire) -> None:
        self._wire = wire
        self._arrived: deque[bytes] = deque()
        self._waits = 0

    def now_ns(self) -> int:
        return self._wire.now_ns

    def unix_time_s(self) -> float:
        return EPOCH_S + self._wire.now_ns * 1e-9

    def wait_until(self, deadline_ns: int) -> None:
        self._waits += 1
        if self._wire.held_up is not None and self._waits % self._wire.held_up[0] == 0:
            deadline_ns += self._wire.held_up[1]
        while self._wire.now_ns < deadline_ns:
            self._wire.let_the_loop_run(deadline_ns, hears=False)

    def send(self, datagram: bytes) -> None:
        self._wire._forth.take(datagram, self._wire.now_ns * 1e-9)

    def send_from_another_port(self, datagram: bytes) -> None:
        raise NotImplementedError

    def receive(self, deadline_ns: int) -> bytes | None:
        while True:
            self._arrived.extend(self._wire._back.due(self._wire.now_ns * 1e-9))
            if self._arrived:
                return self._arrived.popleft()
            if self._wire.now_ns >= deadline_ns:
                return None
            self._wire.let_the_loop_run(deadline_ns, hears=True)

    def interrupt(self) -> None:
        pass

    def close(self) -> None:
        pass


def _ns(seconds: float) -> int:
    return int(seconds * 1e9) + 1
