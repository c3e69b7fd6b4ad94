"""Reads .npz recordings: t, q, tau and the optional arrays, by name."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from identification.errors import RecordingError
from identification.recordings.recording import FloatArray
from identification.recordings.table import RawTable

OPTIONAL_FIELDS = {
    "dq": "velocity",
    "q_cmd": "command_position",
    "q_link": "link_position",
    "tau_ext": "external_torque",
    "temperature": "temperature",
}


def read_npz(path: Path, robot: str | None) -> RawTable:  # noqa: ARG001 - one signature for all readers
    """Rows of a .npz file. Raises RecordingError for a file that is no .npz, or lacks t, q or tau."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            fields: dict[str, Any] = {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise RecordingError(f"{path.name}: cannot be read as .npz ({error})", file=path) from error
    for name in ("t", "q", "tau"):
        if name not in fields:
            raise RecordingError(
                f"{path.name}: field '{name}' is missing; it holds {', '.join(sorted(fields)) or 'nothing'}",
                file=path,
                field=name,
            )
    period = _scalar(path, fields, "period_s")
    unit = _text(fields.get("tau_unit"), "Nm")
    if unit not in ("Nm", "A"):
        raise RecordingError(f"{path.name}: tau_unit is '{unit}'; known are 'Nm' and 'A'", file=path, field="tau_unit")
    names = fields.get("joint_names")
    return RawTable(
        path=path,
        kind="npz",
        time=_numbers(path, fields, "t"),
        position=_numbers(path, fields, "q"),
        torque=_numbers(path, fields, "tau"),
        optional={ours: _numbers(path, fields, theirs) for theirs, ours in OPTIONAL_FIELDS.items() if theirs in fields},
        period_s=period if period else None,
        robot=resolve_robot(path, _text(fields.get("robot"), "")),
        joint_names=None if names is None else tuple(str(name) for name in np.ravel(names)),
        torque_unit=unit,
    )


def resolve_robot(path: Path, robot: str) -> str | None:
    """The robot a file names: a path relative to the file when such a file exists or is meant, else the name."""
    if not robot:
        return None
    beside = path.parent / robot
    if beside.exists() or Path(robot).suffix.lower() in (".urdf", ".csv", ".xml"):
        return str(beside)
    return robot


def _numbers(path: Path, fields: dict[str, Any], name: str) -> FloatArray:
    values = np.asarray(fields[name])
    if values.dtype.kind not in "fiu":
        raise RecordingError(
            f"{path.name}: field '{name}' holds {values.dtype} instead of real numbers", file=path, field=name
        )
    return np.asarray(values, dtype=np.float64)


def _scalar(path: Path, fields: dict[str, Any], name: str) -> float | None:
    if name not in fields:
        return None
    values = np.asarray(fields[name])
    if values.size != 1 or values.dtype.kind not in "fiu":
        raise RecordingError(f"{path.name}: field '{name}' must be one number", file=path, field=name)
    return float(values.reshape(()))


def _text(value: Any, default: str) -> str:
    if value is None or np.asarray(value).size != 1:
        return default
    text = np.asarray(value).reshape(()).item()
    return text.decode() if isinstance(text, bytes) else str(text)
