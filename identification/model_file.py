"""Reads and writes `model.json`: the outcome of a fit as a file, checked when it is read.

Here: the Model value object and its two directions. Not here: how parameters are estimated (`fit`).
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import ModelFileError, ModelFileNotFoundError, reason_of
from identification.physical_parameters import PhysicalParameters
from identification.robots import BUILT_IN_ROBOTS, Installation, RobotModel, load_robot

__all__ = ["MODEL_FORMAT", "Model", "read_model", "write_model"]

FloatArray = npt.NDArray[np.float64]

MODEL_FORMAT = "iiwa-ident/model/1"
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
        """The robot the model is of, installed as it was. A path is taken as it is, then relative to the model file.

        Raises RobotError.
        """
        installation = Installation.from_json(self.data.get("installation"))
        if self.robot in BUILT_IN_ROBOTS or Path(self.robot).is_file() or not self.path:
            return load_robot(self.robot, installation)
        return load_robot(Path(self.path).parent / self.robot, installation)

    @property
    def fitted_digests(self) -> frozenset[str]:
        """SHA-256 of the recordings it was fitted to, as far as the file says."""
        inputs = self.data.get("provenance", {}).get("inputs", [])
        return frozenset(str(item.get("sha256")) for item in inputs)

    def base_values(self, regressor: BaseRegressor) -> FloatArray:
        """(p,) base parameters in the order of a regressor. Raises ModelFileError if the names are not the same."""
        mine = dict(zip(self.names, self.values, strict=True))
        missing = [name for name in regressor.names if name not in mine]
        if missing or len(mine) != regressor.size:
            raise ModelFileError(
                f"{self.path or 'The model'}: its base parameters are not those of {regressor.robot.name}"
                + (f"; missing: {', '.join(missing[:6])}" if missing else ""),
                file=self.path or None,
                field="base_parameters",
            )
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
            raise ModelFileError(
                f"{self.path or 'The model'}: field 'base_covariance' is no covariance of its "
                f"{len(self.names)} parameters.",
                file=self.path or None,
                field="base_covariance",
            ) from error
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


def write_model(data: dict[str, Any], path: str | Path) -> Path:
    """Write the JSON of `FitResult.to_model_json` and return its path; an existing file is replaced in one step.

    Raises ModelFileError if a number is not finite (JSON knows none), OSError if the file cannot be written.
    """
    path = Path(path)
    try:
        text = json.dumps(data, indent=1, allow_nan=False)
    except ValueError as error:
        raise ModelFileError(
            f"{path.name}: the model holds a number that is not finite ({error})", file=path
        ) from error
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(text + "\n", encoding="utf-8")
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
    return path


def read_model(path: str | Path) -> Model:
    """Read and check a model.json. Raises ModelFileNotFoundError (66) or ModelFileError (65) naming the field."""
    path = Path(path)
    if not path.is_file():
        raise ModelFileNotFoundError(f"{path}: there is no such model", file=path)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError) as error:
        raise ModelFileError(f"{path.name}: cannot be read as JSON ({reason_of(error)})", file=path) from error
    if not isinstance(data, dict) or data.get("format") != MODEL_FORMAT:
        found = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise ModelFileError(f"{path.name}: is no {MODEL_FORMAT} (format: {found})", file=path, field="format")
    where = "base_parameters"
    try:
        base = data[where]
        names = tuple(str(item["name"]) for item in base)
        values = np.array([float(item["value"]) for item in base])
        std = np.array([float(item["std"]) for item in base])
        units = tuple(str(item["unit"]) for item in base)
        where = "friction"
        viscous, coulomb = (_column(data.get(where, []), key, "joint") for key in ("viscous", "coulomb"))
        where = "drives"
        rotor, offset = (_column(data.get(where, []), key, "joint") for key in ("rotor_inertia", "offset"))
        where = "physical_parameters"
        physical = _physical(data.get(where, []), viscous, coulomb)
        where = "provenance.regressor"
        options = RegressorOptions.from_json(data.get("provenance", {}).get("regressor", {}))
        where = "robot"
        robot = str(data[where])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ModelFileError(
            f"{path.name}: field '{where}' is not as it should be ({error!r})", file=path, field=where
        ) from error
    if not names or not (np.all(np.isfinite(values)) and np.all(np.isfinite(std))):
        raise ModelFileError(
            f"{path.name}: base_parameters is empty or holds a number that is not finite",
            file=path,
            field="base_parameters",
        )
    return Model(robot, names, values, std, units, physical, rotor, offset, options, str(path), data)


def _column(rows: list[dict[str, Any]], key: str, index: str) -> FloatArray:
    """One number per joint or link, in the order of its index; null counts as zero."""
    ordered = sorted(rows, key=lambda row: int(row[index]))
    if [int(row[index]) for row in ordered] != list(range(1, len(ordered) + 1)):
        raise ValueError(f"{index} does not run from 1 to {len(ordered)}")
    return np.array([0.0 if row[key] is None else float(row[key]) for row in ordered])


def _physical(rows: list[dict[str, Any]], viscous: FloatArray, coulomb: FloatArray) -> PhysicalParameters | None:
    if not rows:
        return None
    ordered = sorted(rows, key=lambda row: int(row["link"]))
    return PhysicalParameters(
        mass=np.array([float(row["mass"]) for row in ordered]),
        center_of_mass=np.array([[float(value) for value in row["com"]] for row in ordered]),
        inertia=np.array([[[float(value) for value in line] for line in row["inertia"]] for row in ordered]),
        viscous=viscous if viscous.size else np.zeros(len(ordered)),
        coulomb=coulomb if coulomb.size else np.zeros(len(ordered)),
    )
