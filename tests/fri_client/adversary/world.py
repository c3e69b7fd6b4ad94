"""A robot, a wire and a clock around the real loop, in simulated time, and what an adversary may do to them.

The world moves while the loop is in its channel: events of the robot and of the wire happen in the order of their
times. Every command that went out is shown to the judge with the robot time at which it arrives (or would have, where
the wire loses it). The robot is written out here; it shares nothing with the client but the codec.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from fixtures.judge import Judge, Judgement
from fri_client.errors import CodecError
from fri_client.handover.ring import EventCode, HandoverRing
from fri_client.loop.channel import Address
from fri_client.loop.loop import FriLoop
from fri_client.loop.result import LoopResult, LoopSettings
from fri_client.messages import (
    MONITORING_IDENTIFIER,
    ConnectionInfo,
    FriVersion,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    RobotInfo,
    TimeStamp,
)
from fri_client.motion.program import MotionProgram
from fri_client.wire.codec import Codec
from safety.limits import IIWA14_R820

ROBOT: Address = ("192.170.10.2", 30200)
STRANGER: Address = ("192.170.10.66", 4711)
READY, COMMANDING_WAIT, ACTIVE = 2, 3, 4
REST = np.array([0.1, 0.3, -0.1, -0.9, 0.2, 0.5, 0.05])
LATENCY_NS = 60_000
"""One way through the network."""
EPOCH_NS = 1_700_000_000_000_000_000
_MISSES_TOLERATED = 60
_US = 1_000


@cache
def table() -> np.ndarray:
    """One period of 1 s: sines at 55 to 65 % of each velocity limit, so that two steps in one cycle are beyond it."""
    phase = 2 * np.pi * (np.arange(1000)[:, None] / 1000.0 + np.arange(7) / 7.0)
    return REST + 0.6 * IIWA14_R820.velocity / (2 * np.pi) * np.sin(phase)


@dataclass(frozen=True)
class Move:
    """What is done at the robot's message number `at`, counted from the first in COMMANDING_ACTIVE; see `World._do`."""

    kind: str
    at: int
    count: int = 1
    value: float = 0.0
    where: str = ""


@dataclass(frozen=True)
class Setting:
    """How the robot sends. ipo_speed: rad/s of its own set-point, so that no motion may begin."""

    send_period_ms: int = 1
    receive_multiplier: int = 1
    version: FriVersion = FriVersion.V1_15
    ipo_speed: float = 0.0
    starts_active: bool = False
    duration_ms: int = 2500


class WorldOver(Exception):
    """The simulated time is over."""


@dataclass
class World:
    """Robot, wire and clock; also the loop's channel."""

    setting: Setting
    moves: tuple[Move, ...]
    now: int = 5_000_000_000
    _events: list[tuple[int, int, str, Any]] = field(default_factory=list)
    _inbox: list[tuple[bytes, Address]] = field(default_factory=list)
    _order: Any = field(default_factory=itertools.count)

    def __post_init__(self) -> None:
        self.codec = Codec(self.setting.version)
        self.period_ns = self.setting.send_period_ms * 1_000_000
        self.judge = Judge(self.period_ns * self.setting.receive_multiplier)
        self.state = ACTIVE if self.setting.starts_active else READY
        self.counter, self.sent_in_state, self.active_messages = 1000, 0, -1
        self.ipo = REST.copy()
        self.last = REST.copy()
        self.missed = self.refuse = 0
        self.answered = self.mirrored = False
        self.stall: tuple[str, int] | None = None
        self.stop_ns: int | None = None
        self.last_datagram = b""
        self.held_back: list[bytes] = []
        self.active_until: dict[str, tuple[int, Move]] = {}
        self.end_ns = self.now + self.setting.duration_ms * 1_000_000
        if self.state == ACTIVE:
            self._begin_active()
        self._at(self.now, "tick", None)  # cycles begin with a message

    # The loop's channel and clock.

    def __call__(self) -> int:
        self._stalls("clock")
        self.now += 300
        return self.now

    def receive_into(self, buffer: bytearray) -> tuple[int, Address]:
        self._stalls("receive")
        deadline = self.now + 50_000_000
        while not self._inbox:
            if self.now > self.end_ns:
                raise WorldOver
            if not self._events or self._events[0][0] > deadline:
                self.now = deadline
                raise BlockingIOError
            self._next_event()
        return self._take(buffer)

    def receive_waiting_into(self, buffer: bytearray) -> tuple[int, Address] | None:
        return self._take(buffer) if self.is_waiting() else None

    def is_waiting(self) -> bool:
        self._stalls("waiting")
        self.now += 1 * _US
        self._catch_up()
        return bool(self._inbox)

    def wait(self, seconds: float) -> bool:
        until = self.now + int(seconds * 1e9)
        while not self._inbox and self._events and self._events[0][0] <= until:
            self._next_event()
        if not self._inbox:
            self.now = max(self.now, until)
        return bool(self._inbox)

    def send(self, datagram: bytes, address: Address) -> bool:
        self.now += 5 * _US
        self._catch_up()
        if self.refuse > 0:
            self.refuse -= 1
            return False
        assert address == ROBOT, "an answer to somebody else"
        self._at(self.now + LATENCY_NS, "answer", datagram)
        return True

    def _take(self, buffer: bytearray) -> tuple[int, Address]:
        datagram, address = self._inbox.pop(0)
        size = min(len(datagram), len(buffer))
        buffer[:size] = datagram[:size]
        self.now += 5 * _US
        return size, address

    def _stalls(self, where: str) -> None:
        if self.stall is not None and self.stall[0] == where:
            self.now += self.stall[1]
            self.stall = None
            self._catch_up()

    # Events.

    def _at(self, time_ns: int, kind: str, what: Any) -> None:
        heapq.heappush(self._events, (time_ns, next(self._order), kind, what))

    def _catch_up(self) -> None:
        here = self.now
        while self._events and self._events[0][0] <= here:
            self._next_event()
        self.now = here

    def _next_event(self) -> None:
        time_ns, _, kind, what = heapq.heappop(self._events)
        self.now = max(self.now, time_ns)
        if kind == "tick":
            self._tick(time_ns)
        elif kind == "arrival":
            self._inbox.append(what)
        elif kind == "answer":
            self._answer(time_ns, what)

    # The robot.

    def _answer(self, time_ns: int, datagram: bytes) -> None:
        try:
            command = self.codec.decode_command(datagram)
        except CodecError as error:
            raise AssertionError("the loop sent what is no command") from error
        data = command.command_data
        position = None if data is None else data.joint_position
        if self.state == ACTIVE:
            if position is not None:
                self.judge.take(time_ns, position)
                if not self._is_on("lose_answer"):
                    self.last = np.array(position)
                    self.answered = True
        elif self.state == COMMANDING_WAIT and position is not None:
            self.mirrored = bool(np.abs(np.array(position) - self.ipo).max() <= 1e-4)

    def _begin_active(self) -> None:
        self.state, self.active_messages, self.missed = ACTIVE, 0, 0
        velocity = (self.setting.ipo_speed,) * 7
        self.judge.begin(self.now, tuple(self.ipo), velocity)

    def _leave(self, state: int) -> None:
        self.judge.end()
        self.state, self.sent_in_state = state, 0
        self.ipo = self.last.copy()

    def _tick(self, time_ns: int) -> None:
        """One cycle: what the robot does by itself, then its message."""
        self._at(time_ns + self.period_ns, "tick", None)
        self.counter += 1
        self.sent_in_state += 1
        if self.state == READY and self.sent_in_state > 5:
            self.state, self.sent_in_state, self.mirrored = COMMANDING_WAIT, 0, False
        elif self.state == COMMANDING_WAIT and self.sent_in_state > 12 and self.mirrored:
            self._begin_active()
        elif self.state == ACTIVE:
            self.active_messages += 1
            if self.active_messages % self.setting.receive_multiplier == 0:
                self.missed = 0 if self.answered else self.missed + 1
                self.answered = False
                if self.missed > _MISSES_TOLERATED:
                    self._leave(READY)
        if self.setting.ipo_speed and self.state >= COMMANDING_WAIT:
            self.ipo = self.ipo + self.setting.ipo_speed * self.period_ns * 1e-9
        claim: dict[str, Any] = {"state": self.state, "counter": self.counter, "stamp": EPOCH_NS + time_ns}
        delay = 0
        datagrams: list[bytes] | None = None
        for move in self.moves:
            if self.state == ACTIVE and move.at == self.active_messages:
                self.active_until[move.kind] = (self.active_messages + move.count, move)
        for kind, (until, move) in list(self.active_until.items()):
            if self.active_messages >= until or self.state != ACTIVE:
                del self.active_until[kind]
                continue
            datagrams, delay = self._do(move, claim, datagrams, delay, time_ns)
        if datagrams is None:
            datagrams = [self._message(**claim)]
        for datagram in datagrams:
            self._at(time_ns + LATENCY_NS + delay, "arrival", (datagram, ROBOT))
        self.last_datagram = datagrams[0] if datagrams else self.last_datagram

    def _is_on(self, kind: str) -> bool:
        return kind in self.active_until

    def _do(
        self, move: Move, claim: dict[str, Any], datagrams: list[bytes] | None, delay: int, time_ns: int
    ) -> tuple[list[bytes] | None, int]:
        """Change this cycle's message, or what is around it."""
        first = move.at == self.active_messages
        value = move.value
        match move.kind:
            case "lose":
                datagrams = []
            case "duplicate":
                message = self._message(**claim)
                datagrams = [message, message]
            case "late":
                delay += int(value * 1e6)
            case "jitter":
                share = np.random.default_rng([move.at, self.active_messages]).uniform(0.0, value)
                delay += int(share * self.period_ns)
            case "swap":
                self.held_back.append(self._message(**claim))
                datagrams = []
                if not first:
                    datagrams = [self.held_back[-1], self.held_back[0]]
            case "stall":
                if first:
                    self.stall = (move.where, int(value * 1e6))
            case "refuse":
                if first:
                    self.refuse = move.count
            case "stray":
                noise = bytes(int(b) for b in np.random.default_rng(move.at).integers(0, 256, 11 + move.count))
                sender = STRANGER if move.where == "stranger" else ROBOT
                self._at(time_ns + LATENCY_NS + int(value * 1e6), "arrival", (noise, sender))
            case "state":
                claim["state"] = int(value)
            case "counter":
                claim["counter"] = int(self.counter + value) & 0xFFFFFFFF
            case "counter_for_good":
                if first:
                    self.counter = int(self.counter + value) & 0xFFFFFFFF
                    claim["counter"] = self.counter
            case "stamp":
                claim["stamp"] += int(value * 1e6)
            case "forged":
                forged = claim | {"counter": self.counter + move.count, "stamp": claim["stamp"] + self.period_ns}
                at = time_ns + LATENCY_NS + int(value * self.period_ns)
                self._at(at, "arrival", (self._message(**forged), ROBOT))
            case "stale":
                if first and self.last_datagram:
                    at = time_ns + LATENCY_NS + int(value * 1e6)
                    self._at(at, "arrival", (self.last_datagram, ROBOT))
            case "period":
                claim["period"] = int(value)
            case "ipo":
                claim["ipo"] = tuple(self.ipo + value)
            case "quality":
                claim["quality"] = int(value)
            case "safety":
                claim["safety"] = 1
            case "leave":
                if first:
                    self._leave(READY)
                    claim["state"] = READY
            case "stop":
                if first:
                    self.stop_ns = time_ns
        return datagrams, delay

    def _message(self, state: int, counter: int, stamp: int, **claim: Any) -> bytes:
        setting = self.setting
        ipo = claim.get("ipo", tuple(self.ipo.tolist())) if state >= COMMANDING_WAIT else None
        measured = tuple(self.last.tolist()) if self.state == ACTIVE else tuple(self.ipo.tolist())
        return self.codec.encode_monitoring(
            MonitoringMessage(
                MessageHeader(MONITORING_IDENTIFIER, counter & 0xFFFFFFFF, 0),
                RobotInfo(7, claim.get("safety", 0), (2,) * 7, 2, 0),
                MonitorData(
                    measured, (0.0,) * 7, measured if setting.version.major == 1 else None, None, (0.0,) * 7,
                    timestamp=TimeStamp((stamp // 10**9) & 0xFFFFFFFF, stamp % 10**9),
                ),
                ConnectionInfo(
                    state, claim.get("quality", 3), claim.get("period", setting.send_period_ms),
                    setting.receive_multiplier,
                ),
                IpoData(ipo, client_command_mode=1),
            )
        )  # fmt: skip


@dataclass
class Outcome:
    """What came of one sequence: the judgement, and how the loop ended (None: the simulated time was over)."""

    judgement: Judgement
    result: LoopResult | None
    loop: FriLoop


def play(setting: Setting, moves: tuple[Move, ...]) -> Outcome:
    """Drive the real loop through one sequence of moves."""
    world = World(setting, moves)

    def make(command_period_s: float, samples_per_command: int) -> MotionProgram:
        return MotionProgram(
            table(), IIWA14_R820, command_period_s=command_period_s, samples_per_command=samples_per_command,
            periods=2, lead_in_s=0.1, external_torque_limit=(60.0,) * 7,
        )  # fmt: skip

    ring = HandoverRing.create(64)
    try:
        loop = FriLoop(world, FriVersion(setting.version), make, ring, LoopSettings(start_timeout_s=1.0), world)

        def record(*_: Any) -> None:
            # Handing over is where a stop asked for from outside is seen; nobody reads this ring.
            if world.stop_ns is not None and world.now >= world.stop_ns:
                ring.request_stop(EventCode.OPERATOR_STOP)

        loop._journal.record = record  # type: ignore[method-assign, assignment]
        result = None
        with contextlib.suppress(WorldOver):
            result = loop.run()
        return Outcome(world.judge.judgement(), result, loop)
    finally:
        ring.close()
