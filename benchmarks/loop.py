"""How long our loop holds an answer back, beside a bare UDP echo, a C++ client and a plain google.protobuf client.

Reproduce: `python -m benchmarks.loop` (60 s per contender; `--quick`: 10 s; `--help`: FRI version, seconds, block).
One scripted robot in a process of its own sends prepared monitoring messages at 1 kHz on loopback and times each round
trip (send to reply received). The contenders take turns in short blocks, so that a drift of the machine meets all
alike; each block is a fresh process with the same real-time settings and the same socket. Turn-around is receive return
to send return inside that process. Contenders:

  echo      receives and sends the datagram back.
  cpp       a C++ client as the vendor's (`client.cpp`): decodes all fields, answers with the IPO position. No checks,
            no statistics, no record. Left out where there is no compiler, and for FRI 2.7.
  protobuf  google.protobuf (upb): parses the message, reads counter, state, quality, safety state, measured and IPO
            position, answers with the IPO position. No checks, no statistics, no record.
  codec     our codec used the same way: decode all, read the same fields, encode the answer.
  loop      FriLoop as it runs in the loop process: strict decoding, session, motion, guard, statistics, hand-over.
"""

from __future__ import annotations

import argparse
import gc
import multiprocessing
import os
import socket
import tempfile
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.compiled_client import compile_client, serve
from fixtures.fake_robot.link import real_time, sharpen_timers
from fixtures.fake_robot.wire import COMMAND_IDENTIFIER, Datagrams
from fri_client.handover.ring import HandoverRing
from fri_client.loop.answer_ahead import AnswerAhead
from fri_client.loop.channel import UdpChannel
from fri_client.loop.loop import FriLoop
from fri_client.loop.result import LoopSettings
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
from fri_client.realtime import RealtimeSettings, realtime
from fri_client.wire.codec import Codec
from safety.limits import IIWA14_R820

CONTENDERS = ("echo", "cpp", "protobuf", "codec", "plain", "loop")
PERIOD_NS = 1_000_000
REST = np.array([0.1, 0.3, -0.1, -0.9, 0.2, 0.5, 0.05])
PREFACE = ((1, 50), (2, 50), (3, 400))
"""Messages per session state before COMMANDING_ACTIVE."""
SETTLING = 2000
"""Messages in COMMANDING_ACTIVE that are not counted: start ramp and lead-in."""
AWAKE_NS = 100_000
"""The robot's process wakes so much before a message is due: a sleep ends up to so much late."""


def script(version: FriVersion, block_s: float, seed: int) -> list[bytes]:
    """Every monitoring datagram of one block; all numbers change as they do on a robot."""
    generator = np.random.default_rng(seed)
    codec = Codec(version)
    states = [state for state, count in PREFACE for _ in range(count)]
    states += [4] * (SETTLING + round(block_s * 1000))
    noise = generator.normal(0.0, 1e-5, (len(states), 7))
    angle = 2 * np.pi * np.arange(len(states)) / 3000.0
    measured = (REST + 0.01 * np.sin(angle)[:, None] + noise).tolist()
    torque = (10.0 * np.cos(angle)[:, None] + 1e4 * noise).tolist()
    external = (1e4 * noise).tolist()
    datagrams = []
    rest = tuple(REST.tolist())
    for index, state in enumerate(states):
        monitor = MonitorData(
            tuple(measured[index]),
            tuple(torque[index]),
            rest if version.major == 1 else None,
            tuple(torque[index]),
            tuple(external[index]),
            timestamp=TimeStamp(1_700_000_000 + index // 1000, index % 1000 * 1_000_000 + 12_345),
        )
        message = MonitoringMessage(
            MessageHeader(MONITORING_IDENTIFIER, 100 + index, max(0, index - 1)),
            RobotInfo(7, 0, (2,) * 7, 2, 0),
            monitor,
            ConnectionInfo(state, 3, 1, 1),
            IpoData(rest if state >= 3 else None, None, None, 1, 1, 1.0),
        )
        datagrams.append(codec.encode_monitoring(message))
    return datagrams


# The robot's side.


def robot_side(pipe: Connection, version: FriVersion, block_s: float, seed: int) -> None:
    """Process: for each address that comes through the pipe, play the script and send the round trips (ns) back."""
    datagrams = script(version, block_s, seed)
    sharpen_timers()
    with real_time(70):
        _use_cpu(0)
        gc.disable()
        pipe.send(len(datagrams[-1]))
        while (address := pipe.recv()) is not None:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as channel:
                channel.bind(("127.0.0.1", 0))
                channel.setblocking(False)
                pipe.send(_play(channel, address, datagrams))


def _play(channel: socket.socket, address: tuple[str, int], datagrams: list[bytes]) -> NDArray[np.int64]:
    """Send at 1 kHz by the clock, as a cabinet does, answered or not; a reply that comes after the next message counts
    as lost (-1).

    Turning while it waits for the reply, as a network card would: its own wake-up is then in no figure, and the
    client's send does not pay for it. Its wake-up before a send is turned away as well, so that a message is late only
    where the machine held this process up.
    """
    clock, buffer = time.monotonic_ns, bytearray(2048)
    round_trip = np.full(len(datagrams), -1, dtype=np.int64)
    due = clock() + 20 * PERIOD_NS
    for index, datagram in enumerate(datagrams):
        rest = due - clock() - AWAKE_NS
        if rest > 0:
            time.sleep(rest / 1e9)
        while clock() < due:
            pass
        _drain(channel, buffer)
        due += PERIOD_NS
        sent = clock()
        channel.sendto(datagram, address)
        while clock() < due - AWAKE_NS:
            try:
                channel.recvfrom_into(buffer)
            except BlockingIOError:
                continue
            round_trip[index] = clock() - sent
            break
    return round_trip[-(len(datagrams) - SETTLING - sum(count for _, count in PREFACE)) :]


def _drain(channel: socket.socket, buffer: bytearray) -> None:
    """Throw away replies that came too late."""
    while True:
        try:
            channel.recvfrom_into(buffer)
        except BlockingIOError:
            return


# The client's side.


def client_side(
    pipe: Connection, contender: str, version: FriVersion, block_s: float, program: Path | None = None
) -> None:
    """Process: one contender for one block; sends its address, then its turn-arounds (ns) and what realtime refused."""
    channel = UdpChannel()
    channel.bind("127.0.0.1", 0)
    total = SETTLING + round(block_s * 1000) + sum(count for _, count in PREFACE)
    run: Callable[[], NDArray[np.int64]]
    if contender in ("loop", "plain"):
        run = _prepare_loop(channel, version, total, answer_ahead=contender == "loop")
    elif program is not None and contender == "cpp":

        def run() -> NDArray[np.int64]:
            return serve(program, channel.fileno(), total)

    else:
        respond = {"echo": _echo, "protobuf": _protobuf, "codec": _codec}[contender](version)

        def run() -> NDArray[np.int64]:
            return _serve(channel, respond, total)

    with channel, realtime(RealtimeSettings(priority=80, cpus=_cpus(1))) as obtained:
        pipe.send(channel.address)
        turn_around = run()
    refused = [f"{item.name}: {item.detail}" for item in obtained.items if item.wanted and not item.obtained]
    pipe.send((turn_around[-round(block_s * 1000) :], refused))


def _serve(channel: UdpChannel, respond: Callable[[memoryview], Any], total: int) -> NDArray[np.int64]:
    """The same blocking receive as the loop's, the answer, and nothing else."""
    buffer, clock = bytearray(2048), time.monotonic_ns
    view = memoryview(buffer)
    turn_around = np.zeros(total, dtype=np.int64)
    index = silent = 0
    while index < total and silent < 40:
        try:
            size, address = channel.receive_into(buffer)
        except BlockingIOError:
            silent += index > 0
            continue
        received = clock()
        channel.send(respond(view[:size]), address)
        turn_around[index] = clock() - received
        index += 1
        silent = 0
    return turn_around[:index]


def _echo(_: FriVersion) -> Callable[[memoryview], Any]:
    return lambda datagram: datagram


def _protobuf(version: FriVersion) -> Callable[[memoryview], Any]:
    datagrams = Datagrams(version)
    monitoring, command = datagrams.new("monitoring"), datagrams.new("command")
    command.header.messageIdentifier = COMMAND_IDENTIFIER
    counter = 0

    def respond(datagram: memoryview) -> bytes:
        nonlocal counter
        monitoring.ParseFromString(datagrams._unframe(bytes(datagram)))
        connection = monitoring.connectionInfo
        measured = tuple(monitoring.monitorData.measuredJointPosition.value)
        position = tuple(monitoring.ipoData.jointPosition.value)
        header = command.header
        header.sequenceCounter = counter
        header.reflectedSequenceCounter = monitoring.header.sequenceCounter
        in_command = connection.sessionState >= 3 and connection.quality >= 0
        if in_command and measured and not monitoring.robotInfo.safetyState:
            command.commandData.jointPosition.value[:] = position
        counter += 1
        return datagrams.frame(command.SerializeToString())

    return respond


def _codec(version: FriVersion) -> Callable[[memoryview], Any]:
    codec = Codec(version)
    counter = 0

    def respond(datagram: memoryview) -> bytes:
        nonlocal counter
        message = codec.decode_monitoring(datagram)
        connection, robot, monitor, ipo = (
            message.connection_info,
            message.robot_info,
            message.monitor_data,
            message.ipo_data,
        )
        assert connection is not None
        assert robot is not None
        assert monitor is not None
        assert ipo is not None
        position = ipo.joint_position if connection.session_state >= 3 else monitor.measured_joint_position
        assert connection.quality >= 0
        assert not robot.safety_state
        assert position is not None
        counter += 1
        return codec.encode_position_command(counter - 1, message.header.sequence_counter, position)

    return respond


class _NothingReady(AnswerAhead):
    """No answer is made ready: every message goes the whole way before it is answered."""

    def prepare(self, *_: object) -> None:
        """Nothing."""


def _prepare_loop(
    channel: UdpChannel, version: FriVersion, total: int, *, answer_ahead: bool
) -> Callable[[], NDArray[np.int64]]:
    ring = HandoverRing.create(2 * total)
    angle = 2 * np.pi * np.arange(3000) / 3000.0
    table = REST + 0.01 * np.sin(angle)[:, None]

    def make(command_period_s: float, samples_per_command: int) -> MotionProgram:
        return MotionProgram(
            table,
            IIWA14_R820,
            command_period_s=command_period_s,
            samples_per_command=samples_per_command,
            periods=1000,
            lead_in_s=0.5,
            external_torque_limit=(50.0,) * 7,
        )

    loop = FriLoop(channel, version, make, ring, LoopSettings(receive_timeout_s=0.3))
    if not answer_ahead:
        loop._ahead = _NothingReady(loop._codec)

    def run() -> NDArray[np.int64]:
        result = loop.run()  # ends by the robot's silence
        counts = loop.session.counts
        if result.reason != "SILENCE" or counts.missing:
            print(f"  loop: {result.reason}, {counts.missing} missing, {result.late} late: {result.sentence}")
        records = ring.read_batch(2 * total)
        return np.array([record.send_ns - record.receive_ns for record in records if record.command is not None])

    return run


def _cpus(number: int) -> tuple[int, ...] | None:
    available = sorted(os.sched_getaffinity(0))
    return (available[number],) if len(available) > number else None


def _use_cpu(number: int) -> None:
    cpus = _cpus(number)
    if cpus is not None:
        os.sched_setaffinity(0, cpus)


# Both together.


def main() -> None:
    """Parse, run the blocks in turn, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="measured time per contender")
    parser.add_argument("--block", type=float, default=10.0, help="s per turn")
    parser.add_argument("--quick", action="store_true", help="10 s per contender in blocks of 2.5 s")
    parser.add_argument("--fri-version", default="1.15")
    parser.add_argument("--only", choices=CONTENDERS, nargs="*", default=CONTENDERS)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.seconds, arguments.block = 10.0, 2.5
    version = FriVersion.parse(arguments.fri_version)
    blocks = max(1, round(arguments.seconds / arguments.block))
    context = multiprocessing.get_context("spawn")
    pipe, far_end = context.Pipe()
    robot = context.Process(target=robot_side, args=(far_end, version, arguments.block, arguments.seed), daemon=True)
    robot.start()
    size = pipe.recv()
    scratch = tempfile.TemporaryDirectory(prefix="iiwa-ident-benchmark-")
    program = compile_client(Path(scratch.name)) if version != FriVersion.V2_7 else None
    contenders = [name for name in arguments.only if name != "cpp" or program is not None]
    if len(contenders) < len(arguments.only):
        print("cpp is left out: there is no C++ compiler, or the version is 2.7.")
    print(f"FRI {version}, {size} bytes, 1 kHz, {blocks} × {arguments.block:g} s per contender, in turns")
    print(f"machine: {os.cpu_count()} CPUs, load {_load()} before")
    turn_around: dict[str, list[NDArray[np.int64]]] = {name: [] for name in contenders}
    round_trip: dict[str, list[NDArray[np.int64]]] = {name: [] for name in contenders}
    refused: set[str] = set()
    for block in range(blocks):
        # Each turn in another order: who follows whom is not always the same.
        for name in np.roll(contenders, block).tolist():
            near, far = context.Pipe()
            client = context.Process(target=client_side, args=(far, name, version, arguments.block, program))
            client.start()
            pipe.send(near.recv())
            round_trip[name].append(pipe.recv())
            inside, wants = near.recv()
            client.join()
            turn_around[name].append(inside)
            refused.update(wants)
    pipe.send(None)
    robot.join()
    scratch.cleanup()
    print(f"machine: load {_load()} after; real-time settings refused: {'; '.join(sorted(refused)) or 'none'}")
    peers = ("protobuf", "echo") if program is None else ("cpp", "cpp")
    for title, samples, peer in (("turn-around", turn_around, peers[0]), ("round trip", round_trip, peers[1])):
        _print_table(title, {name: np.concatenate(parts) for name, parts in samples.items()}, peer)


def _print_table(title: str, samples: dict[str, NDArray[np.int64]], peer: str) -> None:
    quantiles = (50.0, 99.0, 99.9)
    reference = _quantiles(samples[peer], quantiles) if peer in samples else None
    print(f"\n{title:<12}{'p50':>9}{'p99':>9}{'p99.9':>9}  µs     ratio to {peer}: p50     p99   p99.9   answers  lost")
    for name, values in samples.items():
        row = _quantiles(values, quantiles)
        ratio = row / reference if reference is not None else row * np.nan
        print(
            f"  {name:<10}"
            + "".join(f"{value:9.1f}" for value in row)
            + " " * 24
            + "".join(f"{value:8.2f}" for value in ratio)
            + f"{np.count_nonzero(values >= 0):10d}{np.count_nonzero(values < 0):6d}"
        )


def _quantiles(values: NDArray[np.int64], quantiles: tuple[float, ...]) -> NDArray[np.float64]:
    return np.asarray(np.percentile(values[values >= 0], quantiles) / 1000.0)


def _load() -> str:
    return " ".join(f"{value:.2f}" for value in os.getloadavg())


if __name__ == "__main__":
    main()
