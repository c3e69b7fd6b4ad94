"""The term of the search that asks for a motion on which missing physics shows: least detectable effect, soft minimum.

Here: detectability λ of each effect at each joint after the base parameters, and after each effect it is easily taken
for, took up what they can; the soft minimum with its exact gradient. Not here: the laws (`effect_columns`) and the
statement about a finished design (`effect_report`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from identification.arrays import FloatArray
from identification.excitation.effect_columns import Where, columns_of, evaluate_columns
from identification.excitation.objective import GramTerm, Samples, log_condition_number
from identification.robots import Kinematics

LOOK_ALIKES = (
    ("torque_offset", "cable_spring"),
    ("torque_offset", "asymmetric_viscous_friction"),
    ("cable_spring", "asymmetric_viscous_friction"),
    ("cable_spring", "torque_sensor_gain"),
    ("cable_spring", "position_dependent_torque"),
    ("stribeck_friction", "nonlinear_viscous_friction"),
    ("load_dependent_friction", "position_dependent_friction"),
    ("load_dependent_friction", "stribeck_friction"),
)
"""Effects on one joint that are easily taken for each other; each is asked for beside the other too."""

WORST_CONDITION = 100.0
"""Above it the condition number adds to the value: a motion that shows effects must determine the parameters too."""

_SHARPNESS = 2.0
_HOPELESS = 1.0
"""λ below which no trial motion brings an effect: it is left out, lest the whole design serve what cannot be seen."""


def bounded_condition(samples: Samples) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """The square of log(cond / WORST_CONDITION) where cond is above it, else nothing; a term of the search."""
    value, by_matrix, by_position, by_velocity = GramTerm(log_condition_number)(samples)
    beyond = max(0.0, value - float(np.log(WORST_CONDITION)))
    return beyond**2, 2.0 * beyond * by_matrix, by_position, by_velocity


@dataclass(frozen=True, slots=True)
class Measure:
    """One λ: the columns (indices) of an effect at a joint, and those of the other effect that may explain it."""

    own: tuple[int, ...]
    other: tuple[int, ...] = ()


def measures_of(where: tuple[Where, ...]) -> tuple[Measure, ...]:
    """Every effect at every joint alone, and beside each of its look-alikes at that joint."""
    groups: dict[Where, tuple[int, ...]] = {}
    for index, place in enumerate(where):
        groups[place] = (*groups.get(place, ()), index)
    found = [Measure(own) for own in groups.values()]
    for place, own in groups.items():
        for pair in LOOK_ALIKES:
            if place.effect in pair:
                partner = groups.get(replace(place, effect=pair[pair[0] == place.effect]))
                if partner is not None:
                    found.append(Measure(own, partner))
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class DetectabilityTerm:
    """Soft minimum over λ, a term of the search: smaller is better, lower by 0.1 where all effects show 10 % smaller.

    values: (p,) nominal base parameters as `nominal.searched_base_values`. noise_nm: (n,) per sample; run_samples:
    number of samples of the run (rate · period · periods), to which the few of the search are scaled.
    """

    values: FloatArray
    noise_nm: FloatArray
    run_samples: float
    where: tuple[Where, ...]
    measures: tuple[Measure, ...] = field(repr=False)

    @classmethod
    def of_robot(
        cls, kinematics: Kinematics, values: FloatArray, noise_nm: FloatArray, run_samples: float
    ) -> DetectabilityTerm:
        """The term with all effects at all joints."""
        where = columns_of(kinematics)
        return cls(values, noise_nm, run_samples, where, measures_of(where))

    def reachable(self, trials: list[FloatArray]) -> DetectabilityTerm:
        """The term without measures whose λ (as from `strengths`) is below 1 on every one of the trial motions."""
        best = np.max(trials, axis=0)
        kept = tuple(m for m, value in zip(self.measures, best, strict=True) if value >= _HOPELESS)
        return replace(self, measures=kept)

    def strengths(self, samples: Samples) -> FloatArray:
        """λ of each measure at plausible size, (K,); of a pair of columns the phase that shows least."""
        return self._solve(samples).strength

    def __call__(self, samples: Samples) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """Value ½κ⁻¹ log mean λ^−κ, and gradients in Y (S, n, p), q and q̇ (S, n).

        λ = min over β, x of |c v − d x − Y β|², so dλ = 2 rᵀ (dc v − dd x − dY β): all weights follow from the rests
        of all columns and one symmetric matrix P = ∂value/∂(rest' rest).
        """
        found = self._solve(samples)
        nothing = np.zeros_like(samples.velocity)
        if not np.all(found.strength > 0.0):
            return np.inf, np.zeros_like(samples.matrix), nothing, nothing
        # λ^−κ relative to the smallest: powers of what differs by ten orders of magnitude.
        logs = np.log(found.strength)
        shares = np.exp(-_SHARPNESS * (logs - logs.min()))
        value = float(-0.5 * logs.min() + 0.5 / _SHARPNESS * np.log(np.mean(shares)))
        weights = -0.5 * shares / np.sum(shares) / found.strength
        inner = (found.mix * weights) @ found.mix.T
        by_rest = 2.0 * found.rest @ inner
        scale = self._scale(samples)
        by_matrix = -(by_rest @ found.absorbed.T).reshape(samples.matrix.shape) * scale[:, None]
        joints = [place.joint for place in self.where]
        by_column = by_rest.reshape(*nothing.shape, -1)[:, joints, np.arange(len(joints))] * scale[joints]
        by_position, by_velocity, by_torque = np.zeros_like(nothing), np.zeros_like(nothing), np.zeros_like(nothing)
        for index, place in enumerate(self.where):
            _, of_position, of_velocity, of_torque = found.columns[:, :, index] * by_column[:, index]
            by_position[:, place.joint] += of_position
            by_velocity[:, place.joint] += of_velocity
            by_torque[:, place.source] += of_torque
        by_matrix += by_torque[..., None] * self.values
        return value, by_matrix, by_position, by_velocity

    def _scale(self, samples: Samples) -> FloatArray:
        return np.asarray(np.sqrt(self.run_samples / len(samples.velocity)) / self.noise_nm)

    def _solve(self, samples: Samples) -> _Solved:
        scale = self._scale(samples)
        count, joints, size = samples.matrix.shape
        columns = evaluate_columns(self.where, samples, samples.matrix @ self.values)
        spread = np.zeros((count, joints, len(self.where)))
        touched = [place.joint for place in self.where]
        spread[:, touched, np.arange(len(touched))] = columns[0] * scale[touched]
        basis, triangle = np.linalg.qr((samples.matrix * scale[:, None]).reshape(-1, size))
        whitened = spread.reshape(count * joints, -1)
        coordinates = basis.T @ whitened
        rest = whitened - basis @ coordinates
        gram = rest.T @ rest
        diagonal = np.abs(np.diag(triangle))
        if diagonal.min() <= 1e-12 * diagonal.max():
            nothing = np.zeros(len(self.measures))
            return _Solved(columns, rest, coordinates, np.zeros((len(touched), len(nothing))), nothing)
        absorbed = np.linalg.solve(triangle, coordinates)
        mix = np.zeros((len(touched), len(self.measures)))
        strength = np.empty(len(self.measures))
        for k, measure in enumerate(self.measures):
            own, other = list(measure.own), list(measure.other)
            left = gram[np.ix_(own, own)]
            explained: FloatArray = np.zeros((len(other), len(own)))
            if other:
                explained = np.linalg.pinv(gram[np.ix_(other, other)], 1e-12, hermitian=True) @ gram[np.ix_(other, own)]
                left = np.asarray(left - gram[np.ix_(own, other)] @ explained)
            values, vectors = np.linalg.eigh(left)
            strength[k] = values[0]
            mix[own, k] = vectors[:, 0]
            mix[other, k] = -explained @ vectors[:, 0]
        return _Solved(columns, rest, absorbed, mix, strength)


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """columns (4, S, M) as evaluated; whitened rest (S n, M); absorbed (p, M): base parameters that took up each
    column; mix (M, K): the combination of columns that each measure's λ is the square of; strength (K,): λ.
    """

    columns: FloatArray
    rest: FloatArray
    absorbed: FloatArray
    mix: FloatArray
    strength: FloatArray
