"""The numbers an exporter writes, taken from a model, and the refusal of numbers that no body can have.

Here: which of the model's parameter sets, and the test of physical consistency. Not here: formats. Nothing is repaired:
a changed inertia would be another robot than the identified one. Called by `write` and by `simulation`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio

from identification.errors import InconsistentParametersError, ModelFileError
from identification.estimators.physical import PhysicalParameters
from identification.model_file import Model
from identification.robots import RobotModel
from identification.robots.model import build_pinocchio_model

FloatArray = npt.NDArray[np.float64]

PARAMETER_SETS = ("physical", "consistent")

_SMALLEST_RELATIVE_SLACK = 1e-12
"""Slack of the triangle inequality below this share of the largest moment is rounding: simulators may refuse it."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelParameters:
    """Everything a simulator can be told about the dynamics of n joints.

    physical: masses, centres of mass, inertias, viscous and Coulomb friction. rotor_inertia: (n,) kg m², seen at the
    joint; zeros where the torque was measured behind the gear. offset: (n,) Nm, constant torque.
    """

    physical: PhysicalParameters
    rotor_inertia: FloatArray
    offset: FloatArray

    def pinocchio_model(self, robot: RobotModel) -> pinocchio.Model:
        """The robot with these inertias and rotor inertias (`armature`); friction and offset are not in it."""
        # M, MX, …, tensor in Pinocchio's order; its constructor from masses refuses inertias that are not positive.
        inertial = self.physical.dynamic_parameters()[:, (0, 1, 2, 3, 4, 5, 7, 6, 8, 9)]
        inertias = tuple(pinocchio.Inertia.FromDynamicParameters(link) for link in inertial)
        model = build_pinocchio_model(robot.name, robot.kinematics, robot.joint_names, robot.gravity, inertias)
        model.armature = self.rotor_inertia
        return model

    def friction(self, velocity: FloatArray) -> FloatArray:
        """F_v q̇ + F_s sign(q̇) of eq. (1), Nm, for velocities (..., n) rad/s."""
        return np.asarray(self.physical.viscous * velocity + self.physical.coulomb * np.sign(velocity))


def parameters_of(model: Model, which: str = "physical") -> ModelParameters:
    """The model's parameter set: "physical" (program (10)) or "consistent" (nearest set that real bodies can have).

    Raises ModelFileError naming the field where the file holds no such set.
    """
    if which not in PARAMETER_SETS:
        raise ModelFileError(f"There is no parameter set '{which}'; known are {', '.join(PARAMETER_SETS)}.")
    if which == "consistent":
        stored = model.data.get("consistent_parameters")
        if not stored:
            raise ModelFileError(
                f"{model.path or 'The model'} holds no consistent parameter set; fit the recording again to get one.",
                file=model.path or None,
                field="consistent_parameters",
            )
        return _consistent(stored, model)
    if model.physical is None:
        raise ModelFileError(
            f"{model.path or 'The model'} holds base parameters only; fit without --no-physical to get masses and "
            "inertias.",
            file=model.path or None,
            field="physical_parameters",
        )
    n = model.physical.n
    rotor, offset = (
        values if values.size else np.zeros(n) for values in (model.rotor_inertia, model.offset)
    )  # fmt: skip
    return ModelParameters(model.physical, rotor, offset)


def _consistent(stored: dict[str, Any], model: Model) -> ModelParameters:
    try:
        column = {
            name: np.array(stored[name], dtype=np.float64)
            for name in ("mass", "com", "inertia", "viscous", "coulomb", "rotor_inertia", "offset")
        }
        physical = PhysicalParameters(
            column["mass"], column["com"], column["inertia"], column["viscous"], column["coulomb"]
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ModelFileError(
            f"{model.path}: field 'consistent_parameters' is not as it should be ({error!r}).",
            file=model.path,
            field="consistent_parameters",
        ) from error
    return ModelParameters(physical, column["rotor_inertia"], column["offset"])


def principal_slack(physical: PhysicalParameters) -> FloatArray:
    """(n,) kg m²: sum of the two smaller principal moments about the centre of mass minus the largest.

    A body's is at least zero, and its moments are positive: where the smallest moment is not, that moment is given.
    """
    moments = np.linalg.eigvalsh(physical.inertia)
    slack = moments[:, 0] + moments[:, 1] - moments[:, 2]
    return np.asarray(np.where(moments[:, 0] <= 0.0, np.minimum(moments[:, 0], slack), slack), dtype=np.float64)


def refuse_inconsistent(physical: PhysicalParameters, *, file: str = "", advice: str = "") -> None:
    """Raise InconsistentParametersError, naming each link and its slack, if a link's parameters belong to no body."""
    name = file or "The model"
    if physical.mass.min() <= 0.0:
        link = int(np.argmin(physical.mass))
        raise InconsistentParametersError(
            f"{name}: the mass of link {link + 1} is {physical.mass[link]:.3g} kg; a simulator needs a positive one."
            + advice,
            link=link + 1,
            slack=float(physical.mass[link]),
            file=file or None,
        )
    slack = principal_slack(physical)
    needed = _SMALLEST_RELATIVE_SLACK * np.abs(np.linalg.eigvalsh(physical.inertia)).max(axis=1)
    bad = np.flatnonzero(slack < needed)
    if bad.size:
        worst = int(bad[np.argmin(slack[bad])])
        links = ", ".join(f"link {link + 1} ({slack[link]:.2g} kg m²)" for link in bad)
        raise InconsistentParametersError(
            f"{name}: no body can have the inertia of {links}: the two smaller principal moments must sum to more "
            f"than the largest, and the slack is in brackets; simulators refuse such links or change them silently."
            + advice,
            link=worst + 1,
            slack=float(slack[worst]),
            file=file or None,
        )
