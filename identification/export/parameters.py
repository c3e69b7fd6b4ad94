"""The numbers an exporter writes, taken from a model, and the refusal of numbers that no body can have.

Here: which of the model's parameter sets, and the test of physical consistency. Not here: formats. Nothing is repaired
silently: a changed inertia would be another robot than the identified one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio

from identification.arrays import BoolArray, FloatArray
from identification.base_parameters import BaseRegressor, Widths, direction_of
from identification.errors import InconsistentParametersError, ModelFileError, SolverError
from identification.estimators.prior import BodyPrior, SettledParameters, settle_open_directions
from identification.model_file import Model
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from identification.robots.model import build_pinocchio_model

PARAMETER_SETS = ("consistent", "physical")

_DETERMINED, _OPEN = 0.9, 0.1
"""Shares of the data in a parameter's variance above which it is called theirs, and below which the prior's."""
_WORTH_SAYING = 1.5

_SMALLEST_RELATIVE_SLACK = 1e-12
"""Slack of the triangle inequality below this share of the largest moment is rounding: simulators may refuse it."""
_ROUNDING = 1e-9
"""Nm, Nm s/rad, kg m²: what a solver at a bound of zero leaves below it."""


@dataclass(frozen=True, slots=True, eq=False)
class Origins:
    """What the parameters of `settled` rest on, by name; base_names: of its base parameters. alone: (full,) whether
    base parameters tell it without any other: of the rest no motion tells more than a sum that the prior splits.
    """

    names: tuple[str, ...]
    settled: SettledParameters
    alone: BoolArray
    base_names: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The prior, the share of the data of every parameter (1: they determine it, 0: the prior does), and those that
        some motion can tell alone.
        """
        return {
            "prior": self.settled.prior,
            "from_data": dict(zip(self.names, self.settled.from_data.tolist(), strict=True)),
            "told_alone": [name for name, alone in zip(self.names, self.alone, strict=True) if alone],
            "misfit_sigma": self.settled.misfit,
        }

    def sentences(self) -> tuple[str, ...]:
        """One for all, and one for each link: its parameters about the origin of its frame, as eq. (3) names them."""
        links = self.settled.physical.n
        shares = self.settled.from_data.reshape(links, -1)
        told = (shares >= _DETERMINED) & self.alone.reshape(links, -1)
        symbols = [name.partition("_")[0] for name in self.names[: shares.shape[1]]]
        lines = [
            f"Of {shares.size} parameters the data determine {int(told.sum())}, the prior "
            f"({self.settled.prior}) {int((shares <= _OPEN).sum())}, and both together the others, with the data's "
            "share in brackets."
        ]
        if self.settled.misfit > _WORTH_SAYING:
            lines.append(
                f"No real body has the base parameters within their σ: they were moved by {self.settled.misfit:.1f} "
                f"times σ (RMS){self._most_moved()}. Physics that the model lacks does that: see diagnose."
            )
        for link, (row, whole) in enumerate(zip(shares, told, strict=True), start=1):
            by_data = [symbol for symbol, is_told in zip(symbols, whole, strict=True) if is_told]
            by_prior = [symbol for symbol, share in zip(symbols, row, strict=True) if share <= _OPEN]
            by_both = [
                f"{symbol} ({100 * share:.0f} %)"
                for symbol, share, is_told in zip(symbols, row, whole, strict=True)
                if share > _OPEN and not is_told
            ]
            parts = (("data", by_data), ("both", by_both), ("prior", by_prior))
            lines.append(f"Link {link}: " + "; ".join(f"{who}: {', '.join(what)}" for who, what in parts if what) + ".")
        return tuple(lines)

    def _most_moved(self) -> str:
        """The base parameter that real bodies contradict most, as part of a sentence."""
        if not self.base_names:
            return ""
        most = int(np.argmax(np.abs(self.settled.moved)))
        sigmas, value = abs(float(self.settled.moved[most])), float(self.settled.base_values[most])
        return f", most of all {self.base_names[most]} by {sigmas:.1f} σ to {value:.4g}"


@dataclass(frozen=True, slots=True, eq=False)
class ModelParameters:
    """Everything a simulator can be told about the dynamics of n joints.

    physical: masses, centres of mass, inertias, viscous and Coulomb friction. rotor_inertia: (n,) kg m², seen at the
    joint; zeros where the torque was measured behind the gear. offset: (n,) Nm, constant torque. origins: what each
    parameter rests on, None where no prior was used.
    """

    physical: PhysicalParameters
    rotor_inertia: FloatArray
    offset: FloatArray
    origins: Origins | None = None

    def pinocchio_model(self, robot: RobotModel) -> pinocchio.Model:
        """The robot with these inertias and rotor inertias (`armature`); friction and offset are not in it."""
        # M, MX, …, tensor in Pinocchio's order; its constructor from masses refuses inertias that are not positive.
        inertial = self.physical.dynamic_parameters()[:, (0, 1, 2, 3, 4, 5, 7, 6, 8, 9)]
        inertias = tuple(pinocchio.Inertia.FromDynamicParameters(link) for link in inertial)
        model = build_pinocchio_model(robot.name, robot.kinematics, robot.joint_names, robot.gravity, inertias)
        model.armature = self.rotor_inertia
        return model

    def friction(self, velocity: FloatArray, coulomb_velocity: Widths = 0.0) -> FloatArray:
        """F_v q̇ + F_s sign(q̇) of eq. (1), Nm, for velocities (..., n) rad/s; coulomb_velocity v: F_s tanh(q̇/v)."""
        direction = direction_of(velocity, coulomb_velocity)
        return np.asarray(self.physical.viscous * velocity + self.physical.coulomb * direction)


def parameters_of(model: Model, which: str = "consistent", prior: BodyPrior | None = None) -> ModelParameters:
    """The model's parameter set: "consistent" (bodies that exist; a prior where the data leave directions open) or
    "physical" (program (10)).

    prior: of the consistent set, uniform bodies where none is given. Raises ModelFileError naming the field where the
    file holds no such set.
    """
    if which not in PARAMETER_SETS:
        raise ModelFileError(f"There is no parameter set '{which}'; known are {', '.join(PARAMETER_SETS)}.")
    if which == "consistent":
        regressor = BaseRegressor(model.load_robot(), model.options)
        settled = _settled(model, regressor, prior)
        rotor, offset = (regressor.extra_of(settled.full, symbol) for symbol in ("IA", "OFF"))
        mixed = np.eye(len(settled.full)) - regressor.ungrouping @ regressor.regrouping
        alone = np.diag(mixed) < _ROUNDING
        origins = Origins(regressor.full_names, settled, alone, regressor.names)
        return ModelParameters(settled.physical, rotor, offset, origins)
    if model.physical is None:
        raise ModelFileError(
            f"{model.path or 'The model'} holds base parameters only; fit without --no-physical to get the set of "
            "program (10), or take the consistent one.",
            file=model.path or None,
            field="physical_parameters",
        )
    n = model.physical.n
    rotor, offset = (
        values if values.size else np.zeros(n) for values in (model.rotor_inertia, model.offset)
    )  # fmt: skip
    return ModelParameters(model.physical, rotor, offset)


def _settled(model: Model, regressor: BaseRegressor, prior: BodyPrior | None) -> SettledParameters:
    """Bodies that exist for a model's base parameters; those of a file may be such that none are found."""
    values, covariance = model.base_values(regressor), model.base_covariance(regressor)
    try:
        return settle_open_directions(values, covariance, regressor, prior)
    except SolverError as error:
        why = "" if model.std.any() else ": every 'std' is zero, and no real body has exactly these values"
        raise ModelFileError(
            f"{model.path or 'The model'}: no real bodies were found for field 'base_parameters'{why} ({error})",
            file=model.path or None,
            field="base_parameters",
        ) from error


def principal_slack(physical: PhysicalParameters) -> FloatArray:
    """(n,) kg m²: sum of the two smaller principal moments about the centre of mass minus the largest.

    A body's is at least zero, and its moments are positive: where the smallest moment is not, that moment is given.
    """
    moments = np.linalg.eigvalsh(physical.inertia)
    slack = moments[:, 0] + moments[:, 1] - moments[:, 2]
    return np.asarray(np.where(moments[:, 0] <= 0.0, np.minimum(moments[:, 0], slack), slack), dtype=np.float64)


def refuse_unmovable(parameters: ModelParameters, *, file: str = "") -> None:
    """Raise InconsistentParametersError where no simulation of an arm means anything: it would gain energy by moving.

    That is a mass, a principal moment, friction or a rotor inertia below zero, or a link without mass. A moment larger
    than the sum of the other two passes here: no body has it, but its motion can be computed.
    """
    physical, name = parameters.physical, file or "The model"
    moments = np.linalg.eigvalsh(physical.inertia)
    least = np.where(moments[:, 0] < -_SMALLEST_RELATIVE_SLACK * moments[:, 2], moments[:, 0], 0.0)
    checked = (
        ("the mass of link", "kg", physical.mass, physical.mass <= 0.0),
        ("the smallest principal moment of inertia of link", "kg m²", least, least < 0.0),
        ("the viscous friction of joint", "Nm s/rad", physical.viscous, physical.viscous < -_ROUNDING),
        ("the Coulomb friction of joint", "Nm", physical.coulomb, physical.coulomb < -_ROUNDING),
        ("the rotor inertia of joint", "kg m²", parameters.rotor_inertia, parameters.rotor_inertia < -_ROUNDING),
    )
    for what, unit, values, bad in checked:
        if bad.any():
            place = int(np.argmax(bad))
            raise InconsistentParametersError(
                f"{name}: {what} {place + 1} is {values[place]:.3g} {unit}; no arm that moves has such a one.",
                link=place + 1,
                slack=float(values[place]),
                file=file or None,
            )


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
