"""The live view for Foxglove (WebSocket) and PlotJuggler (ZeroMQ, JSON), as a process: `python -m daemon.live.server`.

A watcher like any other: it reads the recorder's broadcast, so neither loop nor recorder knows of it, and it runs with
less priority than both. Both sockets are on loopback only; with a TLS key Foxglove's may be on another address.
It ends with the run, or with whoever started it (the end of its standard input).
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
import zmq

from daemon.errors import ConfigurationError, DaemonError
from daemon.live.door import LOOPBACK, Door
from daemon.live.frame import LiveFrame
from daemon.live.plot import LivePoint, point_of
from daemon.live.residual import Modelled
from daemon.live.subscription import LiveSubscription
from daemon.live.watcher import Watcher
from daemon.log.cdr import pack_joint_state
from daemon.log.definitions import JOINT_STATE, schema_text

FOXGLOVE_PORT, PLOTJUGGLER_PORT = 8765, 9872
"""What both programs propose when they connect."""
_POLL_S = 0.02
_NICENESS = 10
_QUEUE = 1000
_encoder = msgspec.json.Encoder()

Sink = Callable[[Modelled, LivePoint], None]


def layouts_folder() -> Path:
    """Where the layouts for both programs are: foxglove.json, plotjuggler.xml."""
    return Path(str(resources.files("daemon.live").joinpath("layouts")))


def serve(port: int, door: Door, plotjuggler_port: int, is_over: Callable[[], bool]) -> None:
    """Serve the run on UDP port `port` until it has ended or `is_over`; door: of Foxglove.

    Raises ConfigurationError where foxglove-sdk is not installed or a port is taken.
    """
    watcher = Watcher()
    with contextlib.ExitStack() as stack:
        subscription = stack.enter_context(LiveSubscription(port))
        send_event, foxglove = stack.enter_context(_foxglove(door))
        sinks: list[Sink] = [foxglove, stack.enter_context(_plotjuggler(plotjuggler_port))]
        said = ""
        while not is_over():
            frames = subscription.receive(_POLL_S)
            for known in watcher.take(frames):
                point = point_of(known, watcher.ratio)
                for send in sinks:
                    send(known, point)
            for frame in frames:
                if frame.event != said:
                    said = frame.event
                    send_event(frame)
            if frames and frames[-1].ended:
                return


@contextlib.contextmanager
def _foxglove(door: Door) -> Iterator[tuple[Callable[[LiveFrame], None], Sink]]:
    """Topics as in the log where they are the same: /joint_states; /live as JSON, /run/log for the events."""
    try:
        import foxglove
        from foxglove.channels import LogChannel
        from foxglove.messages import Log, LogLevel, Timestamp
    except ImportError as error:
        raise ConfigurationError(
            "`--live` needs the package foxglove-sdk: pip install 'iiwa-ident[live]'.", field="--live"
        ) from error
    context = foxglove.Context()
    schema = foxglove.Schema(name=JOINT_STATE, encoding="ros2msg", data=schema_text(JOINT_STATE).encode())
    joints = foxglove.Channel("/joint_states", message_encoding="cdr", schema=schema, context=context)
    live = foxglove.Channel("/live", message_encoding="json", schema=_json_schema(), context=context)
    log = LogChannel("/run/log", context=context)
    certificate, key = (None, None) if door.identity is None else door.identity
    try:
        server = foxglove.start_server(
            name="iiwa-ident", host=door.address, port=door.port, context=context, tls_cert=certificate, tls_key=key
        )
    except (OSError, RuntimeError, ValueError) as error:
        raise _cannot_serve(door.address, door.port, error) from error

    def send(known: Modelled, point: LivePoint) -> None:
        time_ns = int(1e9 * point.timestamp)
        live.log(_encoder.encode(point), log_time=time_ns)
        if point.position is not None and point.torque is not None:
            joints.log(
                pack_joint_state(time_ns, point.position, known.velocity.tolist(), point.torque), log_time=time_ns
            )

    def send_event(frame: LiveFrame) -> None:
        time_ns = int(1e9 * frame.timestamp)
        stamp = Timestamp(time_ns // 1_000_000_000, time_ns % 1_000_000_000)
        log.log(Log(timestamp=stamp, level=LogLevel.Info, message=frame.event, name=frame.phase), log_time=time_ns)

    try:
        yield send_event, send
    finally:
        server.stop()


@contextlib.contextmanager
def _plotjuggler(port: int) -> Iterator[Sink]:
    context: zmq.Context[Any] = zmq.Context()
    socket = context.socket(zmq.PUB)
    socket.linger = 0
    socket.sndhwm = _QUEUE
    try:
        try:
            socket.bind(f"tcp://{LOOPBACK}:{port}")
        except zmq.ZMQError as error:
            raise _cannot_serve(LOOPBACK, port, error) from error

        def send(known: Modelled, point: LivePoint) -> None:
            del known
            with contextlib.suppress(zmq.Again):
                socket.send(_encoder.encode(point), zmq.NOBLOCK)

        yield send
    finally:
        socket.close()
        context.term()


def _cannot_serve(address: str, port: int, error: Exception) -> ConfigurationError:
    return ConfigurationError(f"TCP port {port} on {address} cannot be served ({error}).", field="--live")


def _json_schema() -> dict[str, Any]:
    """Of a LivePoint, with nothing to be looked up: Foxglove wants an object at the top."""
    (_,), components = msgspec.json.schema_components([LivePoint])
    schema: dict[str, Any] = components["LivePoint"] | {"title": "iiwa_ident.LivePoint"}
    return schema


def main(arguments: list[str] | None = None) -> int:
    """Entry of the process; one sentence on stderr where something is wrong, which ends nothing but the live view."""
    parser = argparse.ArgumentParser(prog="python -m daemon.live.server", description="Serve a run to live viewers.")
    parser.add_argument("--port", type=int, required=True, help="UDP port of the run")
    parser.add_argument("--foxglove-port", type=int, default=FOXGLOVE_PORT)
    parser.add_argument("--plotjuggler-port", type=int, default=PLOTJUGGLER_PORT)
    parser.add_argument("--address", default=LOOPBACK, help="of this machine, for Foxglove")
    parser.add_argument("--key", type=Path, help="PEM file: certificate and private key")
    options = parser.parse_args(arguments)
    # It ends with the recording, not when somebody presses a key.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)
    left_alone = threading.Event()

    def wait_for_starter() -> None:
        with contextlib.suppress(OSError):
            while os.read(0, 4096):
                pass
        left_alone.set()

    threading.Thread(target=wait_for_starter, daemon=True).start()
    try:
        door = Door.of(options.address, options.foxglove_port, options.key)
        serve(options.port, door, options.plotjuggler_port, left_alone.is_set)
    except DaemonError as error:
        print(f"There is no live view of this run: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
