"""What a fault left behind: the result's fields read from the robot's summary and from the run's folder.

Readers of the file here share no code with its writer.
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rosbags.highlevel import AnyReader

from daemon.api import RunRequest
from daemon.run.spare_folder import files_elsewhere
from tests.end_to_end.processes import iiwa_ident

__all__ = ["FaultResult", "account_of", "examine", "matches", "outcome_of", "peaks_of", "what_the_arm_did"]

REST_RAD_S = 1e-6


@dataclass(frozen=True, slots=True)
class FaultResult:
    """What was measured.

    arm: see FaultCase; peaks: velocity, acceleration and jerk of the robot's set-points by its own clock, worst joint
    over its limit; judged_inside: no set-point was beyond one; speed_at_end: of the arm, rad/s; read: what the operator
    read last; samples, gap, answered_samples: in the file (None: no file); recovered: the file had to be made whole by
    `iiwa-ident recover` first. lost: between loop and file, by run.json; has_account: there was one at the end.
    """

    arm: str
    peaks: tuple[float, float, float]
    judged_inside: bool
    speed_at_end: float
    rejections: tuple[str, ...]
    robot_answered: int
    outcome: str | None
    exit_code: int
    read: str
    transcript: str
    samples: int | None
    answered_samples: int
    gap: int
    recovered: bool
    robot: dict[str, Any]
    left_running: tuple[str, ...]
    lost: int = 0
    has_account: bool = True

    def describe_file(self) -> str:
        """A cell of the table."""
        if self.samples is None:
            return "no file"
        how = "whole after `recover`" if self.recovered else "whole"
        lost = f"counters missing: {self.gap}" if self.gap else "no gap"
        return f"{how}, {self.samples} samples, {lost}"


def _places(folder: Path) -> list[Path]:
    """Where a run may have left its files: its own folder (copied from a small disk), and the spare one."""
    places = [folder / "kept", folder / "run"]
    for place in list(places):
        with contextlib.suppress(FileNotFoundError):
            request = msgspec.json.decode((place / "request.json").read_bytes(), type=RunRequest)
            places += {file.parent for file in files_elsewhere(request).values()}
    return places


def outcome_of(folder: Path) -> str | None:
    """Of run.json, or of the loop's own report where the supervisor wrote none."""
    for place in _places(folder):
        for name in ("run.json", "loop_report.json"):
            with contextlib.suppress(FileNotFoundError):
                return str(json.loads((place / name).read_text())["outcome"])
    return None


def account_of(folder: Path) -> dict[str, Any]:
    """run.json; empty where there is none."""
    for place in _places(folder):
        with contextlib.suppress(FileNotFoundError):
            return dict(json.loads((place / "run.json").read_text()))
    return {}


def what_the_arm_did(summary: dict[str, Any], outcome: str | None) -> str:
    departures = summary.get("departures", ())
    if not departures or not any(summary["peak_command"]["velocity_rad_s"]):
        return "none"
    first = departures[0]
    if first["last_command_speed_rad_s"] < REST_RAD_S:
        return "finished" if outcome == "completed" else "ramp"
    return "held" if first["set_point_speed_rad_s"] == 0.0 else "dropped"


def peaks_of(summary: dict[str, Any]) -> tuple[float, float, float]:
    """Worst velocity, acceleration and jerk over their limits, from the judge at the robot's side."""
    percent = summary["judgement"]["percent"] if summary else {}
    velocity, acceleration, jerk = (
        float(percent.get(name, 0.0)) / 100.0 for name in ("velocity", "acceleration", "jerk")
    )
    return velocity, acceleration, jerk


def examine(folder: Path) -> tuple[int | None, int, int, bool]:
    """Samples, samples that were answered, messages missing between them, and whether the file had to be recovered."""
    file = _recording(folder)
    if file is None:
        return None, 0, 0, False
    recovered = False
    try:
        rows = list(_states(file))
    except Exception:
        result = iiwa_ident("recover", file, "--json", "-")
        assert result.returncode == 0, result.stderr
        recovered = True
        rows = list(_states(Path(json.loads(result.stdout)["recovered"])))
    steps = np.diff(np.unique([counter for counter, _ in rows]))
    return len(rows), sum(answered for _, answered in rows), int((steps - 1).sum()), recovered


def _recording(folder: Path) -> Path | None:
    for place in _places(folder):
        with contextlib.suppress(FileNotFoundError, KeyError, IndexError):
            told = Path(json.loads((place / "run.json").read_text())["recordings"][0])
            if told.is_file():
                return told
        if (place / "recording.mcap").is_file():
            return place / "recording.mcap"
    return None


def _states(file: Path) -> Iterator[tuple[int, bool]]:
    """Sequence counter of every sample, and whether it was answered."""
    with AnyReader([file]) as bag:
        wanted = [each for each in bag.connections if each.topic == "/fri/state"]
        for connection, _, raw in bag.messages(wanted):
            state: Any = bag.deserialize(raw, connection.msgtype)
            yield state.sequence_counter, state.host_send_time_ns > 0


def matches(text: str, pattern: str) -> bool:
    """Whether the operator read it, wherever lines were broken."""
    return re.search(pattern, " ".join(text.split())) is not None
