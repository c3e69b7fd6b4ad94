"""Claims about the recorder in trouble: killed, stopped, on a disk that hangs or is full, it loses nothing unseen.

Truth: the counters this test pushed, read back by rosbags.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from daemon.control_messages import ControlMessage, RecorderFailed, RecorderTrouble
from daemon.json_files import write_json
from daemon.log.parts import recover
from daemon.run.recorder import Recorder
from fri_client.handover.ring import HandoverRing
from tests.watchdog import WATCHDOG_S

from .producer import Producer, make_job
from .recorder_results import REPOSITORY, read_events, read_states, start_process, wait_until


def test_killed_again_and_again_at_any_moment_nothing_is_lost_between_files_and_ring(
    tmp_path: Path, ring: HandoverRing
) -> None:
    """Four recorders in a row, each killed at a moment drawn from 0 to 0.4 s while samples come at about 2 kHz."""
    moments = np.random.default_rng(11).uniform(0.0, 0.4, 4)
    producer = Producer(ring)
    for part, moment in enumerate(moments):
        job = make_job(tmp_path, part=part)
        process = start_process(job, ring)
        wait_until(Path(job.path).exists)
        end = time.monotonic() + moment
        while time.monotonic() < end:
            producer.push(20)
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        process.wait()
        producer.push(30)
    ring.finish()
    last = start_process(make_job(tmp_path, part=len(moments)), ring)
    assert last.wait(WATCHDOG_S) == 0
    report = recover(tmp_path)
    assert [state.sample_index for state in read_states(report.recovered)] == list(range(producer.sent))
    assert (report.missing, report.missing_in_handover) == (0, 0)
    assert not list(tmp_path.glob(".*"))


def test_a_disk_that_hangs_for_seconds_costs_nothing_while_the_ring_has_room(
    tmp_path: Path, ring: HandoverRing
) -> None:
    """The recorder's process is stopped and continued, which looks to the ring like a write that does not return."""
    producer = Producer(ring)
    process = start_process(make_job(tmp_path), ring)
    wait_until((tmp_path / "recording.mcap").exists)
    for _ in range(2):
        producer.push(300)
        process.send_signal(signal.SIGSTOP)
        assert producer.push(1500) == 1500
        time.sleep(0.3)
        process.send_signal(signal.SIGCONT)
        wait_until(lambda: ring.backlog == 0)
    ring.finish()
    assert process.wait(WATCHDOG_S) == 0
    assert [state.sample_index for state in read_states(tmp_path / "recording.mcap")] == list(range(producer.sent))
    assert ring.lost == 0


def test_a_stop_signal_does_not_end_the_recording(tmp_path: Path, ring: HandoverRing) -> None:
    producer = Producer(ring)
    process = start_process(make_job(tmp_path), ring)
    wait_until(lambda: (tmp_path / "recording.mcap").exists())
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGTERM)
    producer.push(20)
    ring.finish()
    assert process.wait(WATCHDOG_S) == 0
    assert len(read_states(tmp_path / "recording.mcap")) == 20


class FullDisk:
    """Lets `room` bytes through to the real disk, then says it is full; the reserve, given back, adds room."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
        self.room = room
        real = os.pwrite

        def pwrite(descriptor: int, data: Any, offset: int) -> int:
            if len(data) > self.room:
                raise OSError(28, "No space left on device")
            self.room -= len(data)
            return real(descriptor, data, offset)

        monkeypatch.setattr("daemon.log.stream.os.pwrite", pwrite)


def test_a_disk_that_stays_full_is_reported_and_the_ring_keeps_the_rest(
    tmp_path: Path, ring: HandoverRing, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.run.recorder.DISK_PATIENCE_S", 0.2)
    monkeypatch.setattr("daemon.run.recorder.RETRY_S", 0.01)
    Producer(ring).push(300)
    said: list[ControlMessage] = []
    recorder = Recorder(make_job(tmp_path), HandoverRing.attach(ring.fd), said.append)
    FullDisk(monkeypatch, 100)
    ring.finish()
    assert recorder.run() == 74
    assert any(isinstance(each, RecorderTrouble) and each.reserve_opened for each in said)
    failed = said[-1]
    assert isinstance(failed, RecorderFailed)
    assert "No space left on device" in failed.sentence
    assert ring.backlog == 300
    monkeypatch.undo()
    rescue: list[ControlMessage] = []
    assert Recorder(make_job(tmp_path, part=1), HandoverRing.attach(ring.fd), rescue.append).run() == 0
    assert len(read_states(tmp_path / "recording.part1.mcap")) == 300


def test_a_recorder_whose_file_was_moved_away_ends_while_the_arm_can_still_be_stopped(
    tmp_path: Path, ring: HandoverRing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel takes every write into a file without a name: all periods were driven, and none of them was kept."""
    monkeypatch.setattr("daemon.run.recorder.DIAGNOSTICS_S", 0.01)
    folder = tmp_path / "run"
    folder.mkdir()
    said: list[ControlMessage] = []
    recorder = Recorder(make_job(folder), HandoverRing.attach(ring.fd), said.append)
    folder.rename(tmp_path / "away")
    Producer(ring).push(300)
    end = threading.Timer(WATCHDOG_S, ring.finish)
    end.start()
    assert recorder.run() == 74
    end.cancel()
    assert not ring.finished
    assert isinstance(said[-1], RecorderFailed)
    assert "was moved or removed" in said[-1].sentence
    ring.finish()
    assert Recorder(make_job(tmp_path, part=1), HandoverRing.attach(ring.fd), said.append).run() == 0
    indices = [state.sample_index for state in read_states(tmp_path / "recording.part1.mcap")]
    assert indices == list(range(indices[0], 300))


def test_a_recorder_that_gives_up_while_its_supervisor_lives_leaves_the_account_to_it(
    tmp_path: Path, ring: HandoverRing
) -> None:
    """The loop still drives its stop, which takes long on a busy machine: the ring is not finished."""
    Producer(ring).push(300)
    file = tmp_path / "job.json"
    write_json(file, make_job(tmp_path))
    code = (
        "import os, sys; from daemon.log import stream; from daemon.run import recorder\n"
        "recorder.DISK_PATIENCE_S = 0.1\n"
        "begin = recorder.Recorder.run\n"
        "def refuse(*_): raise OSError(28, 'No space left on device')\n"
        "def run(self): stream.os.pwrite = refuse; return begin(self)\n"
        "recorder.Recorder.run = run; sys.exit(recorder.main(sys.argv[1:]))"
    )
    options = ["--request", str(file), "--ring-fd", str(ring.fd), "--supervisor", str(os.getpid())]
    process = subprocess.run(
        [sys.executable, "-c", code, *options],
        pass_fds=(ring.fd,), cwd=REPOSITORY, capture_output=True, check=False, timeout=WATCHDOG_S,
    )  # fmt: skip
    assert process.returncode == 74, process.stderr
    assert not (tmp_path / "run.json").exists()
    assert ring.backlog == 300


def test_a_disk_without_room_for_the_reserve_is_said_before_anything_moves(tmp_path: Path, ring: HandoverRing) -> None:
    """A limit on file size set by the kernel for a real process: the reserve cannot be allocated."""
    Producer(ring).push(10)
    file = tmp_path / "job.json"
    write_json(file, make_job(tmp_path))
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536));"
        "from daemon.run.recorder import main; sys.exit(main(sys.argv[1:]))"
    )
    process = subprocess.run(
        [sys.executable, "-c", code, "--request", str(file), "--ring-fd", str(ring.fd)],
        pass_fds=(ring.fd,),
        cwd=REPOSITORY,
        capture_output=True,
        check=False,
        timeout=WATCHDOG_S,
    )
    assert process.returncode == 74
    assert b"File too large" in process.stderr
    assert ring.backlog == 10


def test_a_really_full_file_system_ends_in_a_whole_file_thanks_to_the_reserve(tmp_path: Path) -> None:
    """A tmpfs of 9 MiB of which another program takes everything but the reserve; in a mount namespace of its own."""
    ring = HandoverRing.create(4096)
    Producer(ring).push(3000)
    ring.finish()
    job = make_job(tmp_path)
    small = tmp_path / "small"
    small.mkdir()
    file = tmp_path / "job.json"
    write_json(file, msgspec.structs.replace(job, path=str(small / "recording.mcap")))
    code = (
        "import sys; from pathlib import Path; from daemon.run import recorder; small = Path(sys.argv.pop(1))\n"
        "begin = recorder.Recorder.run\n"
        "def run(self):\n"
        "    with open(small / 'other', 'wb', buffering=0) as stream:\n"
        "        try:\n"
        "            while stream.write(bytes(4096)): pass\n"
        "        except OSError: pass\n"
        "    code = begin(self); (small / 'other').unlink(); return code\n"
        "recorder.Recorder.run = run; sys.exit(recorder.main(sys.argv[1:]))"
    )
    out = tmp_path / "out.mcap"
    script = (
        f"mount -t tmpfs -o size=9m none {small} && "
        f'{sys.executable} -c "$CODE" {small} --request {file} --ring-fd {ring.fd}; '
        f"code=$?; cp {small}/recording.mcap {out}; exit $code"
    )
    process = subprocess.run(
        ["unshare", "-rm", "sh", "-c", script],
        pass_fds=(ring.fd,),
        cwd=REPOSITORY,
        env={**os.environ, "CODE": code},
        capture_output=True,
        check=False,
        timeout=WATCHDOG_S,
        text=True,
    )
    if "unshare" in process.stderr or "mount:" in process.stderr:
        pytest.skip(f"no mount namespace of our own on this machine: {process.stderr.strip()}")
    assert process.returncode == 0, process.stderr
    assert len(read_states(out)) == 3000
    assert "DISK_TROUBLE" in {event.name for event in read_events(out)}
    ring.close()
