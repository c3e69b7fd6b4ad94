"""What changed between two recordings of one arm: the fewest causes, and the parameters in σ."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from identification.audit.audit import audit
from identification.audit.difference import Audit
from identification.audit.reading import read_so
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.fitting.result import FitResult, warnings_of
from identification.fitting.settings import FitSettings
from identification.json_values import plain
from identification.mismatch.prediction import left_to_parameters
from identification.model_file import Model
from identification.recording_fit import fit_recordings
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """One base parameter before and after. sigmas: (after − before) over the deviation of both together."""

    name: str
    before: float
    after: float
    sigmas: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """audit: the fewest causes. parameters: all that both have, the largest difference in σ first. warnings: of the
    fit of the recording alone, which may be another one than it states.
    """

    audit: Audit
    parameters: tuple[ParameterChange, ...]
    warnings: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As plain JSON types."""
        return {
            "audit": self.audit.to_json(),
            "differences": [item.to_json() for item in self.audit.differences],
            "parameters": plain(self.parameters),
            "warnings": list(self.warnings),
        }


def fitted_to(recording: Recording, robot: RobotModel, like: RegressorOptions | None = None) -> FitResult:
    """The fit of one recording as it stands, without its physical sets.

    like: of a model that its parameters are compared with, which mean the same only beside the same drives and the same
    width of friction. Offsets are taken where that model or the recording asks for them.
    """
    settings = FitSettings(physical=False, check_torque_sign=False)
    if like is not None:
        settings = replace(
            settings,
            rotor_inertia="yes" if like.rotor_inertia else "no",
            offset="yes" if like.offset else "auto",
            coulomb_velocity=like.coulomb_velocity,
        )
    return fit_recordings([recording], robot, settings)


def model_of(recording: Recording, robot: RobotModel) -> Model:
    """The fit of one recording as a model. Raises the errors of a fit."""
    return model_of_fit(fitted_to(recording, robot), Path(recording.source.path).name)


def model_of_fit(fit: FitResult, name: str) -> Model:
    """A fit as a model, named after its recording, without the fit's notes: nothing is compared with those."""
    regressor, nothing = fit.regressor, np.zeros(fit.robot.n)
    return Model(
        fit.robot.spec, fit.names, fit.values, fit.std, regressor.units, None, nothing, nothing, regressor.options,
        name, fit.to_model_json(notes=False),
    )  # fmt: skip


def changes_between(model: Model, recording: Recording, robot: RobotModel, called: str = "") -> Change:
    """What of a recording differs from a model of the same arm. Raises the errors of a fit and of an audit.

    called: the model's name in the sentences, in place of its file's. Effects and class terms of the model are taken
    off the recording first: parameters are compared that explain the same torque.
    """
    (recording,) = left_to_parameters(model, [recording], robot)
    found = audit([recording], robot, model, called)
    # Of exchanged torques, or under another clock, parameters are of no arm.
    (read,) = read_so(found.reading, [recording], robot)
    fit = fitted_to(read, robot, model.options)
    before = dict(zip(model.names, zip(model.values, _deviations(model, robot), strict=True), strict=True))
    units = dict(zip(fit.names, fit.regressor.units, strict=True))
    parameters = []
    for name, after, std in zip(fit.names, fit.values, fit.std, strict=True):
        if name in before:
            value, deviation = before[name]
            sigmas = float((after - value) / max(float(np.hypot(std, deviation)), 1e-300))
            parameters.append(ParameterChange(name, float(value), float(after), sigmas, units[name]))
    parameters.sort(key=lambda item: -abs(item.sigmas))
    return Change(found, tuple(parameters), tuple(warnings_of(fit.notes)))


def _deviations(model: Model, robot: RobotModel) -> list[float]:
    regressor = BaseRegressor(robot, model.options)
    covariance = model.base_covariance(regressor)
    order = [regressor.names.index(name) for name in model.names]
    return [float(np.sqrt(covariance[place, place])) for place in order]
