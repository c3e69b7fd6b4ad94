"""The main job without a robot: a fake iiwa 14 in its own process, recorded over FRI, identified by the worker.

Used by `iiwa-ident demo`. The fake robot is started as a program and never imported; its true parameters are read from
the file it writes when it ends, after the fit is done.
"""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.api import RunEvent, RunOutcome
from daemon.errors import ChildProcessFailedError
from daemon.preparation import PreparedMotion, write_run_request
from daemon.service import run_acquisition
from identification.base_parameters import BaseRegressor
from identification.estimators.physical import PhysicalParameters
from identification.robots import load_robot

ROBOT = "iiwa14"
_END_ALLOWANCE_S = 20.0


def free_udp_port() -> int:
    """A UDP port on loopback that nobody holds at the moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def fake_robot(port: int, summary: Path, *, seed: int, realtime: bool, fri_version: str) -> Iterator[None]:
    """A fake robot process that sends to `port` while the block runs, and writes `summary` when it ends.

    Raises ChildProcessFailedError when it wrote none.
    """
    command = [sys.executable, "-m", "fixtures.fake_robot", "--client", f"127.0.0.1:{port}"]
    command += ["--fri-version", fri_version, "--seed", str(seed), "--json", str(summary)]
    command += [] if realtime else ["--lockstep"]
    with (summary.with_suffix(".log")).open("wb") as log:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            yield
        finally:
            process.send_signal(signal.SIGTERM)
            try:
                process.wait(_END_ALLOWANCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
    if not summary.is_file():
        raise ChildProcessFailedError("fake robot", process.returncode, log_tail(summary.with_suffix(".log")))


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
    fri_version: str = "1.15",
) -> RunOutcome:
    """One acquisition against a fresh fake robot; its summary ends up as `fake_robot.json` in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    port = free_udp_port()
    request = write_run_request(
        motion,
        folder,
        periods=periods,
        bind_port=port,
        fri_version=fri_version,
        fit=fit,
        seed=seed,
        simulation=True,
        # In lockstep the robot waits for us; on a starved machine that may take a while without being a lost session.
        receive_timeout_s=0.5 if realtime else 5.0,
    )
    with fake_robot(port, folder / "fake_robot.json", seed=seed, realtime=realtime, fri_version=fri_version):
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


def demo_regressor() -> BaseRegressor:
    """The 57 base parameters of the demo's robot."""
    return BaseRegressor(load_robot(ROBOT))
