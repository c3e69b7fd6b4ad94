"""The command `watch`: the run that goes on, seen from another terminal. It only reads."""

from __future__ import annotations

import contextlib
import math
import shlex
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from daemon.cli.app import app
from daemon.cli.live_view import REFRESH_S, LiveOptions, LiveScreen, live_served
from daemon.cli.option_groups import grouped
from daemon.cli.output import data, data_lines, message, wants_json_on_stdout
from daemon.cli.protection import in_its_folder, not_a_recording
from daemon.errors import DaemonError, MissingInputError

if TYPE_CHECKING:
    from daemon.live.frame import LiveFrame
    from daemon.live.subscription import LiveSubscription
    from daemon.live.watcher import Watcher

_SILENCE_S = 10.0
"""A recorder speaks twice a second; one that has not for so long is held or gone."""

_WORD_S = 1.2
"""Within so long a recorder that lives has spoken."""


class NothingToWatchError(DaemonError):
    """No run is being recorded where one was looked for."""

    exit_code = 69


@app.command()
@grouped
def watch(
    run: Annotated[
        Path | None, typer.Argument(metavar="[RUN]", help="Folder of the run; without one, the run that goes on.")
    ] = None,
    *,
    port: Annotated[int | None, typer.Option("--port", help="UDP port of the run, where several go on.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Print one screen and leave.")] = False,
    live: LiveOptions,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="FILE", help="Frames as JSON, one a line; '-' = stdout.", callback=not_a_recording
        ),
    ] = None,
) -> None:
    """See a run as it goes on: phase, time left, link, and each joint beside its limits and the model. It only reads.

    Any number of watchers cost the run nothing; Ctrl-C ends the watching, not the run. Piped: a line for each phase or
    period.

    Example: iiwa-ident watch
    """
    from daemon.live.subscription import LiveSubscription
    from daemon.live.watcher import Watcher

    if run is not None and run.is_file():
        run = run.parent  # a file of the run was named, such as its recording
    if run is not None and (run / "run.json").is_file():
        _show_ended(run)
        return
    watcher = Watcher()
    with contextlib.ExitStack() as stack:
        found = _port_of(run, port)
        stack.enter_context(live_served(found, live.server()))
        subscription = stack.enter_context(LiveSubscription(found))
        with contextlib.suppress(KeyboardInterrupt):
            if json_file is not None:
                on_stdout = wants_json_on_stdout(json_file)
                file = None if on_stdout else stack.enter_context(in_its_folder(json_file).open("w", encoding="utf-8"))
                _write_frames(subscription, file or sys.stdout)
            elif once:
                _follow_once(subscription, watcher)
            elif sys.stdout.isatty():
                _follow_on_screen(subscription, watcher)
            else:
                _follow_in_lines(subscription, watcher)
    if watcher.newest is not None and watcher.newest.ended:
        data(f"The recording ended. {watcher.newest.event}".strip())
        if watcher.remark:
            data(watcher.remark)
        _show_account(watcher.newest, found)


def _port_of(run: Path | None, port: int | None) -> int:
    """The UDP port to listen for. Raises MissingInputError for a folder without a run, NothingToWatchError."""
    from daemon.api import RunRequest
    from daemon.json_files import read_json
    from daemon.live.subscription import served_ports
    from daemon.runtime_folder import port_has_holder

    if run is not None:
        if not run.is_dir():
            raise MissingInputError(str(run), "the folder of a run")
        if not (run / "request.json").is_file():
            raise MissingInputError(str(run / "request.json"), "what a run was asked for: name the folder of a run")
        own = read_json(run / "request.json", RunRequest).bind_port
        if own not in served_ports() and not port_has_holder(own):
            raise NothingToWatchError(
                f"Nobody records into {run} any more: its run was broken off. `iiwa-ident recover "
                f"{shlex.quote(str(run))}` makes its recording whole."
            )
        return own
    served = served_ports()
    if port is not None:
        if port not in served:
            raise NothingToWatchError(f"No run is being recorded on UDP port {port} by this user.")
        return port
    if not served:
        raise NothingToWatchError("No run is being recorded by this user; `watch` sees one from its start to its end.")
    if len(served) > 1:
        speaking = _speaking(served)
        if not speaking:
            raise NothingToWatchError("No run is being recorded by this user; what killed ones left says nothing.")
        if len(speaking) > 1:
            raise typer.BadParameter(f"runs on UDP ports {', '.join(map(str, speaking))}: say --port.")
        return speaking[0]
    return served[0]


def _speaking(ports: list[int]) -> list[int]:
    """Those with a recorder that lives; all are asked at once, for a killed one leaves its socket."""
    from daemon.live.subscription import LiveSubscription

    with contextlib.ExitStack() as stack:
        asked = {port: stack.enter_context(LiveSubscription(port)) for port in ports}
        time.sleep(_WORD_S)
        return [port for port, subscription in asked.items() if subscription.receive(0.0)]


def _follow_on_screen(subscription: LiveSubscription, watcher: Watcher) -> None:
    screen = LiveScreen(sys.stdout, transient=False)
    deadline = time.monotonic() + _SILENCE_S
    with screen.live:
        while watcher.newest is None or not watcher.newest.ended:
            time.sleep(REFRESH_S)
            frames = subscription.receive(0.0)
            watcher.take(frames)
            screen.show(watcher)
            if frames:
                deadline = time.monotonic() + _SILENCE_S
            elif time.monotonic() > deadline - _SILENCE_S + _WORD_S:
                watcher.take(_frames(subscription, deadline))


def _follow_in_lines(subscription: LiveSubscription, watcher: Watcher) -> None:
    said = ("", -2)
    while watcher.newest is None or not watcher.newest.ended:
        watcher.take(_frames(subscription))
        frame = watcher.newest
        assert frame is not None
        if (frame.phase, frame.period) != said:
            said = (frame.phase, frame.period)
            place = f", period {frame.period + 1} of {frame.periods}" if frame.period >= 0 else ""
            data(
                f"{frame.run_id}: {frame.phase.lower().replace('_', ' ')}{place}; {frame.received} received, "
                f"{frame.late} late, {frame.missing} missing. {watcher.remark}".rstrip()
            )
            sys.stdout.flush()


def _follow_once(subscription: LiveSubscription, watcher: Watcher) -> None:
    """One screen, as soon as the motion of the arm is known, or of a link on which nothing moves."""
    from daemon.cli.terminal import console_of
    from daemon.live.screen import drawn

    deadline = math.inf
    while True:
        known = watcher.take(_frames(subscription))
        # Counted from here: with the first frames the model is loaded, which a busy machine takes seconds for.
        deadline = min(deadline, time.monotonic() + 1.0)
        ascii_only = not (sys.stdout.encoding or "").lower().startswith("utf")
        screen = watcher.screen(width=shutil.get_terminal_size((120, 40)).columns, ascii_only=ascii_only)
        if screen is not None and (known or time.monotonic() > deadline):
            console_of(sys.stdout).print(drawn(screen))
            return


def _write_frames(subscription: LiveSubscription, stream: TextIO) -> None:
    import msgspec

    ended = False
    while not ended:
        for frame in _frames(subscription):
            stream.write(msgspec.json.encode(frame).decode() + "\n")
            ended = frame.ended
        stream.flush()


def _frames(subscription: LiveSubscription, deadline: float | None = None) -> list[LiveFrame]:
    """The next ones. Raises NothingToWatchError: at once where nobody is left who could send any, else after deadline
    (of time.monotonic; None: 10 s from now).
    """
    from daemon.live.subscription import served_ports
    from daemon.runtime_folder import port_has_holder

    deadline = time.monotonic() + _SILENCE_S if deadline is None else deadline
    while True:
        # Asked before it is listened: the last frame may come after a silence, and its sender is gone right after it.
        nobody_is_left = subscription.port not in served_ports() and not port_has_holder(subscription.port)
        if frames := subscription.receive(_WORD_S):
            return frames
        if nobody_is_left:
            raise NothingToWatchError(
                "The recording has ended; run.json in the run's folder says how. If there is none, the run was killed: "
                "look at the arm, then `iiwa-ident recover FOLDER`."
            )
        if time.monotonic() > deadline:
            raise NothingToWatchError(f"No word from the recorder for {_SILENCE_S:g} s; the run may go on unseen.")


def _show_account(last: LiveFrame, port: int) -> None:
    """What run.json says beyond the last word of the recorder, which does not see how a killed loop left the arm."""
    from daemon.api import RunOutcome
    from daemon.json_files import read_json
    from daemon.runtime_folder import port_has_holder

    account, deadline = Path(last.folder) / "run.json", time.monotonic() + _SILENCE_S
    # Its writer is asked first: it may be gone as soon as it has written.
    while port_has_holder(port) and not account.is_file() and time.monotonic() < deadline:
        time.sleep(REFRESH_S)
    try:
        sentences = read_json(account, RunOutcome).sentences
    except DaemonError:
        message(f"Nothing says yet how the run ended; look at the arm, and into {account} later.")
        return
    data_lines([sentence for sentence in sentences if sentence != last.event])


def _show_ended(run: Path) -> None:
    from daemon.api import RunOutcome
    from daemon.json_files import read_json

    outcome = read_json(run / "run.json", RunOutcome)
    message(f"{run} has ended; there is nothing live to see.")
    data_lines(outcome.sentences)
