"""Claims about `--live`: what Foxglove and PlotJuggler receive is what was broadcast, and the layouts show it.

Truth: the samples that this test pushes; Foxglove's own protocol, spoken by a plain WebSocket client; CDR read by
rosbags.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import socket
import struct
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from rosbags.typesys import Stores, get_typestore

from daemon.json_files import write_json
from daemon.live.broadcast import LiveBroadcast
from daemon.live.plot import LivePoint
from daemon.live.server import layouts_folder
from daemon.run.recorder import Recorder
from daemon.runtime_folder import runtime_folder
from fri_client.handover.ring import EventCode, HandoverRing
from tests.ports import free_tcp_port
from tests.watchdog import WATCHDOG_S

from .producer import Producer, make_job

REPOSITORY = Path(__file__).resolve().parents[2]
PORT = 30988
SUBPROTOCOL = "foxglove.sdk.v1"


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """One recording served to one Foxglove client and one ZeroMQ subscriber: what both received."""
    pytest.importorskip("foxglove")
    client = pytest.importorskip("websockets.sync.client")
    closed = pytest.importorskip("websockets.exceptions").ConnectionClosedOK
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("x")
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        runtime_folder()
        ports = free_tcp_port(), free_tcp_port()
        process = subprocess.Popen(
            [sys.executable, "-m", "daemon.live.server", "--port", str(PORT), "--foxglove-port", str(ports[0]),
             "--plotjuggler-port", str(ports[1])],
            stdin=subprocess.PIPE, cwd=REPOSITORY, env=os.environ.copy(),
        )  # fmt: skip
        listeners = _listening(process.pid, ports)
        context: zmq.Context[Any] = zmq.Context()
        plots = context.socket(zmq.SUB)
        plots.linger = 0
        plots.setsockopt(zmq.SUBSCRIBE, b"")
        plots.connect(f"tcp://127.0.0.1:{ports[1]}")
        with client.connect(f"ws://127.0.0.1:{ports[0]}", subprotocols=[SUBPROTOCOL]) as foxglove:
            channels: dict[str, dict[str, Any]] = {}
            while len(channels) < 3:
                said = json.loads(foxglove.recv(timeout=WATCHDOG_S))
                if said["op"] == "advertise":
                    channels |= {each["topic"]: each for each in said["channels"]}
            topics = list(channels)
            subscriptions = [{"id": number, "channelId": channels[name]["id"]} for number, name in enumerate(topics)]
            foxglove.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
            points: list[Any] = []
            messages: dict[str, list[bytes]] = {name: [] for name in topics}

            def take(data: str | bytes) -> None:
                if isinstance(data, bytes) and data[0] == 1:
                    (number,) = struct.unpack_from("<I", data, 1)
                    messages[topics[number]].append(data[13:])

            def have_enough() -> bool:
                while plots.poll(10):
                    points.append(json.loads(plots.recv()))
                with contextlib.suppress(TimeoutError):
                    while True:
                        take(foxglove.recv(timeout=0))
                return min(len(points), len(messages["/live"])) >= 40

            _record(folder / "run", context, have_enough)
            with contextlib.suppress(closed):  # the server closes with the run
                while True:
                    take(foxglove.recv(timeout=WATCHDOG_S))
        while plots.poll(200):
            points.append(json.loads(plots.recv()))
        plots.close()
        context.term()
        assert process.wait(WATCHDOG_S) == 0
        yield {"channels": channels, "messages": messages, "points": points, "listeners": listeners}


def _listening(pid: int, ports: tuple[int, int]) -> set[str]:
    """Addresses at which the process listens, once it has both ports."""
    import psutil

    for _ in range(6000):
        found = [each.laddr for each in psutil.Process(pid).net_connections("tcp") if each.status == "LISTEN"]
        if {port for _, port in found} >= set(ports):
            return {host for host, _ in found}
        time.sleep(0.1)
    pytest.fail("the server did not begin")


def _record(folder: Path, context: zmq.Context[Any], viewers_have_enough: Callable[[], bool]) -> None:
    """A recording, a few samples at a time as in a run, until both viewers have seen what they need."""
    ring = HandoverRing.create(4096)
    producer = Producer(ring)
    job = make_job(folder, bind_port=PORT)
    write_json(folder / "request.json", job.request)
    with LiveBroadcast(job.request, ring, context) as live:

        def fill() -> None:
            for _ in range(60_000):
                producer.push(20)
                if viewers_have_enough():
                    break
            producer.push_event(EventCode.SIGNAL_STOP)
            producer.push(20)
            ring.finish()

        thread = threading.Thread(target=fill)
        thread.start()
        assert Recorder(job, HandoverRing.attach(ring.fd), lambda _: None, live).run() == 0
        thread.join()
    ring.close()


def test_both_servers_are_on_loopback_alone(seen: dict[str, Any]) -> None:
    assert seen["listeners"] == {"127.0.0.1"}


def test_foxglove_gets_joint_states_as_they_stand_in_the_log(seen: dict[str, Any]) -> None:
    assert seen["channels"]["/joint_states"]["encoding"] == "cdr"
    assert seen["channels"]["/joint_states"]["schemaName"] == "sensor_msgs/msg/JointState"
    store = get_typestore(Stores.ROS2_HUMBLE)
    states: Any = [
        store.deserialize_cdr(raw, "sensor_msgs/msg/JointState") for raw in seen["messages"]["/joint_states"]
    ]
    assert len(states) > 30
    # The producer's torque is 1 Nm with the vendor's sign.
    assert {tuple(state.effort) for state in states} == {(-1.0,) * 7}
    assert list(states[0].name) == [f"iiwa_joint_{joint}" for joint in range(1, 8)]


def test_plotjuggler_gets_the_same_points_as_foxglove(seen: dict[str, Any]) -> None:
    """While both listened: a subscription takes its time to arrive."""
    both = [json.loads(raw) for raw in seen["messages"]["/live"]], seen["points"]
    begin, end = max(points[0]["timestamp"] for points in both), min(points[-1]["timestamp"] for points in both)
    there, here = ([point for point in points if begin <= point["timestamp"] <= end] for points in both)
    assert len(there) > 30
    assert there == here


def test_torque_minus_model_is_the_difference_of_the_two(seen: dict[str, Any]) -> None:
    for point in seen["points"]:
        difference = np.array(point["torque"]) - np.array(point["torque_model"])
        np.testing.assert_allclose(point["torque_minus_model"], difference, atol=1e-12)


def test_events_reach_foxglove(seen: dict[str, Any]) -> None:
    assert any(b"SIGNAL_STOP" in raw or b"signal" in raw.lower() for raw in seen["messages"]["/run/log"])


def test_every_path_of_the_foxglove_layout_is_a_field_of_a_served_topic(seen: dict[str, Any]) -> None:
    layout = json.loads((layouts_folder() / "foxglove.json").read_text(encoding="utf-8"))
    panels = layout["configById"]
    assert sorted(_leaves(layout["layout"])) == sorted(panels)
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    assert len(paths) == 42
    schema = json.loads(seen["channels"]["/live"]["schema"])
    for path in paths:
        found = re.fullmatch(r"(/live)\.(\w+)\[([0-6])\]", path)
        assert found is not None, path
        assert found[2] in schema["properties"]
    assert panels["RawMessages!live"]["topicPath"] in seen["channels"]
    assert panels["Log!events"]["topicToRender"] in seen["channels"]


def _leaves(layout: Any) -> list[str]:
    return [layout] if isinstance(layout, str) else _leaves(layout["first"]) + _leaves(layout["second"])


def test_every_curve_of_the_plotjuggler_layout_is_a_series_of_the_points() -> None:
    """PlotJuggler names a series by the path in the JSON object: /torque[3] for the fourth number of a list."""
    root = ElementTree.parse(layouts_folder() / "plotjuggler.xml").getroot()
    assert root.tag == "root"
    for splitter in root.iter("DockSplitter"):
        assert len(splitter) == int(splitter.attrib["count"]) == len(splitter.attrib["sizes"].split(";"))
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    assert len(curves) == 42
    for name in curves:
        found = re.fullmatch(r"/(\w+)\[([0-6])\]", name)
        assert found is not None
        assert found[1] in LivePoint.__struct_fields__


def test_the_server_ends_with_its_starter(tmp_path: Path) -> None:
    pytest.importorskip("foxglove")
    process = subprocess.Popen(
        [sys.executable, "-m", "daemon.live.server", "--port", str(PORT), "--foxglove-port", str(free_tcp_port()),
         "--plotjuggler-port", str(free_tcp_port())],
        stdin=subprocess.PIPE, cwd=REPOSITORY, env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
    )  # fmt: skip
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(WATCHDOG_S) == 0


def test_a_taken_port_is_named() -> None:
    pytest.importorskip("foxglove")
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        taken = holder.getsockname()[1]
        done = subprocess.run(
            [sys.executable, "-m", "daemon.live.server", "--port", str(PORT), "--foxglove-port", str(free_tcp_port()),
             "--plotjuggler-port", str(taken)],
            stdin=subprocess.PIPE, cwd=REPOSITORY, capture_output=True, text=True, timeout=WATCHDOG_S, check=False,
        )  # fmt: skip
    assert done.returncode == 78
    assert f"TCP port {taken}" in done.stderr
    assert "Traceback" not in done.stderr
