"""Claims about the live view: what a watcher sees is what was recorded, and watching costs the recording nothing.

Truth: the samples that these tests push, closed forms of sinusoids, and noise whose size the test chose.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest
import zmq

from daemon.api import RunOutcome
from daemon.cli import watch
from daemon.cli.watch import NothingToWatchError, _follow_once, _frames, _port_of
from daemon.errors import MissingInputError
from daemon.json_files import write_json
from daemon.live.broadcast import LiveBroadcast
from daemon.live.frame import LiveFrame
from daemon.live.residual import Modelled
from daemon.live.subscription import LiveSubscription, served_ports
from daemon.live.watcher import Watcher
from daemon.run.recorder import Recorder
from daemon.runtime_folder import runtime_folder
from fri_client.handover.ring import HandoverRing
from tests.daemon import command_line
from tests.daemon.live_frames import frame, sinusoid
from tests.watchdog import WATCHDOG_S

from .producer import Producer, make_job, make_request
from .recorder_results import read_states

REPOSITORY = Path(__file__).resolve().parents[2]
PORT = 30987


@pytest.fixture
def private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A private folder for sockets of this test alone."""
    folder = tmp_path / "x"
    folder.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    return runtime_folder()


def record_watched(folder: Path, ring: HandoverRing, samples: int) -> list[LiveFrame]:
    """What a watcher received of a recording of so many samples, from the first frame to the last."""
    seen: list[LiveFrame] = []
    producer = Producer(ring)
    with LiveSubscription(PORT) as subscription:

        def listen() -> None:
            while not seen or not seen[-1].ended:
                seen.extend(subscription.receive(1.0))

        listener = threading.Thread(target=listen, daemon=True)
        context: zmq.Context[Any] = zmq.Context()
        job = make_job(folder, bind_port=PORT)
        with LiveBroadcast(job.request, ring, context) as live:
            listener.start()
            while not seen:  # the subscription takes its time to arrive; frames without samples say when
                live._next_quiet = 0.0
                live.tick()
                time.sleep(0.01)
            producer.push(samples)
            ring.finish()
            assert Recorder(job, HandoverRing.attach(ring.fd), lambda _: None, live).run() == 0
        listener.join(WATCHDOG_S)
        context.term()
    assert seen[-1].ended
    return seen


def test_a_frame_is_the_mean_of_the_samples_that_were_recorded(
    private: Path, tmp_path: Path, ring: HandoverRing
) -> None:
    frames = [each for each in record_watched(tmp_path / "run", ring, 250) if each.position is not None]
    # The producer's torque is 1 Nm with the vendor's sign on each joint, the external one 0.1 Nm.
    assert {each.torque for each in frames} == {(-1.0,) * 7}
    np.testing.assert_allclose([each.external_torque for each in frames], 0.1)
    assert len(frames) >= 25
    times = [each.robot_time_s for each in frames]
    assert times == sorted(times)


def test_the_socket_goes_with_the_recording(private: Path, tmp_path: Path, ring: HandoverRing) -> None:
    record_watched(tmp_path / "run", ring, 20)
    assert served_ports() == []


def test_what_killed_recorders_left_is_asked_at_once_and_is_no_run(private: Path) -> None:
    folder = runtime_folder()
    for port in (41001, 41002, 41003):
        with socket.socket(socket.AF_UNIX) as left:
            left.bind(str(folder / f"watch-{port}"))
    assert served_ports() == []
    for port in (None, 41001):
        with pytest.raises(NothingToWatchError, match="No run is being recorded"):
            _port_of(None, port)


def test_a_recorder_that_is_held_is_no_dead_one(private: Path) -> None:
    """It has its socket and takes nothing from it: its queue of connections is full."""
    with contextlib.ExitStack() as stack:
        held = stack.enter_context(socket.socket(socket.AF_UNIX))
        held.bind(str(runtime_folder() / "watch-41001"))
        held.listen(0)
        for _ in range(4):
            other = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK))
            with contextlib.suppress(BlockingIOError):
                other.connect(str(runtime_folder() / "watch-41001"))
        assert served_ports() == [41001]


@pytest.mark.parametrize("holder", ["none", "dead", "lives"])
def test_the_folder_of_a_killed_run_is_not_waited_for(private: Path, tmp_path: Path, holder: str) -> None:
    """One that lives may be about to begin: its recorder is waited for."""
    folder = tmp_path / "run"
    write_json(folder / "request.json", make_request(folder, bind_port=PORT))
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(runtime_folder() / f"watch-{PORT}"))
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    number = {"dead": ended.pid, "lives": os.getpid()}.get(holder)
    if number is not None:
        (runtime_folder() / f"port-{PORT}.lock").write_text(f"{number}\n")
    if holder == "lives":
        assert _port_of(folder, None) == PORT
        return
    with pytest.raises(NothingToWatchError, match="recover"):
        _port_of(folder, None)


def test_a_watcher_that_came_too_late_for_the_last_frame_says_that_it_ended(private: Path) -> None:
    with LiveSubscription(PORT) as subscription, pytest.raises(NothingToWatchError, match="has ended"):
        _frames(subscription)


def test_a_last_frame_that_comes_after_a_silence_is_the_end_and_no_failure(private: Path) -> None:
    """Of a recorder that was held, and that is gone as soon as it has sent it."""
    with socket.socket(socket.AF_UNIX) as recorder:
        recorder.bind(str(runtime_folder() / f"watch-{PORT}"))
        recorder.listen()

        class Held:
            port, turns = PORT, iter([[], [frame(ended=True)]])

            def receive(self, _: float) -> list[LiveFrame]:
                recorder.close()  # after what it had to say: the frame is on its way
                return next(self.turns)

        (last,) = _frames(cast(LiveSubscription, Held()))
    assert last.ended


def test_a_watcher_that_never_reads_holds_up_nothing(private: Path, tmp_path: Path, ring: HandoverRing) -> None:
    context: zmq.Context[Any] = zmq.Context()
    deaf = context.socket(zmq.SUB)
    deaf.linger = 0
    deaf.rcvhwm = 1
    deaf.setsockopt(zmq.SUBSCRIBE, b"")
    job = make_job(tmp_path / "run", bind_port=PORT)
    with LiveBroadcast(job.request, ring, context) as live:
        deaf.connect(f"ipc://{private}/watch-{PORT}")
        while not deaf.poll(10):  # until its subscription has arrived: a frame waits for it from here on, unread
            live._next_quiet = 0.0
            live.tick()
        Producer(ring).push(4000)
        ring.finish()
        said: list[Any] = []
        assert Recorder(job, HandoverRing.attach(ring.fd), said.append, live).run() == 0
    assert len(read_states(Path(job.path))) == said[-1].samples == 4000
    deaf.close()
    context.term()


def test_without_a_private_folder_the_run_is_recorded_and_not_shown(
    tmp_path: Path, ring: HandoverRing, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(port: int) -> str:
        raise OSError("no such place")

    monkeypatch.setattr("daemon.live.broadcast.live_endpoint", refuse)
    context: zmq.Context[Any] = zmq.Context()
    job = make_job(tmp_path / "run", bind_port=PORT)
    with LiveBroadcast(job.request, ring, context) as live:
        Producer(ring).push(50)
        ring.finish()
        said: list[Any] = []
        assert Recorder(job, HandoverRing.attach(ring.fd), said.append, live).run() == 0
    context.term()
    assert len(read_states(Path(job.path))) == said[-1].samples == 50
    assert "no live view" in capsys.readouterr().err


# ---- the command


def watched(private: Path, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", "from daemon.cli import main; main()", "watch", *words],
        cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "XDG_RUNTIME_DIR": str(private.parent)},
    )  # fmt: skip


@contextmanager
def ticking(live: LiveBroadcast) -> Iterator[None]:
    """Frames without samples, as of a robot that is waited for, while the block lasts."""
    done = threading.Event()

    def tick() -> None:
        while not done.wait(0.02):
            live._next_quiet = 0.0
            live.tick()

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def test_watch_follows_a_run_to_its_end_and_says_how_it_ended(
    private: Path, tmp_path: Path, ring: HandoverRing
) -> None:
    request = make_request(tmp_path / "run", bind_port=PORT)
    write_json(tmp_path / "run" / "request.json", request)
    context: zmq.Context[Any] = zmq.Context()
    with LiveBroadcast(request, ring, context) as live:
        screen, lines = watched(private, str(tmp_path / "run"), "--once"), watched(private)
        assert lines.stdout is not None
        with ticking(live):
            assert "Run test-run  iiwa14" in screen.communicate(timeout=WATCHDOG_S)[0]
            # Not before: while nobody reads them, its frames fill the pipe, and those that come then are lost.
            frames = watched(private, "--json", "-")
            assert frames.stdout is not None
            assert lines.stdout.readline().startswith("test-run: waiting; 0 received")
            assert json.loads(frames.stdout.readline())["run_id"] == "test-run"
        ring.publish_reason("The motion was stopped by an operator.")
    context.term()
    assert lines.communicate(timeout=WATCHDOG_S)[0] == "The recording ended. The motion was stopped by an operator.\n"
    assert json.loads(frames.communicate(timeout=WATCHDOG_S)[0].splitlines()[-1])["ended"] is True
    assert [process.returncode for process in (screen, lines, frames)] == [0, 0, 0]


def test_one_screen_shows_the_speed_however_long_the_model_took_to_load(
    private: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second in which a motion had to show began before the model was there: the column of speeds stayed empty."""
    now, coming = [0.0], sinusoid(0.5, 0.5, 5)

    class OneByOne:
        port = PORT

        def receive(self, timeout_s: float) -> list[LiveFrame]:
            del timeout_s
            return [coming.pop(0)]

    class SlowToBegin(Watcher):
        def take(self, frames: Sequence[LiveFrame]) -> list[Modelled]:
            now[0] += 5.0 if self.newest is None else 0.01
            return super().take(frames)

    monkeypatch.setattr(watch, "time", SimpleNamespace(monotonic=lambda: now[0]))
    _follow_once(cast(LiveSubscription, OneByOne()), SlowToBegin())
    first_joint = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("A1"))
    assert f"{0.5 * np.pi:+.2f}" in first_joint  # the largest speed of the sinusoid, rad/s


def test_a_screen_whose_run_was_killed_waits_for_no_word_and_names_what_saves_it(
    private: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It said after ten seconds that the run may go on unseen; in a pipe it sent to a run.json that nobody writes."""
    now = [0.0]

    class Silent:
        port = PORT

        def receive(self, timeout_s: float) -> list[LiveFrame]:
            now[0] += timeout_s
            return []

    def sleep(seconds: float) -> None:
        now[0] += seconds

    monkeypatch.setattr(watch, "time", SimpleNamespace(monotonic=lambda: now[0], sleep=sleep))
    with pytest.raises(NothingToWatchError, match="look at the arm, then `iiwa-ident recover"):
        watch._follow_on_screen(cast(LiveSubscription, Silent()), Watcher())
    assert now[0] < 5.0


def test_a_watcher_is_told_of_a_loop_that_was_killed(
    private: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its recorder's last word is of the motion before; that nobody saw the arm come to rest stands in run.json."""
    last = msgspec.structs.replace(frame(ended=True), folder=str(tmp_path), event="The motion went on.")
    watch._show_account(last, PORT)
    assert "look at the arm" in capsys.readouterr().err
    told = ("The motion went on.", "The loop process was killed; standstill unconfirmed.")
    write_json(
        tmp_path / "run.json",
        RunOutcome(run_id="r", outcome="fault", exit_code=70, sentences=told, out_dir=str(tmp_path)),
    )
    watch._show_account(last, PORT)
    assert capsys.readouterr().out == told[1] + "\n"


def test_watch_without_a_run_says_so(private: Path, tmp_path: Path) -> None:
    nothing = watched(private)
    assert "No run is being recorded" in nothing.communicate(timeout=WATCHDOG_S)[1]
    assert nothing.returncode == 69
    missing = watched(private, str(tmp_path / "absent"))
    missing.communicate(timeout=WATCHDOG_S)
    assert missing.returncode == 66
    with pytest.raises(MissingInputError, match="name the folder of a run"):
        _port_of(tmp_path, None)


def test_the_recording_of_a_run_that_has_ended_stands_for_its_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was said not to exist."""
    told = RunOutcome(run_id="r", outcome="completed", exit_code=0, sentences=("All done.",), out_dir=str(tmp_path))
    write_json(tmp_path / "run.json", told)
    (tmp_path / "recording.mcap").touch()
    assert command_line.run("watch", tmp_path / "recording.mcap") == 0
    captured = capsys.readouterr()
    assert captured.out == "All done.\n"
    assert f"{tmp_path} has ended" in captured.err


def test_a_frame_of_another_version_is_understood() -> None:
    from daemon.live.frame import LiveFrame

    document = msgspec.to_builtins(frame()) | {"added_later": 1}
    assert msgspec.json.decode(msgspec.json.encode(document), type=LiveFrame) == frame()
