"""Reads and writes `model.json`: the outcome of a fit as a file, checked when it is read.

Here: the Model value object and its two directions. Not here: how parameters are estimated (`fit`).
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import WIDTH, BaseRegressor, RegressorOptions
from identification.errors import EstimationError, ModelFileError, ModelFileNotFoundError, reason_of
from identification.physical_parameters import PhysicalParameters
from identification.recordings.independence import holds_rows, holds_samples, recording_names
from identification.recordings.recording import Recording
from identification.recordings.rounded import Rows
from identification.robots import BUILT_IN_ROBOTS, Installation, RobotModel, load_robot
from identification.robots.same_arm import difference_of_frames
from identification.whole_file import write_whole

MODEL_FORMAT = "iiwa-ident/model/1"
SPEED = "speed_rms"
_SMALLEST_RELATIVE_STD = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """An identified model of a robot.

    robot: name or path as written. names, values, std: (p,) base parameters with their standard deviations, and units.
    physical: feasible physical parameters, None if the file holds none. rotor_inertia, offset: (n,) of the physical
    set, zeros where not fitted. options: which effects the base parameters comprise. data: the whole file as read.
    """

    robot: str
    names: tuple[str, ...]
    values: FloatArray
    std: FloatArray
    units: tuple[str, ...]
    physical: PhysicalParameters | None
    rotor_inertia: FloatArray
    offset: FloatArray
    options: RegressorOptions
    path: str = ""
    data: dict[str, Any] = field(default_factory=dict, repr=False)

    def load_robot(self) -> RobotModel:
        """The robot the model is of, installed as it was. A path is taken relative to the model file, then as it is.

        Raises RobotError, and ModelFileError where its frames are no more what they were when the model was fitted.
        """
        installation = Installation.from_json(self.data.get("installation"))
        beside = Path(self.path).parent / self.robot
        found = self.robot not in BUILT_IN_ROBOTS and self.path and (beside.is_file() or not Path(self.robot).is_file())
        robot = load_robot(beside if found else self.robot, installation)
        self._refuse_other_frames(robot)
        return robot

    def _refuse_other_frames(self, robot: RobotModel) -> None:
        """Raises ModelFileError for a robot in whose link frames these parameters do not stand."""
        frames = self.data.get("provenance", {}).get("robot", {}).get("joints")
        difference = difference_of_frames(frames, robot) if frames else ""
        if difference:
            raise self.error(
                "its parameters stand in the link frames of the robot it was fitted with; "
                f"in those of {robot.source} {difference}. Give that robot as it was, or fit again",
                "robot",
            )

    def error(self, message: str, field: str) -> ModelFileError:
        """The error of this model in one of its fields."""
        return ModelFileError(f"{self.path or 'The model'}: {message}", file=self.path or None, field=field)

    def fitted_among(self, recordings: Sequence[Recording]) -> tuple[str, ...]:
        """Names of those recordings that it was fitted to, as far as the file says: they are no check of it.

        Told by the digest of the file and by samples: a copy, an import or a cut has the same ones, or rounded ones.
        """
        inputs = self.data.get("provenance", {}).get("inputs", [])
        fitted = {str(item.get("sha256")) for item in inputs}
        prints, rows = ([item[key] for item in inputs if item.get(key)] for key in ("samples_kept", "rows_kept"))
        named = zip(recordings, recording_names(recordings), strict=True)
        return tuple(
            name
            for recording, name in named
            if recording.source.sha256 in fitted
            or any(holds_samples(recording, kept) for kept in prints)
            or any(holds_rows(recording, kept) for kept in rows)
        )

    @property
    def turns_torque(self) -> bool:
        """Whether its fit turned the sign of all torques first (`fit --flip-torque`)."""
        return bool(self.data.get("provenance", {}).get("settings", {}).get("flip_torque", False))

    def torque_shift(self, joints: int) -> FloatArray:
        """(n,) s by which its fit took the torque earlier. Raises ModelFileError for another number of joints."""
        shift = self.data.get("provenance", {}).get("torque_shift_s") or [0.0] * joints
        if len(shift) != joints:
            field = "provenance.torque_shift_s"
            raise self.error(f"field '{field}' has {len(shift)} numbers, the robot {joints} joints", field)
        return np.array(shift, dtype=np.float64)

    def speed_rms(self, joints: int) -> FloatArray | None:
        """(n,) rad/s (m/s), RMS of each joint in what it was fitted to; None where an older file does not say.

        Raises ModelFileError for another number of joints.
        """
        speed = self.data.get("provenance", {}).get(SPEED)
        if speed is None:
            return None
        if len(speed) != joints:
            field = f"provenance.{SPEED}"
            raise self.error(f"field '{field}' has {len(speed)} numbers, the robot {joints} joints", field)
        return np.array(speed, dtype=np.float64)

    def regressor(self, robot: RobotModel) -> BaseRegressor:
        """Of these base parameters: as the robot stands, or as the model's own stood where that shows others."""
        widths = np.ravel(self.options.coulomb_velocity)
        if len(widths) not in (1, robot.n):
            field = f"provenance.regressor.{WIDTH}"
            raise self.error(f"field '{field}' has {len(widths)} numbers, the robot {robot.n} joints", field)
        regressor = BaseRegressor(robot, self.options)
        if set(self.names) == set(regressor.names):
            return regressor
        its_stand = Installation.from_json(self.data.get("installation")).gravity
        return BaseRegressor(replace(robot, gravity=np.array(its_stand)), self.options)

    def base_values(self, regressor: BaseRegressor) -> FloatArray:
        """(p,) base parameters in the order of a regressor.

        Raises ModelFileError if the names, or the link frames that they stand in, are not the same.
        """
        self._refuse_other_frames(regressor.robot)
        mine = dict(zip(self.names, self.values, strict=True))
        missing = [name for name in regressor.names if name not in mine]
        if missing or len(mine) != regressor.size:
            absent = f"; missing: {', '.join(missing[:6])}" if missing else ""
            raise self.error(f"its base parameters are not those of {regressor.robot.name}{absent}", "base_parameters")
        return np.array([mine[name] for name in regressor.names])

    def base_covariance(self, regressor: BaseRegressor) -> FloatArray:
        """(p, p) covariance of the base parameters in the order of a regressor.

        A file that states standard deviations only gives a diagonal one. Raises ModelFileError for other names, or a
        covariance of another shape.
        """
        self.base_values(regressor)
        order = [self.names.index(name) for name in regressor.names]
        rows = self.data.get("base_covariance")
        if not rows:
            smallest = _SMALLEST_RELATIVE_STD * np.maximum(np.abs(self.values), 1.0)
            return np.asarray(np.diag(np.maximum(self.std, smallest)[order] ** 2), dtype=np.float64)
        covariance = np.zeros((len(self.names), len(self.names)))
        try:
            for place, row in enumerate(rows):
                covariance[place, : place + 1] = covariance[: place + 1, place] = row
            np.linalg.cholesky(covariance)
        except (TypeError, ValueError, IndexError, np.linalg.LinAlgError) as error:
            field = "base_covariance"
            raise self.error(f"field '{field}' is no covariance of its {len(self.names)} parameters.", field) from error
        return covariance[np.ix_(order, order)]

    def physical_base_values(self, regressor: BaseRegressor) -> FloatArray | None:
        """(p,) the base parameters of the physical set with its drives, None if the model holds none."""
        if self.physical is None:
            return None
        full = regressor.full_from_physical(self.physical).copy()
        for symbol, values in (("IA", self.rotor_inertia), ("OFF", self.offset)):
            for joint, value in enumerate(values):
                name = f"{symbol}_{joint + 1}"
                if name in regressor.full_names:
                    full[regressor.full_names.index(name)] = value
        return regressor.base_from_full(full)


def no_check(name: str) -> str:
    """What is said of a recording that a model is compared with and was fitted to."""
    return (
        f"NO CHECK: the model was fitted to {name} itself, a copy or a part of it, and its RMS there is the fit's own. "
        "Give another run."
    )


def write_model(data: dict[str, Any], path: str | Path) -> Path:
    """Write the JSON of `FitResult.to_model_json` and return its path; an existing file is replaced in one step.

    A robot that is a file is named as it is found from there, so that both can be moved together. Raises ModelFileError
    if a number is not finite (JSON knows none), OSError if the file cannot be written.
    """
    path, robot = Path(path), data.get("robot")
    if robot not in BUILT_IN_ROBOTS and robot is not None and Path(robot).is_file():
        data = {**data, "robot": os.path.relpath(Path(robot).resolve(), path.parent.resolve())}
    try:
        text = json.dumps(data, indent=1, allow_nan=False)
    except ValueError as error:
        raise ModelFileError.named(path, f"the model holds a number that is not finite ({error})") from error
    write_whole(path, text + "\n")
    return path


def read_model(path: str | Path) -> Model:
    """Read and check a model.json. Raises ModelFileNotFoundError (66) or ModelFileError (65) naming the field."""
    path = Path(path)
    if not path.is_file():
        raise ModelFileNotFoundError.at(path, "there is no such model")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise ModelFileError.named(path, f"cannot be read as JSON ({reason_of(error)})") from error
    if not isinstance(data, dict) or data.get("format") != MODEL_FORMAT:
        found = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise ModelFileError.named(path, f"is no {MODEL_FORMAT} (format: {found})", field="format")
    where = "base_parameters"
    try:
        base = data[where]
        names = tuple(str(item["name"]) for item in base)
        values, std = (_finite([item[key] for item in base]) for key in ("value", "std"))
        if not names or len(set(names)) < len(names) or np.any(std < 0.0):
            raise ValueError("empty, a name that stands twice, or a negative deviation")
        units = tuple(str(item["unit"]) for item in base)
        where = "friction"
        viscous, coulomb = (_column(data.get(where, []), key) for key in ("viscous", "coulomb"))
        where = "drives"
        rotor, offset = (_column(data.get(where, []), key) for key in ("rotor_inertia", "offset"))
        where = "physical_parameters"
        physical = _physical(data.get(where, []), viscous, coulomb)
        where = "drives"
        if physical is not None and rotor.size not in (0, physical.n):
            raise ValueError(f"{rotor.size} joints have drives, {physical.n} links bodies")
        where = "effects"
        _ = [(item["effect"], item["joint"]) for item in _part(data, where, list)]
        where = "provenance"
        provenance = _part(data, where, dict)
        where = "provenance.settings"
        _check_settings(_part(provenance, "settings", dict))
        where = "provenance.torque_shift_s"
        if _finite(_part(provenance, "torque_shift_s", list)).ndim != 1:
            raise ValueError("no list of numbers")
        where = f"provenance.{SPEED}"
        speed = _finite(_part(provenance, SPEED, list))
        if speed.ndim != 1 or np.any(speed < 0.0):
            raise ValueError("no list of speeds")
        where = "provenance.inputs"
        inputs = _part(provenance, "inputs", list)
        _ = [int(item.get("samples_kept") or "0", 16) for item in inputs]
        _ = [Rows.from_text(item["rows_kept"]) for item in inputs if item.get("rows_kept")]
        where = "provenance.robot.joints"
        _check_frames(_part(_part(provenance, "robot", dict), "joints", list))
        where = "provenance.regressor"
        options = RegressorOptions.from_json(_part(provenance, "regressor", dict))
        where = "robot"
        robot = str(data[where])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, EstimationError) as error:
        reason = str(error) if isinstance(error, EstimationError) else repr(error)
        raise ModelFileError.named(path, f"field '{where}' is not as it should be ({reason})", field=where) from error
    return Model(robot, names, values, std, units, physical, rotor, offset, options, str(path), data)


def _check_settings(noted: dict[str, Any]) -> None:
    """Raises EstimationError for settings that no other recording can be processed by."""
    # Here, not above: the solvers behind it take a second to load, and a run reads no model before it moves.
    from identification.fitting.settings import OF_PROCESSING, FitSettings

    FitSettings(**{name: noted[name] for name in OF_PROCESSING if name in noted})


def _check_frames(frames: list[dict[str, Any]]) -> None:
    for frame in frames:
        _ = frame["parent"], frame["revolute"]
        if [_finite(frame[name]).size for name in ("translation", "rotation", "axis")] != [3, 9, 3]:
            raise ValueError("a frame is three, nine and three numbers")


def _part(data: dict[str, Any], key: str, kind: type[Any]) -> Any:
    """A part of the file, empty where it is absent. Raises TypeError for one of another kind."""
    value = data.get(key, kind())
    if not isinstance(value, kind):
        raise TypeError(f"{type(value).__name__} in place of {kind.__name__}")
    return value


def _finite(values: Any) -> FloatArray:
    """As an array. Raises ValueError for a number that is not finite, which JSON does not know but Python reads."""
    array = np.array(values, dtype=np.float64)
    if not np.all(np.isfinite(array)):
        raise ValueError("a number that is not finite")
    return array


def _column(rows: list[dict[str, Any]], key: str) -> FloatArray:
    """One number per joint, in the order of the joints; null counts as zero."""
    ordered = sorted(rows, key=lambda row: int(row["joint"]))
    if [int(row["joint"]) for row in ordered] != list(range(1, len(ordered) + 1)):
        raise ValueError(f"joint does not run from 1 to {len(ordered)}")
    return _finite([0.0 if row[key] is None else row[key] for row in ordered])


def _physical(rows: list[dict[str, Any]], viscous: FloatArray, coulomb: FloatArray) -> PhysicalParameters | None:
    if not rows:
        return None
    ordered = sorted(rows, key=lambda row: int(row["link"]))
    mass = _finite([row["mass"] for row in ordered])
    if np.any(mass < 0.0):
        raise ValueError(f"the mass of link {int(np.argmin(mass)) + 1} is {mass.min():.4g} kg")
    return PhysicalParameters(
        mass=mass,
        center_of_mass=_finite([row["com"] for row in ordered]),
        inertia=_finite([row["inertia"] for row in ordered]),
        viscous=viscous if viscous.size else np.zeros(len(ordered)),
        coulomb=coulomb if coulomb.size else np.zeros(len(ordered)),
    )
