"""What tests of the recorder share: all of a ring recorded, and its samples and events read back by rosbags."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from daemon.control_messages import ControlMessage
from daemon.json_files import write_json
from daemon.run.recorder import Recorder
from fri_client.handover.ring import HandoverRing
from tests.watchdog import WATCHDOG_S

from .producer import make_job

REPOSITORY = Path(__file__).resolve().parents[2]


def read_states(path: Path) -> list[Any]:
    with AnyReader([path]) as bag:
        wanted = [each for each in bag.connections if each.topic == "/fri/state"]
        return [bag.deserialize(raw, connection.msgtype) for connection, _, raw in bag.messages(wanted)]


def read_events(path: Path) -> list[Any]:
    with AnyReader([path]) as bag:
        wanted = [each for each in bag.connections if each.topic == "/run/events"]
        return [bag.deserialize(raw, connection.msgtype) for connection, _, raw in bag.messages(wanted)]


def record_all(folder: Path, ring: HandoverRing, **changes: Any) -> list[ControlMessage]:
    said: list[ControlMessage] = []
    ring.finish()
    assert Recorder(make_job(folder, **changes), HandoverRing.attach(ring.fd), said.append).run() == 0
    return said


def start_process(job: Any, ring: HandoverRing) -> subprocess.Popen[bytes]:
    file = Path(job.path).with_suffix(".job.json")
    write_json(file, job)
    return subprocess.Popen(
        [sys.executable, "-m", "daemon.run.recorder", "--request", str(file), "--ring-fd", str(ring.fd)],
        pass_fds=(ring.fd,),
        cwd=REPOSITORY,
        stderr=subprocess.PIPE,
    )


def wait_until(condition: Any) -> None:
    end = time.monotonic() + WATCHDOG_S
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
