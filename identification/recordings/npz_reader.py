"""Reads .npz recordings: t, q, tau and the optional arrays, by name."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import IO, Any

import numpy as np

from identification.arrays import FloatArray
from identification.errors import RecordingError, reason_of
from identification.recordings.table import RawTable
from identification.recordings.unpacking import Allowance

OPTIONAL_FIELDS = {
    "dq": "velocity",
    "q_cmd": "command_position",
    "q_link": "link_position",
    "tau_ext": "external_torque",
    "temperature": "temperature",
}
BROKEN_ARCHIVE = (ValueError, KeyError, OSError, EOFError, NotImplementedError, zlib.error, zipfile.BadZipFile)
"""What zipfile and numpy raise for bytes that are no .npz."""
UNIT_FIELDS = {"t_unit": "t", "q_unit": "q", "dq_unit": "dq", "tau_unit": "tau"}
"""Field of a file and the quantity whose unit it states."""
_STATES_A_UNIT = re.compile(
    r"((t|time|d?q|tau|positions?|velocity|velocities|torques?|efforts?|angles?|joints?|currents?)_?)?units?"
)
"""What whoever states a unit may call the field, in small letters."""


KNOWN_FIELDS = ("t", "q", "tau", *OPTIONAL_FIELDS, "period_s", "tau_unit", "robot", "joint_names", *UNIT_FIELDS)


def load_arrays(file: Path | IO[bytes], allowance: Allowance, wanted: Collection[str] | None = None) -> dict[str, Any]:
    """The arrays of an .npz by name, those of `wanted` where it is given; no more is unpacked than `allowance` grants.

    Raises RecordingError for more than that, and what zipfile and numpy raise for other bytes.
    """
    with zipfile.ZipFile(file) as archive:
        members = {item.filename.removesuffix(".npy"): item for item in archive.infolist()}
        chosen = {name: item for name, item in members.items() if wanted is None or name in wanted}
        allowance.take(sum(item.file_size for item in chosen.values()))
        # A ZIP member gives no more bytes than it states; an array's header is not believed beyond those.
        return {
            name: np.lib.format.read_array(io.BytesIO(archive.read(item)), allow_pickle=False)
            for name, item in chosen.items()
        }


def read_npz(path: Path) -> list[RawTable]:
    """Rows of a .npz file. Raises RecordingError for a file that is no .npz, or lacks t, q or tau."""
    try:
        fields = load_arrays(path, Allowance(path), KNOWN_FIELDS)
        held = zipfile.ZipFile(path).namelist()
    except RecordingError:
        raise
    except (*BROKEN_ARCHIVE, MemoryError) as error:
        raise RecordingError.named(path, f"cannot be read as .npz ({reason_of(error)})") from error
    for name in ("t", "q", "tau"):
        if name not in fields:
            raise RecordingError.named(
                path,
                f"field '{name}' is missing; it holds "
                f"{', '.join(sorted(item.removesuffix('.npy') for item in held)[:30]) or 'nothing'}",
                field=name,
            )
    refuse_unknown_units(path, (item.removesuffix(".npy") for item in held))
    names = fields.get("joint_names")
    table = RawTable(
        path=path,
        kind="npz",
        time=_numbers(path, fields, "t"),
        position=_numbers(path, fields, "q"),
        torque=_numbers(path, fields, "tau"),
        optional={ours: _numbers(path, fields, theirs) for theirs, ours in OPTIONAL_FIELDS.items() if theirs in fields},
        period_s=_scalar(path, fields, "period_s"),
        robot=resolve_robot(path, _text(fields.get("robot"), "")),
        joint_names=None if names is None else tuple(_text(name, "") for name in np.ravel(names)),
        units={quantity: _text(fields[name], "") for name, quantity in UNIT_FIELDS.items() if name in fields},
    )
    return [table]


def resolve_robot(path: Path, robot: str) -> str | None:
    """The robot a file names: a path relative to the file when such a file exists or is meant, else the name."""
    if not robot:
        return None
    beside = path.parent / robot
    if beside.exists() or Path(robot).suffix.lower() in (".urdf", ".csv", ".xml"):
        return str(beside)
    return robot


def refuse_unknown_units(path: Path, names: Iterable[str]) -> None:
    """Raises RecordingError for a field like `q_units` or `unit`: who wrote it stated a unit that nobody would heed."""
    for name in names:
        if name not in UNIT_FIELDS and _STATES_A_UNIT.fullmatch(name.lower()):
            raise RecordingError.named(
                path,
                f"field '{name}' states no unit that is known; known are {', '.join(UNIT_FIELDS)}. If it says "
                "nothing of these numbers, rename it or take it out",
                field=name,
            )


def _numbers(path: Path, fields: dict[str, Any], name: str) -> FloatArray:
    values = np.asarray(fields[name])
    if values.dtype.kind not in "fiu":
        raise RecordingError.named(path, f"field '{name}' holds {values.dtype} instead of real numbers", field=name)
    return np.asarray(values, dtype=np.float64)


def _scalar(path: Path, fields: dict[str, Any], name: str) -> float | None:
    if name not in fields:
        return None
    values = np.asarray(fields[name])
    if values.size != 1 or values.dtype.kind not in "fiu":
        raise RecordingError.named(path, f"field '{name}' must be one number", field=name)
    return float(values.reshape(()))


def _text(value: Any, default: str) -> str:
    if value is None or np.asarray(value).size != 1:
        return default
    text = np.asarray(value).reshape(()).item()
    return text.decode() if isinstance(text, bytes) else str(text)
