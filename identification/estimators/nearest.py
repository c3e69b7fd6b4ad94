"""Can any robot made of matter have these base parameters, and how far away is the nearest that exists?

Base parameters are sums of physical ones, so some can be refuted one by one (a sum of moments of inertia below zero);
others only together. The answer is the pseudo-inertia program with noise-free torque of the parameters themselves on
a motion: its optimum is the nearest robot, its dual value proves that none is nearer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import EstimationError
from identification.estimators.feasibility import FeasibilityRules, rules_of_matter
from identification.estimators.least_squares import solve_least_squares
from identification.estimators.observation import Observation
from identification.estimators.semidefinite import SemidefiniteResult, solve_semidefinite
from identification.json_values import plain
from identification.physical_parameters import INERTIAL_COUNT, pseudo_inertia

Motion = tuple[FloatArray, FloatArray, FloatArray]

# Nm, pooled over the joints: what no torque sensor sees.
_SMALLEST_DISTANCE = 1e-3
_UNIT = 1e-2
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class ImpossibleParameter:
    """A base parameter that no robot has, whatever the others are.

    allowed: "at least 0" or "at most 0". std: its standard deviation where known: noise alone may have carried it over.
    """

    name: str
    value: float
    allowed: str
    std: float | None = None

    def sentence(self) -> str:
        """The parameter with its σ and what any robot has."""
        spread = "" if self.std is None else f" ± {self.std:.2g}"
        return f"{self.name} = {self.value:.3g}{spread} ({self.allowed} in any robot)"


@dataclass(frozen=True, slots=True, eq=False)
class FeasibilityAnswer:
    """Whether a robot with these base parameters can exist.

    feasible: a robot whose torques differ by no more than 1 mNm (RMS over all joints) on the motion. distance_nm: (n,)
    RMS per joint of the torque between the parameters and the nearest physical robot. lower_bound_nm: RMS over all
    joints and samples (weighted as asked) below which no physical robot comes (dual value). pooled_nm: that of the
    nearest, unweighted. impossible: parameters that are refuted alone. nearest: that robot.
    """

    feasible: bool
    distance_nm: FloatArray
    pooled_nm: float
    lower_bound_nm: float
    impossible: tuple[ImpossibleParameter, ...]
    nearest: SemidefiniteResult

    @property
    def total_nm(self) -> float:
        """Sum of the joints' distances, as the last line of the paper's Table 4."""
        return float(self.distance_nm.sum())

    def sentence(self) -> str:
        """The answer for an operator."""
        if self.feasible:
            return (
                "A robot made of matter can have these base parameters: the nearest differs by "
                f"{1e3 * self.total_nm:.3g} mNm (sum of the joints' RMS on this motion)."
            )
        alone = "; ".join(item.sentence() for item in self.impossible)
        return (
            "No robot made of matter has exactly these base parameters"
            + (f": {alone}" if alone else ", though each alone is possible")
            + f". The nearest one's torque is {self.total_nm:.3f} Nm away (sum of the joints' RMS on this motion)."
        )

    def to_json(self) -> dict[str, Any]:
        """The answer as plain JSON types."""
        return {
            "feasible": self.feasible,
            "distance_nm": self.distance_nm.tolist(),
            "total_nm": self.total_nm,
            "pooled_nm": self.pooled_nm,
            "lower_bound_nm": self.lower_bound_nm,
            "impossible": plain(self.impossible),
            "nearest_base_parameters": self.nearest.base_values.tolist(),
        }


def nearest_physical(
    base_values: FloatArray,
    base: BaseRegressor,
    motion: Motion,
    *,
    rules: FeasibilityRules | None = None,
    deviation_nm: FloatArray | None = None,
    std: FloatArray | None = None,
) -> FeasibilityAnswer:
    """The physical robot whose torque on a motion is nearest to that of base parameters (p,).

    motion: positions, velocities, accelerations (S, n). Nearest: smallest sum of squared torque differences over all
    joints, each joint divided by deviation_nm (n,) where given. Physical: pseudo-inertia of every link positive
    semidefinite (Wensing, Kim, Slotine, IEEE RA-L 2018; Sousa and Cortesão, IJRR 2014), friction and rotor inertias not
    negative; no bounds (10b) unless rules are given, no shapes (10d). std: (p,) of the values, only named in the
    answer. Raises EstimationError for values of another number, UndeterminedParametersError for a motion that does not
    excite all of them.
    """
    if base_values.shape != (base.size,):
        raise EstimationError(f"{base.robot.name} has {base.size} base parameters, not {len(base_values)}")
    matrix, joint = base.stacked(*motion)
    scale = np.ones(len(joint)) if deviation_nm is None else (deviation_nm.mean() / deviation_nm)[joint]
    matrix = matrix * scale[:, None]
    exact = solve_least_squares(Observation(matrix, matrix @ base_values, joint, base.names), weighting="none")
    # As if measured with 10 mNm of noise: it only sets the unit in which the program counts, and is taken off again.
    offset = _UNIT**2 * len(joint)
    problem = replace(exact.reduced, residual_square=offset)
    nearest = solve_semidefinite(problem, base, rules if rules is not None else rules_of_matter(), inertia_margin=0.0)
    difference = matrix @ (nearest.base_values - base_values) / scale
    squares = np.bincount(joint, difference**2, base.robot.n) / np.bincount(joint, minlength=base.robot.n)
    lower_bound = float(np.sqrt(max(nearest.lower_bound - offset, 0.0) / len(joint)))
    return FeasibilityAnswer(
        feasible=lower_bound <= _SMALLEST_DISTANCE,
        distance_nm=np.sqrt(squares),
        pooled_nm=float(np.sqrt(np.mean(difference**2))),
        lower_bound_nm=lower_bound,
        impossible=impossible_parameters(base_values, base, std),
        nearest=nearest,
    )


def impossible_parameters(
    base_values: FloatArray, base: BaseRegressor, std: FloatArray | None = None
) -> tuple[ImpossibleParameter, ...]:
    """Base parameters (p,) whose value no robot has, whatever the other values: closed form, no motion needed.

    A base parameter K_i π is Σ_l tr(N_l P_l) of the links' pseudo-inertias P_l ⪰ 0 plus terms in friction; it is never
    negative exactly if all N_l ⪰ 0 and the factors of friction are not negative.
    """
    found = []
    for position, (name, value, factors) in enumerate(zip(base.names, base_values, base.regrouping, strict=True)):
        spread = None if std is None else float(std[position])
        size = _ROUNDING * float(np.abs(factors).max())
        for sign, allowed in ((1.0, "at least 0"), (-1.0, "at most 0")):
            if sign * value < 0.0 and _never_negative(sign * factors, base, size):
                found.append(ImpossibleParameter(name, float(value), allowed, spread))
    return tuple(found)


def _never_negative(factors: FloatArray, base: BaseRegressor, rounding: float) -> bool:
    table = factors.reshape(base.robot.n, -1)
    if base.options.offset:  # offsets have either sign
        place = INERTIAL_COUNT + base.options.symbols.index("OFF")
        if np.any(np.abs(table[:, place]) > rounding):
            return False
    if np.any(table[:, INERTIAL_COUNT:] < -rounding):
        return False
    return bool(np.linalg.eigvalsh(_adjoint(table[:, :INERTIAL_COUNT])).min() >= -rounding)


def _adjoint(inertial: FloatArray) -> FloatArray:
    """(n, 4, 4) N with tr(N P(π)) = factors · π for all π: the transpose of the map to pseudo-inertias."""
    basis = pseudo_inertia(np.eye(INERTIAL_COUNT))
    gram = np.einsum("aij,bij->ab", basis, basis)
    return np.asarray(np.einsum("nb,bij->nij", np.linalg.solve(gram, inertial.T).T, basis), dtype=np.float64)
