"""How fast the recorder writes beside the 1000 samples/s it must, how many bytes a sample takes, how its memory grows.

    .venv/bin/python -m benchmarks.recorder                      about ten seconds
    .venv/bin/python -m benchmarks.recorder --samples 1800000    as many as in 30 minutes at 1 kHz

The ring is filled with noisy datagrams of FRI 1.15 (not timed); then the recorder's own code drains it: two datagrams
decoded, three messages packed, chunk closed and handed to the system every 250 samples, as at 1 kHz in a quarter of a
second. Peers, with less to do (three JointState messages a sample, nothing to decode): rosbags, serialised into memory
only, and the writer of mcap-ros2-support, into a file.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from daemon.api import RecorderJob, RunRequest
from daemon.log import definitions
from daemon.run.recorder import Recorder
from fri_client.handover.ring import HandoverRing
from fri_client.messages import (
    CommandData,
    CommandMessage,
    ConnectionInfo,
    FriVersion,
    IpoData,
    MessageHeader,
    MonitorData,
    MonitoringMessage,
    RobotInfo,
    TimeStamp,
)
from fri_client.wire.codec import Codec

NEEDED_PER_S = 1000.0
SAMPLES_PER_FLUSH = 250
ROUND = 10_000
PEER_SAMPLES = 4000


class Source:
    """Fills a ring as the loop does, with a slow motion, sensor noise and consecutive counters."""

    def __init__(self, ring: HandoverRing, seed: int) -> None:
        self._ring = ring
        self._codec = Codec(FriVersion.V1_15)
        self._random = np.random.default_rng(seed)
        self._count = 0

    def fill(self, samples: int) -> None:
        """Push `samples` records."""
        position = 1e-5 * self._random.standard_normal((samples, 7))
        torque = 0.2 * self._random.standard_normal((samples, 7))
        for index in range(samples):
            counter = self._count
            angle = 2e-4 * counter
            target = tuple(np.sin(angle + np.arange(7.0)).tolist())
            measured = tuple((np.array(target) + position[index]).tolist())
            monitoring = MonitoringMessage(
                MessageHeader(0x245142, counter, max(counter - 1, 0)),
                RobotInfo(7, 0, (2,) * 7, 2, 0),
                MonitorData(
                    measured_joint_position=measured,
                    measured_torque=tuple((10.0 * np.array(target) + torque[index]).tolist()),
                    commanded_joint_position=target,
                    commanded_torque=tuple((10.0 * np.array(target)).tolist()),
                    external_torque=tuple(torque[index].tolist()),
                    timestamp=TimeStamp(1000 + counter // 1000, counter % 1000 * 1_000_000),
                ),
                ConnectionInfo(4, 3, 1, 1),
                IpoData(joint_position=target, client_command_mode=1, overlay_type=1, tracking_performance=1.0),
            )
            command = CommandMessage(MessageHeader(0x34001, counter, counter), CommandData(joint_position=target))
            now = time.monotonic_ns()
            self._ring.push(
                now,
                now + 80_000,
                3,
                counter // 10_000,
                counter % 10_000,
                self._codec.encode_monitoring(monitoring),
                self._codec.encode_command(command),
            )
            self._count += 1


def measure(folder: Path, samples: int, seed: int) -> dict[str, float]:
    """Drain `samples` samples into a file in `folder`; rates per second of wall clock and of CPU, bytes, RSS in MB."""
    request = RunRequest(
        run_id="benchmark",
        robot="iiwa14",
        table_file=str(folder / "table.npy"),
        trajectory_file=str(folder / "trajectory.json"),
        out_dir=str(folder),
    )
    ring = HandoverRing.create(ROUND)
    source = Source(ring, seed)
    job = RecorderJob(request=request, path=str(folder / "recording.mcap"))
    consumer = HandoverRing.attach(ring.fd)
    recorder = Recorder(job, consumer, lambda _: None)
    process = psutil.Process()
    wall = cpu = 0.0
    begin_rss = peak_rss = 0
    for done in range(0, samples, ROUND):
        source.fill(ROUND)
        start, cpu_start = time.perf_counter(), time.process_time()
        while records := consumer.read_batch(SAMPLES_PER_FLUSH):
            for record in records:
                recorder.take(record)
            recorder._keep_safe(final=True)
            recorder._tell()
        wall += time.perf_counter() - start
        cpu += time.process_time() - cpu_start
        rss = process.memory_info().rss
        if done == ROUND:
            begin_rss = rss
        peak_rss = max(peak_rss, rss)
    ring.finish()
    start = time.perf_counter()
    if recorder.run():
        raise SystemExit("the recorder could not close its file")
    closing = time.perf_counter() - start
    closed_rss = process.memory_info().rss
    total = -(-samples // ROUND) * ROUND
    size = (folder / "recording.mcap").stat().st_size
    consumer.close()
    ring.close()
    return {
        "samples": total,
        "samples_per_s": total / wall,
        "samples_per_cpu_s": total / cpu,
        "bytes_per_sample": size / total,
        "closing_s": closing,
        "rss_growth_mb": (peak_rss - begin_rss) / 1e6,
        "rss_growth_with_closing_mb": (max(peak_rss, closed_rss) - begin_rss) / 1e6,
    }


def peers(folder: Path) -> dict[str, float]:
    """Samples/s of two public writers of ROS 2 messages, three JointState a sample."""
    from mcap_ros2.writer import Writer as RosWriter
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    seven = np.linspace(0.1, 0.7, 7)
    names = [f"iiwa_joint_{joint}" for joint in range(1, 8)]
    joint_state: Any = store.types["sensor_msgs/msg/JointState"]
    header: Any = store.types["std_msgs/msg/Header"]
    stamp: Any = store.types["builtin_interfaces/msg/Time"]
    start = time.perf_counter()
    for index in range(PEER_SAMPLES):
        message = joint_state(header(stamp(index, 0), ""), names, seven, seven, seven)
        for _ in range(3):
            store.serialize_cdr(message, "sensor_msgs/msg/JointState")
    rosbags_rate = PEER_SAMPLES / (time.perf_counter() - start)
    text = definitions.schema_text(definitions.JOINT_STATE)
    plain = {
        "header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": ""},
        "name": names,
        **{name: seven.tolist() for name in ("position", "velocity", "effort")},
    }
    with (folder / "peer.mcap").open("wb") as stream:
        writer: Any = RosWriter(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", text)
        start = time.perf_counter()
        for index in range(PEER_SAMPLES):
            for topic in ("/a", "/b", "/c"):
                writer.write_message(topic, schema, plain, index, index)
        writer.finish()
        ros_rate = PEER_SAMPLES / (time.perf_counter() - start)
    return {"rosbags": rosbags_rate, "mcap-ros2-support": ros_rate}


def main(arguments: list[str] | None = None) -> int:
    """Print the table; --json FILE writes the numbers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        result = measure(Path(name), options.samples, options.seed)
        others = peers(Path(name))
    rate = result["samples_per_s"]
    print(
        f"recorder, {result['samples']:.0f} samples of FRI 1.15, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    )
    print(f"  needed                              {NEEDED_PER_S:8.0f} samples/s   1.0")
    print(f"  datagrams to file                   {rate:8.0f} samples/s   {rate / NEEDED_PER_S:.1f} x needed")
    print(f"  the same per second of CPU          {result['samples_per_cpu_s']:8.0f} samples/s")
    for peer, peer_rate in others.items():
        label = f"{peer} {version(peer)}, 3 JointState"
        print(f"  {label:35s} {peer_rate:8.0f} samples/s   {peer_rate / NEEDED_PER_S:.1f} x needed")
    print(f"  bytes per sample in the file        {result['bytes_per_sample']:8.0f}")
    print(
        f"  memory grown while recording        {result['rss_growth_mb']:8.1f} MB, with closing "
        f"{result['rss_growth_with_closing_mb']:.1f} MB"
    )
    print(f"  close, open again and count         {result['closing_s']:8.1f} s")
    if options.json:
        options.json.write_text(json.dumps({**result, "peers": others, "seed": options.seed}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
