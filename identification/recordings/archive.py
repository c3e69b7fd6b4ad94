"""A Recording as one block of bytes and back, bit by bit: the attachment by which an imported log keeps its arrays.

ROS messages round time to nanoseconds and know neither second encoders nor temperatures; the attachment keeps what the
import had.
"""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np

from identification.errors import RecordingError, RobotError
from identification.recordings.npz_reader import BROKEN_ARCHIVE, load_arrays, resolve_robot
from identification.recordings.recording import OF_ROWS, ImportReport, Recording, RecordingSource
from identification.recordings.unpacking import Allowance
from identification.robots.installation import Installation

ATTACHMENT_NAME = "recording.npz"
FORMAT = "iiwa-ident/recording/1"


def pack(recording: Recording, *, robot: str | None = None) -> bytes:
    """All of a recording as the bytes of a compressed .npz; float64 and int64 arrays are kept bit by bit.

    robot: what to note as the robot, a path relative to the log where it is a file.
    """
    description = {
        "format": FORMAT,
        "sampling_period_s": recording.sampling_period_s,
        "robot": robot,
        "joint_names": recording.joint_names,
        "installation": recording.installation.to_json(),
        "torque_unit": recording.torque_unit,
        "period_s": recording.period_s,
        "samples_per_period": recording.samples_per_period,
        "source": {
            "path": Path(recording.source.path).name,
            "sha256": recording.source.sha256,
            "kind": recording.source.kind,
            "metadata": recording.source.metadata,
        },
        "report": recording.report.to_json(),
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, description=np.array(json.dumps(description)), **recording.arrays(OF_ROWS))
    return buffer.getvalue()


def unpack(data: bytes, path: Path) -> Recording:
    """The recording that `pack` wrote; path is the file it stands in.

    The source's name, digest and report stay those of the original file. Raises RecordingError for other bytes.
    """
    try:
        arrays = load_arrays(io.BytesIO(data), Allowance(path))
        description = json.loads(str(arrays.pop("description")))
        if description["format"] != FORMAT:
            raise ValueError(f"its format is {description['format']}")
        source = description["source"]
        names = description["joint_names"]
        return Recording(
            sampling_period_s=float(description["sampling_period_s"]),
            source=RecordingSource(
                str(path), source["sha256"], source["kind"], {**source["metadata"], "imported_from": source["path"]}
            ),
            report=ImportReport.from_json(description["report"]),
            robot=resolve_robot(path, description["robot"] or ""),
            joint_names=None if names is None else tuple(names),
            installation=Installation.from_json(description.get("installation")),
            torque_unit=description["torque_unit"],
            period_s=description["period_s"],
            samples_per_period=description["samples_per_period"],
            **arrays,
        )
    except RecordingError:
        raise
    except (*BROKEN_ARCHIVE, TypeError, MemoryError, RobotError) as error:
        raise RecordingError.named(path, f"its attachment {ATTACHMENT_NAME} cannot be read ({error})") from error
