"""What goes into a log besides samples: the metadata record and the attachments, from the recorder's job."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from daemon.api import RecorderJob
from daemon.host import host_report
from daemon.log.writer import Attachment

__all__ = ["attachments_of", "metadata_of"]


def metadata_of(job: RecorderJob) -> dict[str, str]:
    """The metadata record of a run; send period and samples per period are added with the first sample."""
    request = job.request
    samples = np.load(request.table_file, mmap_mode="r").shape[0] if Path(request.table_file).is_file() else 0
    return {
        "run_id": request.run_id,
        "robot": request.robot,
        "fri_version": request.fri_version,
        "period_s": repr(samples * request.table_period_s),
        "periods": str(request.periods),
        "samples_per_period": str(samples),
        "lead_in_s": repr(request.lead_in_s),
        "amplitude": repr(request.amplitude),
        "tool": request.tool,
        "seed": "" if request.seed is None else str(request.seed),
        "part": str(job.part),
    }


def attachments_of(job: RecorderJob) -> list[Attachment]:
    """Resolved request, trajectory, table, URDF and host report, as far as they exist."""
    request = job.request
    found = [
        Attachment("request.json", "application/json", msgspec.json.encode(request)),
        Attachment("host_report.json", "application/json", msgspec.json.encode(host_report())),
    ]
    for file, media_type in (
        (request.trajectory_file, "application/json"),
        (request.table_file, "application/octet-stream"),
        (request.urdf_file, "application/xml"),
    ):
        if file and Path(file).is_file():
            found.append(Attachment(Path(file).name, media_type, Path(file).read_bytes()))
    return found
