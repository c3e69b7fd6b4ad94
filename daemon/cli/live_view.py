"""The live view on a terminal, drawn ten times a second: below the lines of `run`, or by itself in `watch`.

In `run` it lives in a thread of its own, which reads the recorder's broadcast as any watcher does; the thread that
keeps the heartbeat never waits for it.
"""

from __future__ import annotations

import contextlib
import importlib.util
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer

from daemon.cli.output import message
from daemon.errors import ConfigurationError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from daemon.live.watcher import Watcher

REFRESH_S = 0.1


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Whether a run is served to viewers, and where."""

    live: Annotated[bool, typer.Option("--live", help="Serve it to Foxglove and PlotJuggler on this machine.")] = False
    address: Annotated[
        str | None,
        typer.Option(
            "--live-address", metavar="IP", help="Address for Foxglove; beyond loopback only with --live-key."
        ),
    ] = None
    key: Annotated[
        Path | None,
        typer.Option("--live-key", metavar="FILE", help="PEM with certificate and private key: Foxglove comes by TLS."),
    ] = None

    def server(self) -> list[str] | None:
        """Options of the server that they ask for; None where they ask for none.

        Raises ConfigurationError where it cannot be served, before anything moves, and MissingInputError.
        """
        from daemon.live.door import LOOPBACK, Door, require_free
        from daemon.live.server import FOXGLOVE_PORT, PLOTJUGGLER_PORT, layouts_folder

        if not self.live:
            if self.address is not None or self.key is not None:
                raise ConfigurationError("belongs to `--live`; give that too.", field="--live-address, --live-key")
            return None
        if importlib.util.find_spec("foxglove") is None:
            raise ConfigurationError(
                "the package foxglove-sdk is needed: pip install 'iiwa-ident[live]'.", field="--live"
            )
        door = Door.of(self.address, FOXGLOVE_PORT, self.key)
        require_free(door.address, door.port)
        require_free(LOOPBACK, PLOTJUGGLER_PORT)
        message(
            f"Live for Foxglove at {door.url}, for PlotJuggler (ZMQ Subscriber, JSON) at "
            f"tcp://{LOOPBACK}:{PLOTJUGGLER_PORT}; layouts for both in {layouts_folder()}."
        )
        return ["--address", door.address, *([] if self.key is None else ["--key", str(self.key)])]


class LiveScreen:
    """A part of the terminal that shows a watcher's newest screen; a context manager around rich's own."""

    def __init__(self, stream: TextIO, *, transient: bool) -> None:
        from rich.live import Live

        from daemon.cli.terminal import console_of

        self._console = console_of(stream)
        self._ascii_only = not self._console.encoding.lower().startswith("utf")
        self.live = Live(console=self._console, auto_refresh=False, transient=transient, vertical_overflow="crop")

    def show(self, watcher: Watcher) -> None:
        """Draw what the watcher knows now; nothing before it knows anything."""
        from daemon.live.screen import drawn

        screen = watcher.screen(width=self._console.width, ascii_only=self._ascii_only)
        if screen is not None:
            self.update(drawn(screen))

    def update(self, what: RenderableType) -> None:
        """Draw."""
        self.live.update(what, refresh=True)


@contextmanager
def live_thread(port: int, stream: TextIO) -> Iterator[None]:
    """Show the run on a UDP port while the block lasts; an error in here ends the view and says so, nothing else."""
    done = threading.Event()
    screen = LiveScreen(stream, transient=True)

    def draw() -> None:
        try:
            _follow(port, screen, done)
        except Exception as error:
            if not done.is_set():
                message(f"[warning] The live view ended: {type(error).__name__}: {error}. The run goes on.")

    thread = threading.Thread(target=draw, name="live view", daemon=True)
    with screen.live:
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join(2.0)


def _follow(port: int, screen: LiveScreen, done: threading.Event) -> None:
    from daemon.live.subscription import LiveSubscription
    from daemon.live.watcher import Watcher

    watcher = Watcher()
    with LiveSubscription(port) as subscription:
        while not done.wait(REFRESH_S):
            watcher.take(subscription.receive(0.0))
            screen.show(watcher)
            if watcher.newest is not None and watcher.newest.ended:
                return


@contextmanager
def live_served(port: int, options: list[str] | None) -> Iterator[None]:
    """Serve the run on a UDP port by a process of its own while the block lasts; options: of `LiveOptions.server`."""
    from daemon.children import child_environment, ended_within

    if options is None:
        yield
        return
    process = subprocess.Popen(
        [sys.executable, "-m", "daemon.live.server", "--port", str(port), *options],
        stdin=subprocess.PIPE, start_new_session=True, env=child_environment(),
    )  # fmt: skip
    try:
        yield
    finally:
        assert process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.close()
        ended_within(process, 5.0)
