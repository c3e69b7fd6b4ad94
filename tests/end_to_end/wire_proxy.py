"""`python -m tests.end_to_end.wire_proxy`: a bad wire between fake robot and client, in both directions, seeded.

Prints the port the robot has to send to. Datagrams of both directions go through one queue each that keeps the order
but for `reorder`; nothing of FRI is known here.
"""

from __future__ import annotations

import argparse
import heapq
import select
import signal
import socket
import sys
import time

import numpy as np

TROUBLES = {
    "loss": "datagrams are lost",
    "delay": "datagrams come 12 ms late and hold up those behind them",
    "jitter": "datagrams come 0 to 8 ms late and hold up those behind them",
    "duplicate": "datagrams come twice",
    "reorder": "datagrams come after the next one",
    "garbage": "datagrams become random bytes or are cut in half",
    "flip": "datagrams to the client have one byte flipped (UDP's own checksum would catch most)",
}
DELAY_S = 0.012
JITTER_S = 0.008


class Direction:
    """One direction of the wire: what becomes of each datagram, and when it is due."""

    def __init__(self, trouble: str, share: float, seed: tuple[int, int], to_client: bool) -> None:
        self._trouble = trouble if to_client or trouble != "flip" else "none"
        self._share = share
        self._random = np.random.default_rng(seed)
        self._queue: list[tuple[float, int, bytes]] = []
        self._number = 0
        self._latest = 0.0
        self._held_back: bytes | None = None

    def take(self, datagram: bytes, now: float) -> None:
        hit = self._random.random() < self._share
        if not hit or self._trouble == "none":
            self._put(datagram, now)
        elif self._trouble == "reorder":
            if self._held_back is None:
                self._held_back = datagram
                return
            self._put(datagram, now)
        elif self._trouble == "duplicate":
            self._put(datagram, now)
            self._put(datagram, now)
        elif self._trouble == "delay":
            self._put(datagram, now + DELAY_S)
        elif self._trouble == "jitter":
            self._put(datagram, now + JITTER_S * self._random.random())
        elif self._trouble == "garbage":
            noise, half = self._random.bytes(len(datagram)), datagram[: len(datagram) // 2]
            self._put(noise if self._random.random() < 0.5 else half, now)
        elif self._trouble == "flip":
            flipped = bytearray(datagram)
            flipped[int(self._random.integers(len(flipped)))] ^= 1 << int(self._random.integers(8))
            self._put(bytes(flipped), now)
        if self._held_back is not None:
            self._put(self._held_back, now)
            self._held_back = None

    def due(self, now: float) -> list[bytes]:
        result = []
        while self._queue and self._queue[0][0] <= now:
            result.append(heapq.heappop(self._queue)[2])
        return result

    def wait_s(self, now: float) -> float:
        return max(0.0, self._queue[0][0] - now) if self._queue else 1.0

    def _put(self, datagram: bytes, at: float) -> None:
        self._latest = max(self._latest, at)
        self._number += 1
        heapq.heappush(self._queue, (self._latest, self._number, datagram))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--client-port", type=int, required=True)
    parser.add_argument("--trouble", choices=list(TROUBLES), required=True)
    parser.add_argument("--share", type=float, required=True)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    to_robot, to_client = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for each in (to_robot, to_client):
        each.bind(("127.0.0.1", 0))
        each.setblocking(False)
    print(to_robot.getsockname()[1], flush=True)
    forth = Direction(options.trouble, options.share, (options.seed, 0), to_client=True)
    back = Direction(options.trouble, options.share, (options.seed, 1), to_client=False)
    robot: tuple[str, int] | None = None
    while True:
        now = time.monotonic()
        select.select([to_robot, to_client], [], [], min(forth.wait_s(now), back.wait_s(now)))
        for source, direction in ((to_robot, forth), (to_client, back)):
            while True:
                try:
                    datagram, sender = source.recvfrom(2048)
                except OSError:  # nothing there, or the other end is gone
                    break
                robot = sender if source is to_robot else robot
                direction.take(datagram, time.monotonic())
        now = time.monotonic()
        for datagram in forth.due(now):
            to_client.sendto(datagram, ("127.0.0.1", options.client_port))
        for datagram in back.due(now):
            if robot is not None:
                to_robot.sendto(datagram, robot)


if __name__ == "__main__":
    sys.exit(main())
