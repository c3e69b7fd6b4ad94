"""Claims about whole runs on disks that refuse: a small tmpfs that another program fills, one that is read-only.

Each run sits in a mount namespace of its own, where one is allowed; the fake robot and the files read at the end stay
outside. Truth: the robot's counters in the recorded messages, and what the loop counted.
"""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from daemon.api import RUN_NAME, RunEvent, RunOutcome, RunRequest
from daemon.children import Child
from daemon.errors import DaemonError, FolderGoneError, LogIOError
from daemon.json_files import read_json, write_json
from daemon.run.folder import make_room
from daemon.run.next_step import moved_away, next_step
from daemon.run.service import run_acquisition
from daemon.run.spare_folder import find_run_file
from fri_client.handover.ring import HandoverRing
from tests.ports import free_udp_port

from .recorder_results import read_events, read_states
from .service_process import fake_robot
from .service_runs import (
    REPOSITORY,
    WATCHDOG_S,
    assert_nothing_missing,
    child_of,
    gentle_request,
)

FILL_AND_RUN = """
import contextlib, os, sys
from pathlib import Path
import psutil
from daemon.api import RunRequest
from daemon.json_files import read_json, write_json
from daemon.run.service import run_acquisition

request = read_json(sys.argv[1], RunRequest)
held = []

def hold_the_reserve():
    # With a second descriptor of it, so that what the recorder gives back does not become free.
    for child in psutil.Process().children():
        for link in Path(f"/proc/{child.pid}/fd").iterdir():
            with contextlib.suppress(OSError):  # one that was closed meanwhile
                if ".reserve" in os.readlink(link):
                    held.append(open(link, "rb"))

def fill():
    with open(Path(request.out_dir) / "other", "wb", buffering=0) as stream:
        size = 1 << 20
        while size:
            try:
                stream.write(bytes(size))
            except OSError:
                size //= 2

def observe(event):
    print(event.kind, event.sentence, flush=True)
    if event.kind == "progress" and event.period >= 1 and not held:
        hold_the_reserve()
        fill()

outcome = run_acquisition(request, observe=observe)
write_json(sys.argv[2], outcome)
sys.exit(outcome.exit_code)
"""


@pytest.fixture
def robot() -> Iterator[int]:
    """The port that a fake robot sends to."""
    port = free_udp_port()
    with fake_robot(port):
        yield port


def run_on(options: str, request: RunRequest, folder: Path, code: str) -> tuple[subprocess.CompletedProcess[str], Path]:
    """Run `code` with request.out_dir being a tmpfs mounted with `options`; what stood there at the end is copied."""
    Path(request.out_dir).mkdir()
    left, temporary = folder / "left", folder / "temporary"
    left.mkdir()
    temporary.mkdir()
    write_json(folder / "input.json", request)
    script = (
        f"mount -t tmpfs -o {options} none {request.out_dir} || exit 99; "
        f'{sys.executable} -c "$CODE" {folder}/input.json {folder}/outcome.json; code=$?; '
        f"rm -f {request.out_dir}/other; cp -r {request.out_dir}/. {left}; exit $code"
    )
    process = subprocess.run(
        ["unshare", "-rm", "sh", "-c", script],
        cwd=REPOSITORY,
        env={**os.environ, "CODE": code, "TMPDIR": str(temporary)},
        capture_output=True,
        check=False,
        timeout=WATCHDOG_S,
        text=True,
    )
    if process.returncode == 99 or "unshare:" in process.stderr:
        pytest.skip(f"no mount namespace of our own on this machine: {process.stderr.strip()}")
    return process, left


def test_a_disk_that_stays_full_ends_the_motion_and_the_rest_is_kept_in_the_temporary_folder(
    robot: int, tmp_path: Path
) -> None:
    request = gentle_request(tmp_path, robot, periods=60)
    process, left = run_on("size=20m", request, tmp_path, FILL_AND_RUN)
    assert "Traceback" not in process.stderr, process.stderr
    outcome = read_json(tmp_path / "outcome.json", RunOutcome)
    assert process.returncode == outcome.exit_code == 1, process.stdout + process.stderr
    assert outcome.loop is not None
    assert (outcome.outcome, outcome.loop.reason) == ("stopped", "DISK_FULL")
    assert outcome.loop.standstill_confirmed
    recording = Path(outcome.recordings[0])
    assert recording.is_relative_to(tmp_path / "temporary")
    assert_nothing_missing(recording)
    assert len(read_states(recording)) == outcome.samples == outcome.loop.received
    assert "DISK_FULL" in {event.name for event in read_events(recording)}
    assert any("No space left on device" in sentence for sentence in outcome.sentences)
    assert any(str(recording.parent) in sentence for sentence in outcome.sentences)
    assert (left / "recording.broken.mcap").stat().st_size > 0


def test_a_read_only_folder_is_said_before_anything_moves(tmp_path: Path) -> None:
    request = gentle_request(tmp_path, free_udp_port())
    process, left = run_on("ro", request, tmp_path, FILL_AND_RUN)
    assert "Read-only file system" in process.stderr
    assert "LogIOError" in process.stderr
    assert list(left.iterdir()) == []


def test_a_disk_that_hangs_until_the_ring_is_nearly_full_stops_the_arm_and_costs_no_sample(
    robot: int, tmp_path: Path
) -> None:
    """The recorder's process is stopped in the motion and continued when the loop has ended."""
    hung: list[threading.Thread] = []

    def hang(recorder: psutil.Process, loop: psutil.Process) -> None:
        recorder.suspend()
        # Not loop.wait(): its return code belongs to the supervisor, which may take it at any moment.
        with contextlib.suppress(psutil.NoSuchProcess):
            while loop.status() != psutil.STATUS_ZOMBIE:
                time.sleep(0.05)
        recorder.resume()

    def observe(event: RunEvent) -> None:
        if event.kind == "progress" and event.period >= 1 and not hung:
            processes = (child_of(psutil.Process(), f"daemon.run.{name}") for name in ("recorder", "loop_process"))
            hung.append(threading.Thread(target=hang, args=tuple(processes)))
            hung[0].start()

    outcome = run_acquisition(gentle_request(tmp_path, robot, periods=60, ring_slots=6000), observe=observe)
    hung[0].join()
    assert (outcome.exit_code, outcome.outcome) == (1, "stopped"), outcome.sentences
    assert outcome.loop is not None
    assert outcome.loop.standstill_confirmed
    assert outcome.loop.reason == "RECORDER_LOST"
    assert outcome.loop.lost_in_handover == 0
    assert_nothing_missing(Path(outcome.recordings[0]))
    assert len(read_states(Path(outcome.recordings[0]))) == outcome.loop.received


def test_a_folder_that_is_moved_away_in_the_run_is_said_and_what_it_held_is_counted(
    robot: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when somebody tidies up: the account is written elsewhere, and no sample is forgotten in it."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    request = gentle_request(tmp_path, robot)
    folder, away = Path(request.out_dir), tmp_path / "away"

    def observe(event: RunEvent) -> None:
        if event.kind == "preflight":  # said of the start ramp, while the robot waits
            folder.rename(away)

    outcome = run_acquisition(request, observe=observe)
    assert outcome.exit_code == 1
    assert outcome.loop is not None
    assert outcome.loop.standstill_confirmed
    assert outcome.samples + outcome.handover_gaps == outcome.loop.received > 0
    assert any(f"{folder} was moved or removed" in sentence for sentence in outcome.sentences)
    assert read_json(find_run_file(request, RUN_NAME), RunOutcome).sentences == outcome.sentences
    # Wherever the folder is now, its account is that of the loop, and says where the rest is.
    spare = str(find_run_file(request, RUN_NAME).parent)
    said = invoke("recover", str(away))
    written = read_json(away / RUN_NAME, RunOutcome)
    assert written.loop is not None
    assert (written.outcome, written.exit_code) == (outcome.outcome, int(written.handover_gaps > 0))
    assert (written.loop.sentence, written.loop.received) == (outcome.loop.sentence, outcome.loop.received)
    assert written.samples + written.handover_gaps == outcome.loop.received
    assert "without a word" not in " ".join(written.sentences)
    assert any(spare in sentence for sentence in written.sentences)
    assert f"is in {spare}: " in said
    shown = moved_away(outcome)
    assert f"{spare}/run.json" in shown
    assert "iiwa-ident recover" in shown


@pytest.mark.parametrize("moment", ["starting", "waiting"])
def test_a_folder_that_is_moved_away_before_the_loop_begins_is_said_and_nothing_is_blamed_on_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """At "starting" there is no child yet; at "waiting" the loop's process is begun and has not read its request."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    request = gentle_request(tmp_path, free_udp_port())
    folder, away = Path(request.out_dir), tmp_path / "away"
    said: list[str] = []

    def observe(event: RunEvent) -> None:
        said.append(event.sentence)
        if event.kind == moment:
            folder.rename(away)

    try:
        outcome = run_acquisition(request, observe=observe)
        code, (sentence,) = outcome.exit_code, outcome.sentences
        assert moved_away(outcome) == next_step(outcome, None)
        assert moved_away(outcome) == "Next: nothing moved; the same command can be given again."
    except FolderGoneError as error:
        code, sentence = error.exit_code, str(error)
    assert code == 74
    assert f"{folder} was moved or removed before the robot was listened to; nothing was moved" in sentence
    # Nothing is said or begun for a motion that never was.
    assert not any("record" in each for each in said if each not in (sentence, said[0]))
    assert not list(temporary.rglob("*.mcap"))


@pytest.mark.parametrize("refusal", [FolderGoneError, LogIOError])
def test_a_loop_that_cannot_be_started_leaves_no_recorder_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refusal: type[DaemonError]
) -> None:
    """The folder goes between the two, or the disk refuses the loop's log; in a service the recorder's parent lives on,
    so nothing else would end it. The folder takes the same command again.
    """
    request = gentle_request(tmp_path, free_udp_port())
    folder = Path(request.out_dir)
    recorders: list[psutil.Process] = []

    def start(role: str, *others: Any) -> Child:
        if role == "loop":
            recorders.append(child_of(psutil.Process(), "daemon.run.recorder"))
            if refusal is LogIOError:
                raise LogIOError(str(folder / "loop.log"), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
            folder.rename(tmp_path / "away")
        return Child(role, *others)

    monkeypatch.setattr("daemon.run.service.Child", start)
    with pytest.raises(refusal):
        run_acquisition(request, observe=lambda _: None)
    assert not recorders[0].is_running()
    make_room(folder)
    assert not list(folder.glob("rec*"))
    assert (folder / "failed-start-1" / "recording.mcap").is_file() == (refusal is LogIOError)


def invoke(*words: str) -> str:
    """The command's stdout."""
    shown = subprocess.run(
        [sys.executable, "-c", "from daemon.cli import main; main()", *words],
        capture_output=True, text=True, check=True, env={**os.environ}, timeout=WATCHDOG_S,
    )  # fmt: skip
    return shown.stdout


def test_what_a_recorder_says_of_a_full_disk_is_the_error_that_it_was(tmp_path: Path, ring: HandoverRing) -> None:
    """`reason` in run.json, a fixed word for programs, was the name of a class that nobody else knows."""
    recorder = Child("recorder", "daemon.run.recorder", [], ring, tmp_path)
    recorder.wait(WATCHDOG_S)
    recorder.process = subprocess.Popen(["sh", "-c", "exit 74"])
    recorder.process.wait(WATCHDOG_S)
    (tmp_path / "recorder.log").write_text("/full/recording.mcap: No space left on device.\n", encoding="utf-8")
    error = recorder.failed()
    assert (type(error), str(error)) == (LogIOError, "/full/recording.mcap: No space left on device.")
    assert error.exit_code == 74
