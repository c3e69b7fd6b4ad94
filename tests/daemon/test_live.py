"""Claims about the live view: what a watcher sees is what was recorded, and watching costs the recording nothing.

Truth: the samples that these tests push, closed forms of sinusoids, and noise whose size the test chose.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest
import zmq
from rich.console import Console

from daemon.api import RunOutcome
from daemon.cli import watch
from daemon.cli.watch import NothingToWatchError, _follow_once, _frames, _port_of
from daemon.json_files import write_json
from daemon.live.broadcast import LiveBroadcast
from daemon.live.frame import LiveFrame
from daemon.live.residual import LiveResidual, Modelled, PeriodNoise, noise_sentence
from daemon.live.screen import Screen, bar, drawn, remaining_s
from daemon.live.subscription import LiveSubscription, served_ports
from daemon.live.watcher import Watcher
from daemon.motion.torque_foresight import torque_foresight
from daemon.run.recorder import Recorder
from daemon.runtime_folder import runtime_folder
from fri_client.handover.ring import HandoverRing
from safety.limits import limits_for
from tests.daemon import command_line
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


def frame(**changes: Any) -> LiveFrame:
    known: dict[str, Any] = {
        "run_id": "one", "robot": "iiwa14", "folder": "", "timestamp": 0.0, "position": (0.1,) * 7,
        "torque": (1.0,) * 7, "external_torque": (0.0,) * 7, "phase": "EXCITATION", "period": 0, "periods": 4,
        "rows_per_period": 1000, "rows_per_frame": 10, "sample_in_period": 0,
    }  # fmt: skip
    return LiveFrame(**known | changes)


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


# ---- motion and model


def sinusoid(amplitude: float, frequency_hz: float, count: int, spacing_s: float = 0.01) -> list[LiveFrame]:
    """Frames of a motion that is known in closed form; each is the mean of ten samples, taken as at their middle."""
    times = np.arange(count) * spacing_s
    return [
        frame(robot_time_s=float(t), position=(amplitude * float(np.sin(2.0 * np.pi * frequency_hz * t)),) * 7)
        for t in times
    ]


def test_velocity_and_acceleration_are_those_of_the_closed_form() -> None:
    amplitude, frequency = 0.5, 0.5
    w = 2.0 * np.pi * frequency
    for each in LiveResidual(None).take(sinusoid(amplitude, frequency, 100)):
        t = each.frame.robot_time_s
        # Central differences err by h²/6 of the third and h²/12 of the fourth derivative.
        np.testing.assert_allclose(each.velocity, amplitude * w * np.cos(w * t), atol=amplitude * w**3 * 1e-4 / 6 * 1.1)
        np.testing.assert_allclose(
            each.acceleration, -amplitude * w**2 * np.sin(w * t), atol=amplitude * w**4 * 1e-4 / 12 * 1.1 + 1e-9
        )


def test_no_acceleration_is_taken_over_a_gap() -> None:
    frames = sinusoid(0.5, 0.5, 40)
    known = LiveResidual(None).take(frames[:10] + frames[30:])
    assert {round(each.frame.robot_time_s, 3) for each in known} == {
        round(0.01 * place, 3) for place in [*range(1, 9), *range(31, 39)]
    }


def test_at_rest_the_modelled_torque_is_gravity() -> None:
    foresight = torque_foresight("iiwa14")
    assert foresight is not None
    rest = (0.1, 0.4, -0.1, -1.2, 0.1, 0.9, 0.1)
    still = [frame(robot_time_s=0.01 * place, position=rest) for place in range(3)]
    (known,) = LiveResidual(foresight).take(still)
    row = foresight.regressor.matrix(np.array([rest]), np.zeros((1, 7)), np.zeros((1, 7))) @ foresight.values
    np.testing.assert_allclose(known.modelled, row[0], atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1.0, 3.0])
def test_the_ratio_to_the_noise_is_what_was_put_in(size: float) -> None:
    """An error of the model of `size` times the noise: the RMS of both together is sqrt(1 + size²) times the noise."""
    generator = np.random.default_rng(77)
    places, sigma = 4000, np.array([0.17, 0.17, 0.12, 0.12, 0.08, 0.04, 0.03])
    truth = 10.0 * np.sin(np.arange(places) / 200.0)
    noise = PeriodNoise(places)
    for period, place in itertools.product(range(3), range(places)):
        each = sigma * generator.standard_normal(7)
        noise.take(period, place, truth[place] + each, size * sigma + each)
        if period == 0:
            assert noise.ratio is None
    ratio = noise.ratio
    assert ratio is not None
    np.testing.assert_allclose(ratio, np.sqrt(1.0 + size**2), rtol=0.06)  # 4000 places: 5 σ of an RMS are 5.6 %


def test_what_a_late_message_did_to_the_torque_counts_neither_as_noise_nor_as_misfit() -> None:
    """A frame with 50 Nm too much right after each late message; all others are the model's own torque and 0.1 Nm."""
    foresight = torque_foresight("iiwa14")
    assert foresight is not None
    generator = np.random.default_rng(4)
    rest = (0.1, 0.4, -0.1, -1.2, 0.1, 0.9, 0.1)
    own = (foresight.regressor.matrix(np.array([rest]), np.zeros((1, 7)), np.zeros((1, 7))) @ foresight.values)[0]
    frames = []
    for number in range(300):
        late = 1 + number // 90
        shove = 50.0 * (number % 90 < 5)
        torque = tuple((own + shove + 0.1 * generator.standard_normal(7)).tolist())
        frames.append(
            frame(robot_time_s=0.01 * number, position=rest, torque=torque, late=late, period=number // 100,
                  sample_in_period=10 * (number % 100))
        )  # fmt: skip
    residual = LiveResidual(foresight)
    residual.take(frames)
    assert residual.ratio is not None
    assert np.all(residual.ratio < 1.5)


def test_the_sentence_names_the_joint_that_the_model_fits_worst() -> None:
    assert noise_sentence(None) == ""
    assert "noise" in noise_sentence(np.ones(7))
    assert noise_sentence(np.array([1.0, 1, 1, 3.12, 1, 1, 1])) == "Joint 4 is 3.12 × its noise."


# ---- the screen


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0, "·····│·····"), (1.0, "·····│█████"), (-0.5, "···██│·····"), (5.0, "·····│█████")],
)
def test_a_bar_reaches_as_far_as_the_share_of_the_limit(value: float, shown: str) -> None:
    assert bar(value, -1.0, 1.0).plain == shown


def test_a_bar_is_red_near_its_limit_and_never_longer_than_its_room() -> None:
    assert "red" in str(bar(0.95, -1.0, 1.0).style)
    assert "green" in str(bar(0.5, -1.0, 1.0).style)
    assert len(bar(1e9, -1.0, 1.0, mark=-1e9).plain) == 11


def test_the_time_that_remains_is_that_of_the_periods_left() -> None:
    assert remaining_s(frame(period=1, sample_in_period=250)) == pytest.approx(2.75)
    assert remaining_s(frame(phase="START_RAMP", period=-1, sample_in_period=-1)) == pytest.approx(4.0)
    assert remaining_s(frame(phase="HOLD")) is None


def text_of(screen: Screen, width: int) -> str:
    stream = io.StringIO()
    Console(file=stream, width=width, color_system=None).print(drawn(screen))
    return stream.getvalue()


def full_screen(width: int, *, ascii_only: bool = False) -> Screen:
    """With the longest numbers there are."""
    return Screen(
        frame(position=(-2.9,) * 7, torque=(-310.25,) * 7, external_torque=(-59.99,) * 7, received=1_234_567,
              session_state="COMMANDING_ACTIVE", quality="EXCELLENT", period=15, periods=16),
        limits_for("iiwa14"), velocity=np.full(7, -1.234), modelled=np.full(7, -299.75), ratio=np.full(7, 12.3),
        width=width, ascii_only=ascii_only,
    )  # fmt: skip


@pytest.mark.parametrize("width", [80, 100, 130])
@pytest.mark.parametrize("ascii_only", [False, True])
def test_a_screen_fits_its_terminal_and_cuts_no_number(width: int, ascii_only: bool) -> None:
    screen = full_screen(width, ascii_only=ascii_only)
    text = text_of(screen, width)
    assert "…" not in text
    assert all(len(line) <= width for line in text.splitlines())
    assert len(text.splitlines()) <= 12
    for number in ("-2.900", "-1.234", "-310.25", "-10.50", "12.3", "-59.99"):
        assert text.count(number) >= 7
    if ascii_only:
        assert text.isascii()


@pytest.mark.parametrize("width", [24, 40, 60, 76])
def test_a_terminal_too_narrow_for_bars_keeps_every_joint_and_its_numbers(width: int) -> None:
    """Before, the names of the joints were cut to one sign, and the numbers behind the velocity were gone."""
    numbers = ["-2.900", "-1.234", "-310.25", "-10.50", "12.3", "-59.99"]
    text = text_of(full_screen(width), width)
    rows = [line.split() for line in text.splitlines() if line.startswith("A")]
    assert rows == [[f"A{joint}", *numbers[: (width - 2) // 8]] for joint in range(1, 8)]
    assert "…" not in text


@pytest.mark.parametrize("width", [30, 40, 60, 79])
def test_lines_on_a_narrow_terminal_end_between_facts_and_in_none(width: int) -> None:
    """Before, "period 3 of" stood at the end of a line and "16" on the next, and the bar went round the corner."""
    screen = replace(full_screen(width), silent_s=3.0)
    lines = [line.rstrip() for line in text_of(screen, width).splitlines()]
    whole = [line.rstrip() for line in text_of(replace(screen, width=200), 200).splitlines()]
    heads = [fact for line in (whole[0], whole[2]) for fact in re.split("  +", line)]
    said = [fact for line in lines for fact in re.split("  +", line)]
    assert [fact for fact in said if fact in heads] == heads
    assert sum("remain" in line and "━" in line for line in lines) == 1


def test_joints_stay_where_they_were_last_seen_when_the_robot_is_silent() -> None:
    watcher = Watcher()
    watcher.take([frame(robot_time_s=0.01 * place) for place in range(3)])
    watcher.take([frame(position=None, torque=None, external_torque=None, received=42)])
    screen = watcher.screen()
    assert screen is not None
    assert screen.frame.received == 42
    assert screen.frame.position == (0.1,) * 7


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


def test_watch_without_a_run_says_so(private: Path, tmp_path: Path) -> None:
    nothing = watched(private)
    assert "No run is being recorded" in nothing.communicate(timeout=WATCHDOG_S)[1]
    assert nothing.returncode == 69
    missing = watched(private, str(tmp_path / "absent"))
    missing.communicate(timeout=WATCHDOG_S)
    assert missing.returncode == 66


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
