"""The long-running service as a real process, for tests: started, asked, killed."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil

from daemon.queue.control_api import ControlReply, ControlRequest, GetJobs, GetStatus, JobsReply, JobView, StatusReply
from daemon.queue.control_socket import ServiceUnreachableError, ask
from daemon.runtime_folder import default_endpoint
from tests.ports import free_udp_port
from tests.watchdog import WATCHDOG_S

REPOSITORY = Path(__file__).resolve().parents[2]
COMMAND = [sys.executable, "-c", "from daemon.cli import main; main()"]


def iiwa_ident(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *map(str, words)], cwd=REPOSITORY, capture_output=True, text=True, timeout=WATCHDOG_S, check=False
    )


def wait_for(condition: Callable[[], Any], allowance_s: float = WATCHDOG_S) -> Any:
    """What the condition returns once it is true."""
    for _ in range(int(allowance_s / 0.1)):
        found = condition()
        if found:
            return found
        time.sleep(0.1)
    raise AssertionError("what was waited for did not happen")


class ServiceProcess:
    """One service on a port of its own; restartable, since its files stay."""

    def __init__(self, folder: Path, *, control: dict[str, str] | None = None, **fri: Any) -> None:
        self.folder = folder
        self.port = free_udp_port()
        self.output = folder / "runs"
        settings = {"bind_port": self.port, "start_timeout_s": 120.0, "receive_timeout_s": 60.0, **fri}
        self.config = folder / "service.yaml"
        document = {"fri": settings, "realtime": {"priority": 0}, "run": {"fit": False}, "control": control or {}}
        self.config.write_text(json.dumps({**document, "output": str(self.output)}))
        self.endpoint = default_endpoint(self.port)
        self.log = folder / "service.log"

    def start(self, **environment: str) -> None:
        """Start it and wait until it answers."""
        self.launch(**environment)
        wait_for(self._answers)

    def launch(self, **environment: str) -> None:
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [*COMMAND, "daemon", "--config", str(self.config)],
                cwd=REPOSITORY,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, **environment},
            )

    def _answers(self) -> bool:
        try:
            self.status()
        except ServiceUnreachableError:
            assert self.process.poll() is None, self.log.read_text()
            return False
        return True

    def ask(self, request: ControlRequest) -> ControlReply:
        return ask(self.endpoint, request, timeout_s=WATCHDOG_S)

    def status(self) -> StatusReply:
        reply = self.ask(GetStatus())
        assert isinstance(reply, StatusReply)
        return reply

    def jobs(self) -> dict[str, JobView]:
        reply = self.ask(GetJobs())
        assert isinstance(reply, JobsReply)
        return {job.job_id: job for job in reply.jobs}

    def phase(self, job_id: str) -> str:
        return self.jobs()[job_id].phase

    def wait_phase(self, job_id: str, *phases: str, allowance_s: float = WATCHDOG_S) -> JobView:
        wait_for(lambda: self.phase(job_id) in phases, allowance_s)
        return self.jobs()[job_id]

    def kill(self) -> None:
        """Whatever is left of it, its children first."""
        with contextlib.suppress(psutil.Error):
            children = psutil.Process(self.process.pid).children(recursive=True)
            self.process.kill()
            for child in children:
                with contextlib.suppress(psutil.Error):
                    child.kill()
        self.process.wait()


def until_excitation(running: ServiceProcess, job_id: str) -> None:
    """Wait until the run of this job drives its periods; fails where it ends before."""

    def there() -> bool:
        job = running.jobs()[job_id]
        assert job.phase in ("checking", "queued", "preparing", "running"), job.sentence
        return running.status().motion_phase == "EXCITATION"

    wait_for(there)


@contextlib.contextmanager
def service(folder: Path, **fri: Any) -> Iterator[ServiceProcess]:
    """A started service; killed at the end if it lives."""
    running = ServiceProcess(folder, **fri)
    running.start()
    try:
        yield running
    finally:
        running.kill()


@contextlib.contextmanager
def fake_robot(port: int, *options: object) -> Iterator[subprocess.Popen[bytes]]:
    """A fake robot in lockstep that sends to `port`."""
    words = ["--client", f"127.0.0.1:{port}", "--lockstep", "--duration", 600, "--seed", 3, *options]
    process = subprocess.Popen(
        [sys.executable, "-m", "fixtures.fake_robot", *map(str, words)], cwd=REPOSITORY, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        process.terminate()
        process.wait(WATCHDOG_S)
