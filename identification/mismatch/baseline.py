"""A given model against recordings: which of its parameters are wrong, by how much, and what no parameters explain.

Torque on the measured motion is split in two: what other base parameters change (wrong parameters, per link), and what
remains after they are fitted (missing physics, which the search then names). Not here: that search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.json_values import json_list, number, plain
from identification.mismatch.evidence import Evidence, fit_parameters
from identification.mismatch.heldout import Residuals
from identification.mismatch.problem import Problem
from identification.mismatch.search.extension import Extension
from identification.mismatch.settings import CLEARLY, UNLIKELY
from identification.model_file import Model, no_check
from identification.robots import RobotModel
from identification.robots.joint_units import in_units
from identification.robots.simulator_models import read_with_drives


@dataclass(frozen=True, slots=True)
class ParameterDeviation:
    """One base parameter of the model against the fit. torque_nm: RMS, all joints, of the difference's torque."""

    name: str
    link: int
    model: float
    fitted: float
    std: float
    unit: str
    torque_nm: float

    @property
    def sigmas(self) -> float:
        """(model − fitted) / std."""
        return (self.model - self.fitted) / self.std if self.std > 0.0 else 0.0

    @property
    def wrong(self) -> bool:
        """Whether the difference is beyond what the fit leaves open."""
        return abs(self.sigmas) > CLEARLY


@dataclass(frozen=True, slots=True)
class LinkDeviation:
    """All base parameters of one link together. probability: of a difference as large where the model is right."""

    link: int
    probability: float
    torque_nm: float

    @property
    def wrong(self) -> bool:
        """Whether the difference is beyond what the fit leaves open."""
        return self.probability < UNLIKELY


@dataclass(frozen=True, slots=True, eq=False)
class ModelComparison:
    """A model against recordings, RMS torque (n,) Nm on the fitted motion within the compared bandwidth.

    model_nm: what the model leaves. parameters_nm: torque between its parameters and those fitted with the
    findings. missing_nm: what no base parameters explain. findings_nm: what stays beside the findings. torque_units: of
    each joint, empty: all Nm. set_up: what an audit of the set-up says in place of wrong links, empty where it is open.
    fitted_to: names of those recordings that the model was fitted to, as far as it says. Of an arm that stands
    otherwise than the model says, parameters and links are empty: other ones show there.
    """

    source: str
    model_nm: FloatArray
    parameters_nm: FloatArray
    missing_nm: FloatArray
    findings_nm: FloatArray
    parameters: tuple[ParameterDeviation, ...]
    links: tuple[LinkDeviation, ...]
    torque_units: tuple[str, ...] = ()
    set_up: str = ""
    fitted_to: tuple[str, ...] = ()

    @property
    def no_check(self) -> tuple[str, ...]:
        """What is said first where the model is compared with what it was fitted to."""
        return tuple(no_check(name) for name in self.fitted_to)

    @property
    def sentence(self) -> str:
        """What an operator reads."""
        wrong = [item for item in self.links if item.wrong]
        model, refitted, named = (
            float(np.sqrt(np.sum(values**2))) for values in (self.model_nm, self.missing_nm, self.findings_nm)
        )
        # Where the model has what a fit of these recordings alone has not, what is named beside that fit leaves more.
        beside = f", and {named:.3g} Nm with what is named beside them" if named <= refitted else ""
        parts = (
            f"{self.source} leaves {model:.3g} Nm RMS (all joints together); with its parameters fitted anew "
            f"{refitted:.3g} Nm stay{beside}. "
        )
        if self.set_up:
            return in_units(f"{parts}{self.set_up}", self.torque_units)
        if not wrong:
            return (
                in_units(parts, self.torque_units) + "None of its parameters is further off than the fit leaves open."
            )
        links = ", ".join(f"link {item.link} ({item.torque_nm:.2g} Nm)" for item in wrong)
        return in_units(f"{parts}Wrong parameters, beyond what the fit leaves open: {links}.", self.torque_units)

    def to_json(self) -> dict[str, Any]:
        """The entry `model_comparison` of diagnosis.json; `wrong` is null where the set-up is the answer."""

        def wrong(item: ParameterDeviation | LinkDeviation) -> bool | None:
            return None if self.set_up else item.wrong

        return {
            "source": self.source,
            "sentence": self.sentence,
            "fitted_to": list(self.fitted_to),
            "rms_nm": {
                "model": json_list(self.model_nm),
                "parameter_difference": json_list(self.parameters_nm),
                "refitted": json_list(self.missing_nm),
                "with_findings": json_list(self.findings_nm),
            },
            "links": [{**plain(item), "wrong": wrong(item)} for item in self.links],
            "parameters": [
                {**plain(item), "sigmas": number(item.sigmas), "wrong": wrong(item)} for item in self.parameters
            ],
        }


def own_values(model: Model | Path, robot: RobotModel) -> tuple[BaseRegressor, FloatArray]:
    """The regressor that a model file's torque is of, as the robot stands, and its base parameters (p,).

    Raises ModelFileError, RobotError.
    """
    if isinstance(model, Path):
        return read_with_drives(model, robot)
    own = BaseRegressor(robot, model.options)
    return own, model.base_values(own)


def name_of(model: Model | Path) -> str:
    """What a given model is called."""
    return model.name if isinstance(model, Path) else Path(model.path or "model").name


def baseline_values(model: Model | Path, regressor: BaseRegressor) -> tuple[str, FloatArray]:
    """Name and base parameters (p,) of a model.json or of a simulator's file.

    Friction, rotor inertias and offsets that it does not hold count as zero; those that the regressor has not are left
    out here (`prediction.rows_beside`). Raises as `own_values`.
    """
    return name_of(model), regressor.base_from_other(*own_values(model, regressor.robot))


def compare_elsewhere(
    source: str,
    expected: FloatArray,
    evidences: Sequence[Evidence],
    extension: Extension,
    after: Residuals,
    missing_nm: FloatArray,
) -> ModelComparison:
    """Of an arm that stands otherwise than its model says: expected, (R, n) Nm, is what the model predicts as it
    stands; the evidences and the parameters fitted to them are under the gravity that the arm felt. Else as
    `compare_model`.
    """
    size = evidences[0].nominal.shape[-1]
    samples = sum(item.samples for item in evidences)
    used = np.concatenate([item.used for item in evidences])
    torque = np.concatenate([item.torque for item in evidences])
    fitted = np.concatenate([item.nominal for item in evidences]) @ extension.base[:size]

    def rms(rows: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.sum(np.where(used, rows, 0.0) ** 2, axis=0) / samples), dtype=np.float64)

    return ModelComparison(
        source, rms(torque - expected), rms(fitted - expected), missing_nm, after.rms_nm, parameters=(), links=()
    )


def compare_model(
    source: str,
    values: FloatArray,
    beside: FloatArray | None,
    evidences: Sequence[Evidence],
    problem: Problem,
    extension: Extension,
    after: Residuals,
    missing_nm: FloatArray,
    regressor: BaseRegressor,
) -> ModelComparison:
    """Split what a model (p,) leaves of the fitted recordings.

    extension: base parameters fitted with the findings; their covariance is scaled by what the fit leaves, so that
    missing physics does not make a right model look wrong. after, missing_nm: what is left with and without findings.
    beside: (R, n) Nm that the model predicts beside its base parameters; these are then compared with parameters fitted
    beside the same torque, not beside the findings.
    """
    size = regressor.size
    samples = sum(item.samples for item in evidences)
    used = np.concatenate([item.used for item in evidences])
    columns = np.where(used[..., None], np.concatenate([item.nominal for item in evidences]), 0.0)
    torque = np.where(used, np.concatenate([item.torque for item in evidences]), 0.0)
    fitted = extension.base[:size]

    def rms(rows: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.sum(rows**2, axis=0) / samples), dtype=np.float64)

    if beside is not None:
        torque = np.where(used, torque - beside, 0.0)
        ends = np.cumsum([len(item.torque) for item in evidences])[:-1]
        pairs = zip(evidences, np.split(beside, ends), strict=True)
        fitted = fit_parameters([replace(item, torque=item.torque - own) for item, own in pairs])
        missing_nm = rms(torque - columns @ fitted)
    difference = values - fitted
    left = (after.rows * problem.weight).ravel()
    excess = max(1.0, float(left @ left) / max(1, int(np.count_nonzero(problem.weight)) - problem.basis.shape[1]))
    covariance = extension.loose[:size] @ extension.loose[:size].T * excess
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    link_of = np.array([int(name.rsplit("_", 1)[1]) for name in regressor.names])
    parameters = tuple(
        ParameterDeviation(
            name, int(link_of[index]), float(values[index]), float(fitted[index]), float(std[index]), unit,
            float(np.sqrt(np.sum(rms(columns[:, :, index] * difference[index]) ** 2))),
        )
        for index, (name, unit) in enumerate(zip(regressor.names, regressor.units, strict=True))
    )  # fmt: skip
    links = []
    for link in range(1, regressor.robot.n + 1):
        own = np.flatnonzero(link_of == link)
        scale = np.maximum(std[own], 1e-300)
        block = covariance[np.ix_(own, own)] / np.outer(scale, scale)
        distance = float((difference[own] / scale) @ np.linalg.pinv(block, rcond=1e-10) @ (difference[own] / scale))
        moved = float(np.sqrt(np.sum(rms(columns[:, :, own] @ difference[own]) ** 2)))
        links.append(LinkDeviation(link, float(chdtrc(max(1, own.size), max(distance, 0.0))), moved))
    return ModelComparison(
        source=source,
        model_nm=rms(torque - columns @ values),
        parameters_nm=rms(columns @ difference),
        missing_nm=missing_nm,
        findings_nm=after.rms_nm,
        parameters=parameters,
        links=tuple(links),
    )
