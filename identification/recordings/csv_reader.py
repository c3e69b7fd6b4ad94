"""Reads .csv recordings: a header t,q1..qn,tau1..taun[,dq1..][,q_cmd1..][,tau_ext1..], then one row per sample.

What else a header may be, with units in it, says `headers`.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection
from pathlib import Path

import numpy as np

from identification.arrays import FloatArray
from identification.errors import RecordingError, reason_of
from identification.recordings.headers import COLUMN, columns_of, units_of
from identification.recordings.joint_choice import LARGEST_SHARE_OF_BAD_ROWS
from identification.recordings.npz_reader import (
    OPTIONAL_FIELDS,
    UNIT_FIELDS,
    refuse_unknown_units,
    resolve_robot,
)
from identification.recordings.recording import Finding
from identification.recordings.table import RawTable
from identification.recordings.units import UNITS

SETTING = re.compile(r"^#\s*(\w+)\s*[=:](.*)$")


def read_csv(path: Path) -> list[RawTable]:
    """Rows of a .csv file; lines that start with # may carry `robot=…` (or `robot: …`), `period_s=…`,
    `joint_names=A,B,…`, `q_unit=…`, `t_unit=…`, `dq_unit=…`, `tau_unit=…`.

    An empty cell counts as not a number, and so does a whole line that is no row of numbers, with a finding that names
    line and column: the row is left out later. An incomplete last line is left out with a finding. Raises
    RecordingError, which names the first such line, where they are too many to trust the rest. Where semicolons or
    tabs stand between the columns, a comma within a cell is its decimal sign.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise RecordingError.named(path, "is no text in UTF-8; save it so") from error
    except OSError as error:
        raise RecordingError.named(path, f"cannot be read as text ({reason_of(error)})") from error
    settings, start = _settings(lines)
    refuse_unknown_units(path, settings)
    if start >= len(lines):
        raise RecordingError.named(path, "holds no header and no rows")
    separator = next((each for each in ";\t" if each in lines[start]), ",")
    if "," not in lines[start]:
        lines[start:] = [line.replace(",", ".").replace(separator, ",") for line in lines[start:]]
    header = [name.strip().strip('"') for name in next(csv.reader([lines[start]]))]
    columns, units, factors = _columns(path, header)
    for name, quantity in UNIT_FIELDS.items():
        if quantity in units and settings.setdefault(name, units[quantity]) != units[quantity]:
            what = f"says {name}={settings[name]}, and in its header {units[quantity]}"
            raise RecordingError.named(path, what, field=name)
    findings: list[Finding] = []
    values = _values(path, lines, start + 1, header, set(columns.values()), findings)
    for place, factor in factors.items():
        values[:, place] *= factor
    said = [f"{quantity} in {unit}" for quantity, unit in units.items() if UNITS[quantity][unit] != 1.0]
    said += [f"column '{header[place]}' in another unit" for place in factors if factors[place] != 1]
    if said:
        sentence = f"as its header says, it is read with {', '.join(said)}"
        findings.append(Finding.of_all("units_of_header", len(values), sentence))
    joints = max(int(number) for name, number in columns if name == "q")
    arrays = {
        name: np.column_stack([values[:, columns[(name, str(joint))]] for joint in range(1, joints + 1)])
        for name in dict.fromkeys(name for name, _ in columns)
        if name != "t"
    }
    names = settings.get("joint_names")
    table = RawTable(
        path=path,
        kind="csv",
        time=values[:, columns[("t", "")]],
        position=arrays["q"],
        torque=arrays["tau"],
        optional={OPTIONAL_FIELDS[name]: arrays[name] for name in arrays if name in OPTIONAL_FIELDS},
        period_s=_period(path, settings),
        robot=resolve_robot(path, settings.get("robot", "")),
        joint_names=None if names is None else tuple(name.strip() for name in names.split(",")),
        units={quantity: settings[name] for name, quantity in UNIT_FIELDS.items() if name in settings},
        findings=findings,
    )
    return [table]


def _settings(lines: list[str]) -> tuple[dict[str, str], int]:
    settings: dict[str, str] = {}
    for index, line in enumerate(lines):
        text = line.strip()
        if text and not text.startswith("#"):
            return settings, index
        found = SETTING.match(text)
        if found is not None:
            settings[found.group(1)] = found.group(2).strip()
    return settings, len(lines)


def _period(path: Path, settings: dict[str, str]) -> float | None:
    """Stated period, s; None where none is stated, 0 where it is said that there is none."""
    text = settings.get("period_s")
    try:
        return None if text is None else float(text)
    except ValueError:
        raise RecordingError.named(path, f"period_s={text} is no number", field="period_s") from None


def _columns(path: Path, header: list[str]) -> tuple[dict[tuple[str, str], int], dict[str, str], dict[int, float]]:
    """Index of each known column as {(quantity, joint number from 1): index}; complains about what is missing.

    Where there is a column q0, the header counts from 0. Also what `units_of` says of them.
    """
    columns: dict[tuple[str, str], int] = {}
    try:
        found = columns_of(header)
        units, factors = units_of(found)
    except ValueError as error:
        raise RecordingError.named(path, f"{error}", field="header") from error
    first = 0 if any((each.quantity, each.number) == ("q", 0) for each in found.values()) else 1
    for index, each in found.items():
        key = (each.quantity, "" if each.number is None else str(each.number - first + 1))
        if key in columns:
            name = header[index]
            what = f"column '{name}' stands twice in the header"
            if header[columns[key]] != name:
                what = f"columns '{header[columns[key]]}' and '{name}' are both {''.join(key)}; leave one out"
            raise RecordingError.named(path, what, field=name)
        columns[key] = index
    joints = max((int(number) for name, number in columns if name == "q"), default=0)
    for key, missing in ((("t", ""), "column 't' is"), (("q", "1"), "columns q1, q2, … are")):
        if key not in columns:
            what = f"{missing} missing; t,q1,…,qn,tau1,…,taun is needed, and the header is: {', '.join(header)[:200]}"
            raise RecordingError.named(path, what, field="".join(key))
    for quantity in dict.fromkeys(["q", "tau", *(name for name, _ in columns if name != "t")]):
        for joint in range(1, joints + 1):
            if (quantity, str(joint)) not in columns:
                own = [key for key in columns if key[0] == quantity]
                if quantity not in ("q", "tau") and not any(COLUMN.match(header[columns[key]]) for key in own):
                    # vel_1 to vel_3 of an arm of seven joints are something else.
                    columns = {key: place for key, place in columns.items() if key not in own}
                    break
                name = f"{quantity}{joint - 1 + first}"
                raise RecordingError.named(
                    path, f"column '{name}' is missing ({joints} joints by the columns of q)", field=name, joint=joint
                )
    return columns, units, factors


def _values(
    path: Path, lines: list[str], first: int, header: list[str], used: Collection[int], findings: list[Finding]
) -> FloatArray:
    """All cells as numbers, (rows, columns). The quick way first; line by line only where it fails, to say where.

    used: columns that are wanted; what stands in others, such as words, costs no row.
    """
    body = [(index + 1, line) for index, line in enumerate(lines[first:], start=first) if line.strip()]
    if body and body[-1][1].count(",") < len(header) - 1:
        number, _ = body.pop()
        row, sentence = len(body) + 1, f"the last line ({number}) breaks off before its last column; it was left out"
        findings.append(Finding("truncated_row", row, row, 1, sentence))
    if not body:
        raise RecordingError.named(path, "holds a header but no rows")
    try:
        values = np.loadtxt([line for _, line in body], delimiter=",", dtype=np.float64, ndmin=2, comments=None)
        if values.shape[1] == len(header):
            return values
    except ValueError:
        pass
    rows = np.full((len(body), len(header)), np.nan)
    garbled: list[tuple[int, _GarbledLineError]] = []
    for row, (number, line) in enumerate(body):
        try:
            rows[row] = _cells(number, line, header, used)
        except _GarbledLineError as error:
            garbled.append((row + 1, error))
    if not garbled:
        return rows
    _, first_error = garbled[0]
    if len(garbled) > LARGEST_SHARE_OF_BAD_ROWS * len(body):
        raise RecordingError(f"{path.name}, {first_error}", file=path, field=first_error.field)
    others = f"; so {len(garbled)} lines are no rows of numbers" if len(garbled) > 1 else ""
    numbers = np.array([row for row, _ in garbled])
    findings.append(Finding.of_rows("unreadable_rows", numbers, f"{first_error}{others}"))
    return rows


class _GarbledLineError(ValueError):
    """A line that is no row of numbers. field: its column, or the line where its columns are too many or too few."""

    def __init__(self, message: str, field: str) -> None:
        super().__init__(message)
        self.field = field


def _cells(number: int, line: str, header: list[str], used: Collection[int]) -> list[float]:
    """The numbers of a line, nan for an empty cell and one that is not used. Raises _GarbledLineError, which names line
    and column.
    """
    cells = next(csv.reader([line]))
    where = f"line {number}"
    if len(cells) != len(header):
        raise _GarbledLineError(f"{where}: {len(cells)} columns where the header has {len(header)}", where)
    values = []
    for column, (name, cell) in enumerate(zip(header, cells, strict=True)):
        try:
            values.append(float(cell) if column in used and cell.strip() else np.nan)
        except ValueError:
            raise _GarbledLineError(f"{where}, column '{name}': '{cell.strip()[:40]}' is no number", name) from None
    return values
