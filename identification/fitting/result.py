"""What a fit hands back: parameters with their uncertainty, physical parameters with a certificate, RMS, provenance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.estimators.constrained import ConstrainedResult
from identification.estimators.least_squares import LeastSquaresResult
from identification.estimators.nearest import FeasibilityAnswer
from identification.estimators.prior import SettledParameters
from identification.fitting.delay import TorqueDelay
from identification.fitting.misfit import Misfit
from identification.fitting.rms import RmsTable
from identification.fitting.settings import FitSettings
from identification.fitting.torque_sign import TorqueSign
from identification.json_values import json_list
from identification.model_file import MODEL_FORMAT
from identification.physical_parameters import PhysicalParameters
from identification.recordings.recording import Recording
from identification.robots import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """The outcome of `fit_recordings`.

    regressor: names, units and grouping of the p base parameters. estimator: the one used, never "auto".
    least_squares: its values and their covariance on coloured noise (`fitting.covariance`), with what the choice of the
    model adds (`fitting.choice`), and a delay that was taken off. equation_15_std: (p,) the paper's standard
    deviations, of the unweighted fit. constrained: program (10), consistent:
    of real bodies, with a prior for what the data leave open, feasibility: whether a robot can have the base
    parameters; None if not asked for. rms: lines "fit, base", "fit, physical", and "held out, …" where rows were
    held out. noise_floor_nm: (n,) of the fit's evaluation, nan where the recordings do not tell. misfit: of each
    joint over its noise. torque_delay: of the torque against the position, before any correction. torque_shift: (n,) s
    by which the torque was taken earlier, zeros without a correction. told: makes the notes and remembers them.
    provenance: inputs, settings, versions, seed.
    """

    robot: RobotModel
    regressor: BaseRegressor
    settings: FitSettings
    estimator: str
    least_squares: LeastSquaresResult
    equation_15_std: FloatArray
    constrained: ConstrainedResult | None
    consistent: SettledParameters | None
    feasibility: FeasibilityAnswer | None
    rms: RmsTable
    noise_floor_nm: FloatArray
    misfit: Misfit
    torque_sign: TorqueSign
    torque_delay: TorqueDelay
    torque_shift: FloatArray
    pipelines: tuple[str, ...]
    recordings: tuple[Recording, ...]
    told: Callable[[], tuple[str, ...]]
    provenance: dict[str, Any]

    def __reduce__(self) -> tuple[type[FitResult], tuple[Any, ...]]:
        """Notes are made first: what makes them cannot be pickled."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return FitResult, tuple({**values, "told": partial(tuple, self.notes)}.values())

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the reader. What else the recordings may be than they state is asked with them, which takes
        longer than the fit where that leaves more than noise.
        """
        return self.told()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the base parameters."""
        return self.regressor.names

    @property
    def values(self) -> FloatArray:
        """(p,) base parameters."""
        return self.least_squares.values

    @property
    def std(self) -> FloatArray:
        """(p,) their standard deviations."""
        return self.least_squares.std

    @property
    def physical(self) -> PhysicalParameters | None:
        """The physically feasible parameters, None if not asked for."""
        return None if self.constrained is None else self.constrained.physical

    def to_model_json(self, *, notes: bool = True) -> dict[str, Any]:
        """The result as `model.json` of the contract. notes: whether with those, which may take longer than the fit."""
        least_squares = self.least_squares
        return {
            "format": MODEL_FORMAT,
            **self.robot.to_json(),
            "base_parameters": [
                {"name": name, "value": float(value), "std": float(std), "unit": unit, "std_equation_15": float(paper)}
                for name, value, std, unit, paper in zip(
                    self.names, self.values, self.std, self.regressor.units, self.equation_15_std, strict=True
                )
            ],
            "base_covariance": [row[: place + 1].tolist() for place, row in enumerate(least_squares.covariance)],
            "physical_parameters": [] if self.physical is None else self.physical.to_json(),
            "friction": self._friction_json(),
            "drives": self._drives_json(),
            "consistent_parameters": self._consistent_json(),
            "effects": [],
            "rms_nm": self._rms_json(),
            "rms_table": self.rms.to_json(),
            "misfit": self.misfit.to_json(),
            "certificate": self._certificate_json(),
            "provenance": {
                **self.provenance,
                "estimator": self.estimator,
                "condition_number": least_squares.condition_number,
                "joint_weights": json_list(least_squares.weights),
                "pipelines": list(self.pipelines),
                "torque_sign": self.torque_sign.to_json(),
                "torque_delay": self.torque_delay.to_json(),
                "torque_shift_s": self.torque_shift.tolist(),
                "notes": list(self.notes) if notes else [],
            },
        }

    def _consistent_json(self) -> dict[str, Any]:
        """The set for simulators: real bodies can have it. from_data: 1 where the data determine a parameter, 0 where
        the prior does. Empty if not asked for.
        """
        if self.consistent is None:
            return {}
        physical, shares = self.consistent.physical, self.consistent.from_data.tolist()
        return {
            "mass": physical.mass.tolist(),
            "com": physical.center_of_mass.tolist(),
            "inertia": physical.inertia.tolist(),
            "viscous": physical.viscous.tolist(),
            "coulomb": physical.coulomb.tolist(),
            "rotor_inertia": self.regressor.extra_of(self.consistent.full, "IA").tolist(),
            "offset": self.regressor.extra_of(self.consistent.full, "OFF").tolist(),
            "prior": self.consistent.prior,
            "from_data": dict(zip(self.regressor.full_names, shares, strict=True)),
            "misfit_sigma": self.consistent.misfit,
        }

    def _named(self, symbol: str, joint: int) -> float | None:
        """A parameter of the physical set where there is one, else of the base parameters, else None."""
        name = f"{symbol}_{joint + 1}"
        if self.constrained is not None:
            if name not in self.regressor.full_names:
                return None
            return float(self.constrained.full[self.regressor.full_names.index(name)])
        return float(self.values[self.names.index(name)]) if name in self.names else None

    def _friction_json(self) -> list[dict[str, Any]]:
        return [
            {"joint": joint + 1, "viscous": self._named("FV", joint), "coulomb": self._named("FS", joint)}
            for joint in range(self.robot.n)
        ]

    def _drives_json(self) -> list[dict[str, Any]]:
        options = self.regressor.options
        if not (options.rotor_inertia or options.offset):
            return []
        return [
            {"joint": joint + 1, "rotor_inertia": self._named("IA", joint), "offset": self._named("OFF", joint)}
            for joint in range(self.robot.n)
        ]

    def _rms_json(self) -> dict[str, list[float | None]]:
        keys = {
            "fit, base": "fit", "held out, base": "heldout",
            "fit, physical": "fit_physical", "held out, physical": "heldout_physical",
        }  # fmt: skip
        result: dict[str, list[float | None]] = {"fit": [], "heldout": []}
        for row in self.rms.rows:
            if row.label in keys:
                result[keys[row.label]] = json_list(row.rms_nm)
        result["noise_floor"] = json_list(self.noise_floor_nm)
        return result

    def _certificate_json(self) -> dict[str, Any]:
        if self.constrained is None:
            return {}
        return {
            **self.constrained.certificate.to_json(),
            "base_parameters": None if self.feasibility is None else self.feasibility.to_json(),
            "starts": [
                {"origin": start.origin, "cost": start.cost, "converged": start.converged}
                for start in self.constrained.starts
            ],
        }


def warnings_of(notes: Sequence[str]) -> list[str]:
    """Those notes of a fit that say that its recording is not what it states."""
    return [note for note in notes if note.startswith("WARNING")]
