"""The main job without a robot: a fake iiwa 14 in its own process, recorded over FRI, identified by the worker.

The fake robot is started as a program and never imported; what it hides and its true
parameters are read from the file it writes when it ends, after the diagnosis is done.
"""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.api import RunEvent, RunOutcome
from daemon.children import ended_within
from daemon.errors import ChildProcessFailedError
from daemon.folders import make_folder
from daemon.motion.preparation import PreparedMotion, write_run_request
from daemon.run.service import run_acquisition
from daemon.seal import opened
from identification.base_parameters import BaseRegressor
from identification.physical_parameters import PhysicalParameters

_END_ALLOWANCE_S = 20.0
_START_ALLOWANCE_S = 60.0
_SEALED = "sealed effect"


def free_udp_port() -> int:
    """A UDP port on loopback that nobody holds at the moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def fake_robot(
    port: int, summary: Path, *, seed: int, hidden_effect: int | None, realtime: bool
) -> Iterator[str | None]:
    """A fake robot process that sends to `port` while the block runs, and writes `summary` when it ends.

    hidden_effect: seed of an effect that it draws and seals; the block gets the hash it publishes, None without one.
    Raises ChildProcessFailedError when it wrote no summary.
    """
    command = [sys.executable, "-m", "fixtures.fake_robot", "--client", f"127.0.0.1:{port}"]
    command += ["--seed", str(seed), "--json", str(summary)]
    command += [] if realtime else ["--lockstep"]
    command += [] if hidden_effect is None else ["--hidden-effect", str(hidden_effect)]
    with (summary.with_suffix(".log")).open("wb") as log:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            yield None if hidden_effect is None else _published(process, summary.with_suffix(".log"))
        finally:
            process.send_signal(signal.SIGTERM)
            ended_within(process, _END_ALLOWANCE_S)
    if not summary.is_file():
        raise ChildProcessFailedError("fake robot", process.returncode, log_tail(summary.with_suffix(".log")))


def _published(process: subprocess.Popen[bytes], log: Path) -> str:
    """The hash in the fake robot's log, once it stands there. Raises ChildProcessFailedError."""
    deadline = time.monotonic() + _START_ALLOWANCE_S
    while process.poll() is None and time.monotonic() < deadline:
        for line in log.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True):
            if line.startswith(_SEALED) and line.endswith("\n"):
                return line.split()[-1]
        time.sleep(0.05)
    raise ChildProcessFailedError("fake robot", process.returncode, log_tail(log))


def opened_effect(summary: Path, commitment: str) -> dict[str, Any]:
    """The hidden effect's label from a fake robot's summary. Raises SealBrokenError if its hash is not `commitment`."""
    seal = json.loads(summary.read_text(encoding="utf-8"))["seal"]
    return opened(str(summary), commitment, seal)


def log_tail(file: Path) -> str:
    """The last lines of a text file."""
    return "\n".join(file.read_text(encoding="utf-8", errors="replace").splitlines()[-5:])


def record(
    motion: PreparedMotion,
    folder: Path,
    *,
    periods: int,
    seed: int,
    realtime: bool,
    fit: bool,
    observe: Callable[[RunEvent], None],
    hidden_effect: int | None = None,
    publish: Callable[[str], None] | None = None,
    heldout: tuple[str, ...] = (),
) -> RunOutcome:
    """One acquisition against a fresh fake robot; its summary ends up as `fake_robot.json` in the folder.

    fit: fit and diagnose afterwards, checked on the recordings `heldout`. publish: is given the hash of the effect that
    is drawn from the seed hidden_effect, before anything moves.
    """
    make_folder(folder)
    port = free_udp_port()
    request = write_run_request(
        motion,
        folder,
        periods=periods,
        bind_port=port,
        fit=fit,
        diagnose=fit,
        heldout=heldout,
        seed=seed,
        simulation=True,
    )
    summary = folder / "fake_robot.json"
    with fake_robot(port, summary, seed=seed, hidden_effect=hidden_effect, realtime=realtime) as commitment:
        if publish is not None and commitment is not None:
            publish(commitment)
        return run_acquisition(request, observe=observe)


def true_base_parameters(summary: Path, regressor: BaseRegressor) -> NDArray[np.float64]:
    """(p,) the plant's base parameters, from the physical parameters in a fake robot's summary."""
    truth: dict[str, Any] = json.loads(summary.read_text(encoding="utf-8"))["truth"]
    links = truth["links"]
    physical = PhysicalParameters(
        mass=np.array([link["mass"] for link in links]),
        center_of_mass=np.array([link["center_of_mass"] for link in links]),
        inertia=np.array([link["inertia"] for link in links]),
        viscous=np.array([link["viscous"] for link in links]),
        coulomb=np.array([link["coulomb"] for link in links]),
    )
    return regressor.base_from_physical(physical)
