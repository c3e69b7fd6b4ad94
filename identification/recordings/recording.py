"""The value objects of a recording: what was measured, when, in which period, and what the import found.

Nothing here reads a file. Readers build these objects, `identification.signals` and the fit consume them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.errors import RecordingError
from identification.printing import Printed, Table
from identification.robots.installation import ON_THE_FLOOR, Installation

OF_JOINTS = (
    "position", "torque", "velocity", "command_position", "link_position", "external_torque", "temperature",
)  # fmt: skip
"""A recording's arrays with a column for each joint."""
OF_LABELS = ("period_index", "sample_in_period")
OF_ROWS = ("time", *OF_JOINTS, *OF_LABELS)

CLOCK_START = "clock_start_s"
"""In a source's metadata: its own time stamp of the first row, where `Recording.time` counts from zero."""

PERIOD_STATED = "period_stated"
"""In a source's metadata: that its period was stated by who reads it, and not by the run."""


UNITS_STATED = "units_stated"
"""In a source's metadata: `Recording.units_stated`."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing the import found in the rows of a file.

    kind: a short name such as "gap", "repeated_rows", "garbled_rows", "time_backwards".
    first_row, last_row: rows of the file, counted from 1 (the header of a CSV is not counted).
    count: how many rows (for gaps: how many gaps). joint: from 1, or None for the whole row.
    """

    kind: str
    first_row: int
    last_row: int
    count: int
    sentence: str
    joint: int | None = None

    @classmethod
    def of_rows(cls, kind: str, rows: IntArray, sentence: str) -> Finding:
        """About rows (k,) of the file, counted from 1, in their order."""
        return cls(kind, int(rows[0]), int(rows[-1]), int(rows.size), sentence)

    @classmethod
    def of_all(cls, kind: str, rows: int, sentence: str, joint: int | None = None) -> Finding:
        """About every row of a file with so many."""
        return cls(kind, 1, rows, rows, sentence, joint)

    def to_json(self) -> dict[str, Any]:
        """The finding as plain JSON types."""
        return {
            "kind": self.kind,
            "rows": [self.first_row, self.last_row, self.count],
            "joint": self.joint,
            "sentence": self.sentence,
        }


@dataclass(frozen=True, slots=True)
class ImportReport:
    """Everything an import found, and how many rows it read and kept."""

    rows_read: int
    rows_kept: int
    findings: tuple[Finding, ...] = ()

    def first(self, findings: Iterable[Finding]) -> ImportReport:
        """With these findings before all others."""
        return replace(self, findings=(*findings, *self.findings))

    def of_kind(self, kind: str) -> tuple[Finding, ...]:
        """The findings of one kind, in the order of their rows."""
        return tuple(finding for finding in self.findings if finding.kind == kind)

    def to_json(self) -> dict[str, Any]:
        """The report as plain JSON types."""
        return {
            "rows_read": self.rows_read,
            "rows_kept": self.rows_kept,
            "findings": [finding.to_json() for finding in self.findings],
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> ImportReport:
        """The report that `to_json` wrote."""
        return cls(
            int(data["rows_read"]),
            int(data["rows_kept"]),
            tuple(
                Finding(str(item["kind"]), first, last, count, str(item["sentence"]), item.get("joint"))
                for item in data["findings"]
                for first, last, count in [item["rows"]]
            ),
        )


@dataclass(frozen=True, slots=True)
class RecordingSource:
    """Where a recording came from: the file's name, its SHA-256, the kind of file, and what its metadata said."""

    path: str
    sha256: str
    kind: str
    metadata: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, repr=False, eq=False, weakref_slot=True)
class Recording(Printed):
    """Measured motion and torque of an n-joint robot, one row per sample, in the order of time.

    time: (N,) s, strictly increasing, need not be uniform. position: (N, n) rad (m for prismatic joints).
    torque: (N, n) Nm (N), sign of the inverse-dynamics torque (a torque that accelerates the joint in its positive
    direction is positive). Optional, each (N, n), nan where a joint has none: velocity (rad/s), command_position,
    link_position (second encoder) in rad, external_torque in Nm, temperature in °C.
    period_index: (N,) number of the period from 0, -1 outside the periodic part; None when not periodic.
    sample_in_period: (N,) index on the grid of one period, -1 outside. period_s, samples_per_period: None when not
    periodic. torque_unit: "Nm", or "A" when the file holds motor currents. sampling_period_s: median distance of the
    time stamps. robot: name or path of the robot as the file or the caller gave it, None when neither did. report: what
    the import found and did. installation: how the robot stood and which of its joints were held.

    Raises RecordingError for other shapes, for what are no finite numbers, and for a time that does not advance.
    """

    time: FloatArray
    position: FloatArray
    torque: FloatArray
    sampling_period_s: float
    source: RecordingSource
    report: ImportReport
    robot: str | None = None
    joint_names: tuple[str, ...] | None = None
    installation: Installation = ON_THE_FLOOR
    torque_unit: str = "Nm"
    velocity: FloatArray | None = None
    command_position: FloatArray | None = None
    link_position: FloatArray | None = None
    external_torque: FloatArray | None = None
    temperature: FloatArray | None = None
    period_index: IntArray | None = None
    sample_in_period: IntArray | None = None
    period_s: float | None = None
    samples_per_period: int | None = None

    def __post_init__(self) -> None:
        rows = np.shape(self.position)[:1]
        joints = np.shape(self.position)[1:]
        for name, values in self.arrays(OF_ROWS).items():
            wanted = (*rows, *joints) if name in OF_JOINTS else rows
            if not isinstance(values, np.ndarray) or values.dtype.kind != ("i" if name in OF_LABELS else "f"):
                numbers = "whole numbers" if name in OF_LABELS else "floating-point numbers"
                raise self._refusal(f"{name} is no array of {numbers}", name)
            if values.shape != wanted or len(joints) != 1:
                shown = "(rows, joints)" if len(joints) != 1 else f"{wanted}, as position tells"
                raise self._refusal(f"{name} has the shape {values.shape} and not {shown}", name)
        for name in ("position", "torque"):
            unknown = np.argwhere(~np.isfinite(getattr(self, name)))
            if unknown.size:
                row, joint = unknown[0] + 1
                what = f"the {name} of joint {joint} is no finite number in row {row}; leave such rows out"
                raise self._refusal(what, name, int(joint))
        still = np.flatnonzero(~(np.diff(self.time) > 0.0))
        if still.size or not np.isfinite(self.time).all():
            raise self._refusal(f"time does not advance after row {still[0] + 1 if still.size else 1}", "time")
        if self.samples > 1 and not 0.0 < self.sampling_period_s < np.inf:
            raise self._refusal(f"sampling_period_s is {self.sampling_period_s}, and no time in s", "sampling_period_s")

    def _refusal(self, what: str, field: str, joint: int | None = None) -> RecordingError:
        return RecordingError.named(self.source.path, what, field=field, joint=joint)

    @property
    def samples(self) -> int:
        """Number of rows N."""
        return int(self.time.shape[0])

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.position.shape[1])

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def is_periodic(self) -> bool:
        """Whether the rows carry period labels."""
        return self.period_index is not None

    @property
    def labelled_by_run(self) -> bool:
        """Whether the run itself wrote the labels of its periods; else they are by time stamps."""
        return self.source.kind == "log" and PERIOD_STATED not in self.source.metadata

    @property
    def units_stated(self) -> tuple[str, ...]:
        """Quantities whose unit was named by the file or by who read it: t, q, dq, tau."""
        return tuple(self.source.metadata.get(UNITS_STATED, "").split())

    @property
    def complete_periods(self) -> int:
        """Number of periods that hold at least one sample."""
        if self.period_index is None:
            return 0
        return int(np.unique(self.period_index[self.period_index >= 0]).size)

    @property
    def repeats(self) -> bool:
        """Whether two periods or more tell noise from what repeats."""
        return self.complete_periods > 1

    @property
    def table(self) -> Table:
        """Whose it is, how long, and what the import found; of each joint the way it went and its RMS torque."""
        whose = "" if self.robot is None else f" of {self.robot}"
        what = f"{self.source.path}: {self.samples} samples of {self.n} joint{'s' * (self.n != 1)}{whose}"
        found = tuple(finding.sentence for finding in self.report.findings)
        if not self.samples:
            return Table((), (), (f"{what}.", *found))
        periods = self.complete_periods
        parts = f", {periods} period{'s' * (periods != 1)} of {self.period_s:g} s" if self.period_s else ""
        how_long = f"{self.duration_s:.4g} s, one each {1e3 * self.sampling_period_s:.4g} ms{parts}"
        names = self.joint_names or tuple(map(str, range(1, self.n + 1)))
        columns = (self.position.min(axis=0), self.position.max(axis=0), np.sqrt(np.mean(self.torque**2, axis=0)))
        rows = tuple((name, *(f"{x:z.4f}" for x in row)) for name, *row in zip(names, *columns, strict=True))
        unit = "Nm (N)" if self.torque_unit == "Nm" else self.torque_unit
        return Table(
            ("joint", "from, rad (m)", "to, rad (m)", f"RMS torque, {unit}"), rows, (f"{what} in {how_long}.", *found)
        )

    def rows(self, keep: BoolArray) -> Recording:
        """The same recording with only the rows where keep (N,) is true; the report is unchanged."""
        return replace(self, **{name: values[keep] for name, values in self.arrays(OF_ROWS).items()})

    def arrays(self, names: Iterable[str]) -> dict[str, Any]:
        """Those of some arrays that it has, by name."""
        return {name: values for name in names if (values := getattr(self, name)) is not None}
