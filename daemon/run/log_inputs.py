"""What goes into a log besides samples: the metadata record and the attachments, from the recorder's job."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import msgspec
import numpy as np

from daemon.api import RecorderJob, RunRequest
from daemon.config import read_settings
from daemon.host import host_report
from daemon.log.writer import Attachment
from daemon.motion.tool import Tool
from daemon.motion.workspace_file import WorkspaceFile
from daemon.run.ladder import tags
from daemon.run.spare_folder import find_run_file
from daemon.times import now_text

DESCRIPTION_NAME = "robot.urdf"
"""What the run's folder calls the description of a built-in arm, which has no URDF of its own."""


def metadata_of(job: RecorderJob) -> dict[str, str]:
    """The metadata record of a run; send period and samples per period are added with the first sample."""
    request = job.request
    samples = np.load(request.table_file, mmap_mode="r").shape[0] if Path(request.table_file).is_file() else 0
    return {
        "run_id": request.run_id,
        "robot": request.robot,
        "fri_version": request.fri_version,
        "period_s": repr(samples * request.table_period_s),
        "periods": str(0 if request.monitor_only else request.periods),
        "samples_per_period": str(samples),
        "lead_in_s": repr(request.lead_in_s),
        "amplitude": repr(request.amplitude),
        **tags(request),
        "date": now_text(),
        "serial": request.serial or "",
        "tool": request.tool,
        **({} if request.gravity_m_s2 is None else {"installation": _stand_of(request.gravity_m_s2)}),
        **_tool_of(request).tags(),
        "seed": "" if request.seed is None else str(request.seed),
        "part": str(job.part),
    }


def _stand_of(gravity: tuple[float, float, float]) -> str:
    """As imported logs note it, which readers take for the arm that is fitted."""
    return json.dumps({"gravity_m_s2": list(gravity), "locked_joints": {}})


def _tool_of(request: RunRequest) -> Tool:
    """The tool with its load data: they stand in the run's workspace file."""
    if request.workspace_file is None or not Path(request.workspace_file).is_file():
        return Tool()
    return read_settings(request.workspace_file, WorkspaceFile, "workspace").tool or Tool()


def description_of(job: RecorderJob) -> str:
    """URDF text for /robot_description: the request's file, else the run's description of a built-in arm, else ""."""
    file = _urdf_file(job)
    return "" if file is None else file.read_text(encoding="utf-8")


def attachments_of(job: RecorderJob) -> list[Attachment]:
    """Resolved request, host report, trajectory, table and URDF, as far as they exist."""
    request = job.request
    found = [
        Attachment("request.json", "application/json", msgspec.json.encode(request)),
        Attachment("host_report.json", "application/json", msgspec.json.encode(host_report())),
    ]
    for file, media_type in (
        (Path(request.trajectory_file), "application/json"),
        (Path(request.table_file), "application/octet-stream"),
        (_urdf_file(job), "application/xml"),
        (None if request.workspace_file is None else Path(request.workspace_file), "application/yaml"),
        (Path(request.out_dir) / "preflight.json", "application/json"),
    ):
        if file is not None and file.is_file():
            found.append(Attachment(file.name, media_type, file.read_bytes()))
    return found


def closing_attachments_of(job: RecorderJob) -> list[Attachment]:
    """What the loop left in the run's folder: its report (with what the system gave it of real time) and, after a stop
    or a drop, the last samples; as far as they exist and can be read.
    """
    found = []
    for name in ("last_samples.csv", "last_samples.json", "loop_report.json"):
        file = find_run_file(job.request, name)
        if file.is_file():
            with contextlib.suppress(OSError):
                media_type = _MEDIA_TYPES.get(file.suffix, "application/octet-stream")
                found.append(Attachment(file.name, media_type, file.read_bytes()))
    return found


_MEDIA_TYPES = {".json": "application/json", ".csv": "text/csv"}


def _urdf_file(job: RecorderJob) -> Path | None:
    file = Path(job.request.urdf_file or Path(job.request.out_dir) / DESCRIPTION_NAME)
    return file if file.is_file() else None
