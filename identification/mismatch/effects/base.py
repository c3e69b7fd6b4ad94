"""The shape of an effect: what every file of the effect library provides, and nothing else.

An effect turns a motion into torque columns per unit of its coefficients, for one place (joint, link) and one set of
its nonlinear parameters. It does not see measured torque and does not decide anything.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.motion import Motion


@dataclass(frozen=True, slots=True, order=True)
class Place:
    """Where an effect sits. joint: counted from 1, None for all joints or none in particular. link: from 1, or None.

    other_joint: the second joint of an effect between two (crosstalk, coupling), from 1, or None.
    """

    joint: int | None = None
    link: int | None = None
    other_joint: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Torque of an effect per unit of each coefficient, on the time grid of the motion.

    joints: joints, counted from 0, whose torque it touches. values: (S, len(joints), m) Nm per unit. For an effect that
    differs from period to period, values_by_period: (K, S, len(joints), m), and `values` is its mean over the periods.
    """

    joints: tuple[int, ...]
    values: FloatArray
    values_by_period: FloatArray | None = None


CERTAIN = 2.0
"""Standard deviations that the size of what is claimed has to be away from zero."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One physical parameter of a finding. std: nan where it is not known."""

    name: str
    value: float
    std: float
    unit: str

    @property
    def certainty(self) -> float:
        """Standard deviations that the value is away from zero; inf where either is not known."""
        return abs(self.value) / self.std if np.isfinite(self.value) and self.std > 0.0 else np.inf


@dataclass(frozen=True, slots=True)
class ShapeParameter:
    """One nonlinear parameter: the grid of the search and the bounds of its refinement, in `unit`.

    integer: refine to whole numbers only (an order, a link). tied: it always equals the effect's one coefficient; the
    columns are then the chord of a torque that is not linear in the coefficient. textbook: its value in the form that
    the literature gives, kept unless another one gains what a further coefficient must; None for a
    parameter without such a value. The same physics in a freer form: a real friction or spring follows no textbook, and
    the bounds say how far it may be from it and keep its name. apart: of waves per turn, how far two values are apart
    that the motion tells from each other: beside the usual ones of the grid the search asks those at which what is left
    shows waves; 0 for any other parameter.
    """

    name: str
    unit: str
    grid: tuple[float, ...]
    lower: float
    upper: float
    integer: bool = False
    logarithmic: bool = True
    tied: bool = False
    textbook: float | None = None
    apart: float = 0.0

    @property
    def choices(self) -> float:
        """How many values are asked: those of the grid, or as many as the motion tells apart."""
        return max(len(self.grid), (self.upper - self.lower) / self.apart) if self.apart else len(self.grid)


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What the search hands to an effect to describe itself in words and numbers.

    coefficients: (m,) with covariance (m, m). shape and shape_std: nonlinear parameters by name; shape_covariance: (m,)
    of each with the coefficients, where that is known.
    """

    place: Place
    shape: Mapping[str, float]
    coefficients: FloatArray
    covariance: FloatArray
    shape_std: Mapping[str, float] = field(default_factory=dict)
    shape_covariance: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def std(self) -> FloatArray:
        """(m,) standard deviations of the coefficients."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


Stage = Literal["repeatable", "between_periods"]


class Effect(ABC):
    """One physical effect of the library; one file, one class, one instance.

    Its docstring gives the equation, the usual size of its leading parameter on an iiwa, the effects it is easily taken
    for, and the publication. Class attributes: name (contract §7), stage, units of the m coefficients,
    separating_experiment (what to record to tell it from what looks like it).
    revolute_only: whether the law needs an angle. one_sided: whether the first coefficient is positive on every real
    machine; what would need a negative one is then something else, and the effect no candidate. everywhere: whether it
    may be on every joint at once, as one hypothesis (`Place()`). sees_torque: whether its columns depend on the
    motion's torque or on its dynamic parameters.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage] = "repeatable"
    units: ClassVar[tuple[str, ...]]
    separating_experiment: ClassVar[str]
    one_sided: ClassVar[bool] = False
    everywhere: ClassVar[bool] = False
    sees_torque: ClassVar[bool] = True
    revolute_only: ClassVar[bool] = False

    def places(self, motion: Motion) -> Sequence[Place]:
        """Every place at which this effect can sit on this robot: every joint, or every revolute one."""
        revolute = motion.robot.kinematics.revolute
        return tuple(Place(joint=joint + 1) for joint in range(motion.n) if revolute[joint] or not self.revolute_only)

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """Nonlinear parameters with their grids; none for a linear effect. Several: the search takes the product."""
        return ()

    @abstractmethod
    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Torque columns; None when the motion does not let the effect act there (then it is not identifiable)."""

    def is_impossible(self, coefficients: FloatArray, std: FloatArray | None = None) -> bool:
        """Whether no real machine has these coefficients (m,): a one-sided effect's first below zero.

        std: (m,) whatever the shape is, where that is known.
        """
        return bool(self.one_sided and coefficients[0] < 0.0)

    def phase(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> FloatArray | None:
        """Angle (S,) in rad, of which the torque is a function with period 2π; None for what does not repeat so."""
        return None

    def parts(self, estimate: Estimate) -> Sequence[Estimate]:
        """The estimate as it is described: one for each joint where the effect is asked of every joint at once."""
        return (estimate,)

    @abstractmethod
    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """The physical parameters of an estimate, by the names and units that diagnosis.json shows."""

    def certainty(self, estimate: Estimate) -> float:
        """Standard deviations that its size is away from zero."""
        return self.parameters(estimate)[0].certainty

    @abstractmethod
    def sentence(self, estimate: Estimate) -> str:
        """What an operator reads: the effect, the joint, the size, in one sentence."""
