"""Trajectories in files: the project's JSON, and tables of others as JSON, NPZ or CSV.

Here: `load_trajectory`, the table trajectory for paths that have no closed form, and the one shipped excitation.
Not here: checks of limits or collisions, which `run` and `check` make on whatever is loaded. Called at the edges:
command line, service, benchmarks.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from identification.arrays import FloatArray
from identification.errors import TrajectoryError, TrajectoryNotFoundError
from identification.excitation.fourier import (
    FORMAT,
    FourierTrajectory,
    Trajectory,
    check_amplitude,
    number,
    number_table,
    samples_per_period,
)
from identification.excitation.polynomials import PolynomialTrajectory, SineSeriesTrajectory


@dataclass(frozen=True, slots=True)
class TableTrajectory(Trajectory):
    """A periodic motion known by its positions at a fixed rate only.

    position: (N, n) rad, one period, row N would be row 0 again; rate_hz: rows per second. Between rows, and for
    velocity and acceleration, the trigonometric interpolation through all rows counts (exact for periodic band-limited
    tables). Raises TrajectoryError for fewer than 4 rows or numbers that are not finite.
    """

    position: FloatArray
    rate_hz: float
    robot: str = ""
    record: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Bring the table to float64 and check it once."""
        position = np.array(self.position, dtype=np.float64)
        if position.ndim != 2 or len(position) < 4 or position.shape[1] == 0:
            raise TrajectoryError(
                f"a trajectory table needs at least 4 rows and one column for each joint, not {position.shape}",
                field="position",
            )
        bad = np.argwhere(~np.isfinite(position))
        if len(bad):
            raise TrajectoryError(
                f"the trajectory table holds a number that is not finite in row {bad[0, 0] + 1}, joint {bad[0, 1] + 1}",
                field="position",
                joint=int(bad[0, 1]) + 1,
            )
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0.0):
            raise TrajectoryError(f"the table's rate must be positive, not {self.rate_hz} Hz", field="rate_hz")
        position.setflags(write=False)
        object.__setattr__(self, "position", position)

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return int(self.position.shape[1])

    @property
    def period_s(self) -> float:
        """Length of one period in s."""
        return len(self.position) / self.rate_hz

    def evaluate(self, time_s: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """q, q̇, q̈ of the trigonometric interpolation at the given times, each (S, n)."""
        time = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        count = len(self.position)
        amplitude = np.fft.rfft(self.position, axis=0) / count
        amplitude[1 : (count + 1) // 2] *= 2.0
        speed = 2j * np.pi * np.arange(len(amplitude)) / self.period_s
        if count % 2 == 0:
            # The highest harmonic of an even table has no defined phase: it enters the path, not its derivatives.
            speed[-1] = 0.0
        turning = np.exp(2j * np.pi * np.outer(time / self.period_s, np.arange(len(amplitude))))
        return (
            np.real(turning @ amplitude),
            np.real(turning @ (speed[:, None] * amplitude)),
            np.real(turning @ (speed[:, None] ** 2 * amplitude)),
        )

    def table(self, rate_hz: float = 1000.0) -> FloatArray:
        """Positions of exactly one period at the given rate; the stored rows themselves at their own rate."""
        count = samples_per_period(self.period_s, rate_hz)
        if count == len(self.position):
            return self.position.copy()
        if count < len(self.position):
            return self.evaluate(np.arange(count) * (self.period_s / count))[0]
        # The same interpolation as `evaluate` by one transform: a minute of rows takes milliseconds.
        spectrum = np.fft.rfft(self.position, axis=0) * (count / len(self.position))
        if len(self.position) % 2 == 0:
            spectrum[-1] *= 0.5
        return np.asarray(np.fft.irfft(spectrum, n=count, axis=0))

    def scaled(self, amplitude: float) -> TableTrajectory:
        """The same path with its amplitude about its first row multiplied."""
        check_amplitude(amplitude)
        start = self.position[0]
        return TableTrajectory(start + amplitude * (self.position - start), self.rate_hz, self.robot)

    def numbers(self) -> dict[str, Any]:
        """Kind table; its rows are those of `to_json`."""
        return {"kind": "table", "robot": self.robot}

    def to_json(self, *, table_rate_hz: float | None = None) -> dict[str, Any]:
        """The file's content; the table at its own rate where none is asked for."""
        return super(TableTrajectory, self).to_json(table_rate_hz=table_rate_hz or self.rate_hz)


def trajectory_from_json(document: Any) -> Trajectory:
    """The trajectory a JSON document describes: Fourier, polynomial, sine series or table.

    Raises TrajectoryError naming the field at fault.
    """
    if not isinstance(document, Mapping):
        raise TrajectoryError("a trajectory file must hold one JSON object")
    stated = document.get("format", FORMAT)
    if stated != FORMAT:
        raise TrajectoryError(f"the format is '{stated}', but this version reads '{FORMAT}'", field="format")
    kind = document.get("kind", "fourier" if "a" in document else "table")
    if kind == "fourier":
        return FourierTrajectory.from_json(document)
    if kind == "polynomial":
        return PolynomialTrajectory.from_json(document)
    if kind == "sine_series":
        return SineSeriesTrajectory.from_json(document)
    if kind == "table":
        table = document.get("table")
        if not isinstance(table, Mapping):
            raise TrajectoryError("neither coefficients ('a', 'b') nor a 'table' is given", field="table")
        rate = number(table, "rate_hz")
        return TableTrajectory(number_table(table, "position"), rate, str(document.get("robot", "")))
    raise TrajectoryError(f"the kind '{kind}' is not known (fourier, polynomial, sine_series, table)", field="kind")


def load_trajectory(path: str | Path) -> Trajectory:
    """Read a trajectory file by its suffix.

    `.json`: this project's format. `.npz`: `q` (N, n) rad with `t` (N,) s or `rate_hz`, optional `robot`.
    `.csv`: header `t,q1..qn`, or `q1..qn` alone for rows at 1 kHz. Tables are one period: a last row that repeats
    the first one is left out. Raises TrajectoryNotFoundError (exit 66) or TrajectoryError (exit 65).
    """
    path = Path(path)
    if not path.is_file():
        raise TrajectoryNotFoundError(f"There is no trajectory file {path}.", file=path)
    try:
        return _read(path)
    except OSError as error:
        raise TrajectoryNotFoundError(f"{path} cannot be read: {error.strerror or error}.", file=path) from error
    except TrajectoryError as error:
        raise TrajectoryError.at(path, f"{error}", field=error.field, joint=error.joint) from error


def _read(path: Path) -> Trajectory:
    """Raises TrajectoryError without the file, and OSError."""
    match path.suffix.lower():
        case ".json":
            try:
                return trajectory_from_json(json.loads(_text(path)))
            except json.JSONDecodeError as error:
                raise TrajectoryError(f"no valid JSON: {error.msg} in line {error.lineno}") from error
            except RecursionError as error:
                raise TrajectoryError("no trajectory: brackets in brackets without end") from error
        case ".npz":
            return _from_npz(path)
        case ".csv":
            return _from_csv(path)
    raise TrajectoryError(f"a trajectory is read from .json, .npz or .csv, not from '{path.suffix.lower()}'")


def default_trajectory(robot: str = "iiwa14") -> FourierTrajectory:
    """The shipped excitation of a robot, designed under (14) and verified; default of `run`, `check` and `demo`.

    Raises TrajectoryNotFoundError for a robot none is shipped for: `design` makes one.
    """
    return _shipped(robot, "default")


def validation_trajectory(robot: str = "iiwa14") -> FourierTrajectory:
    """A shipped motion other than the excitation, to score models on data they were not fitted to."""
    return _shipped(robot, "validation")


def _shipped(robot: str, purpose: str) -> FourierTrajectory:
    name = f"{robot}_{purpose}.json"
    source = resources.files("identification.excitation.data").joinpath(name)
    if not robot.isalnum() or not source.is_file():
        raise TrajectoryNotFoundError(
            f"No {purpose} trajectory is shipped for robot '{robot}'; make one with 'iiwa-ident design'.", file=name
        )
    return FourierTrajectory.from_json(json.loads(source.read_text(encoding="utf-8")))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise TrajectoryError("the file is no text in UTF-8") from error


def _from_npz(path: Path) -> Trajectory:
    try:
        with np.load(path, allow_pickle=False) as archive:
            content = {name: archive[name] for name in archive.files}
    except OSError:
        raise
    except Exception as error:  # zipfile.BadZipFile, zlib.error and ValueError share no base class
        raise TrajectoryError(f"no readable NPZ archive ({error})") from error
    position = number_table(content, "q")
    if "rate_hz" in content:
        rate = float(number_table({"rate_hz": np.ravel(content["rate_hz"])}, "rate_hz", dimensions=1)[0])
    elif "t" in content:
        rate = _rate_of(number_table(content, "t", dimensions=1), len(position))
    else:
        raise TrajectoryError("neither 't' nor 'rate_hz' says how fast the table runs", field="t")
    return TableTrajectory(_one_period(position), rate, str(content.get("robot", "")))


def _from_csv(path: Path) -> Trajectory:
    lines = (line for line in _text(path).split("\n") if not line.startswith("#"))
    rows = [row for row in csv.reader(lines) if row]
    if not rows:
        raise TrajectoryError("the file is empty")
    header = [name.strip() for name in rows[0]]
    joints = [name for name in header if name.startswith("q")]
    if not joints or joints != [f"q{i + 1}" for i in range(len(joints))]:
        raise TrajectoryError("the first line must name the columns t,q1,q2,… (or q1,q2,…)", field="header")
    values = np.empty((len(rows) - 1, len(header)))
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise TrajectoryError(f"row {line} has {len(row)} entries, the first line names {len(header)}", field="row")
        for column, text in enumerate(row):
            try:
                values[line - 2, column] = float(text)
            except ValueError:
                name = header[column]
                raise TrajectoryError(
                    f"row {line}, column '{name}' holds '{text.strip()}', which is no number", field=name
                ) from None
    position = values[:, [header.index(name) for name in joints]]
    rate = _rate_of(values[:, header.index("t")], len(position)) if "t" in header else 1000.0
    return TableTrajectory(_one_period(position), rate)


def _rate_of(time: FloatArray, rows: int) -> float:
    """Rows per second of evenly spaced times; raises TrajectoryError where a command table could not be even."""
    if len(time) != rows or rows < 2:
        raise TrajectoryError(f"'t' has {len(time)} entries for {rows} rows of positions", field="t")
    step = (time[-1] - time[0]) / (rows - 1)
    uneven = np.abs(np.diff(time) - step) > 1e-3 * abs(step)
    if not (np.isfinite(step) and step > 0.0) or bool(np.any(uneven)):
        row = int(np.argmax(uneven)) + 1
        raise TrajectoryError(f"the times are not evenly rising (see row {row})", field="t")
    return float(1.0 / step)


def _one_period(position: FloatArray) -> FloatArray:
    """Without a last row that only repeats the first (a closed table written by someone else)."""
    if len(position) > 4 and np.allclose(position[0], position[-1], rtol=0.0, atol=1e-12):
        return position[:-1]
    return position
