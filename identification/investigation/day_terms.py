"""What changes from recording to recording: friction (temperature) and offset of a joint get a term of their own.

Asked of recordings of the first motion only: between two motions an error of the model differs too, and a hundredth of
the friction is enough to be taken for a change. Base parameters and whatever is hidden are common to all recordings;
the change is estimated beside them and beside the classes that the leading hypothesis has. A change that chance
explains is none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from identification.arrays import FloatArray
from identification.base_parameters import Widths
from identification.investigation.actions import friction_columns, is_same
from identification.investigation.columns import Form, Sums, form_rows, scaled_inverse, sums_of
from identification.investigation.discrepancy import Discrepancies, Variances
from identification.mismatch.evidence import Evidence
from identification.mismatch.settings import DIFFERENT

_OWN = 3
"""Columns of a change: constant, direction, speed."""


@dataclass(frozen=True, slots=True, eq=False)
class DayTerm:
    """recording: its place among those at hand, from 1 on (0 is what they are compared with). joint: from 0.

    change, deviation: (3,) of the offset, Nm, of Coulomb friction, Nm, and of viscous friction, Nm s/rad. chance: of a
    change by so much where there is none.
    """

    recording: int
    joint: int
    change: FloatArray
    deviation: FloatArray
    chance: float

    @property
    def sentence(self) -> str:
        """For the page."""
        parts = [
            f"{name} by {value:+.2g} ± {1.96 * deviation:.1g} {unit}"
            for name, unit, value, deviation in zip(
                ("offset", "Coulomb friction", "viscous friction"), ("Nm", "Nm", "Nm s/rad"), self.change,
                self.deviation, strict=True,
            )
            if abs(value) > 2.0 * deviation
        ]  # fmt: skip
        return (
            f"Joint {self.joint + 1}: {' and '.join(parts) or 'friction'} (95 %) differs from the first recording's "
            f"(chance {self.chance:.1g}): it has a term of its own."
        )

    def torque(self, velocity: FloatArray, coulomb_velocity: Widths) -> FloatArray:
        """(S,) Nm along a motion. velocity: (S, n)."""
        return np.asarray(friction_columns(velocity, coulomb_velocity, self.joint) @ self.change)


def day_terms(
    evidences: Sequence[Evidence], forms: Sequence[Form], beside: Discrepancies, variances: Variances
) -> tuple[DayTerm, ...]:
    """Changes against the first evidence. forms: what is hidden, as far as it has a name, its size fitted along.

    evidences: with the noise of the leading hypothesis. variances: of the classes beside it.
    """
    first_motion = evidences[0].motion
    again = [number for number, item in enumerate(evidences) if number and is_same(first_motion, item.motion)]
    if not again:
        return ()
    places = [(recording, joint) for recording in again for joint in range(evidences[0].n)]
    total: Sums | None = None
    for number, item in enumerate(evidences):
        columns = np.zeros((*item.noise.shape, _OWN * len(places)))
        for index, (recording, joint) in enumerate(places):
            if recording == number:
                shape = friction_columns(item.motion.velocity, item.motion.coulomb_velocity, joint)
                columns[:, joint, _OWN * index : _OWN * (index + 1)] = item.project(shape)
        extra = np.concatenate([*(form_rows(item, form) for form in forms), columns, item.torque[..., None]], axis=2)
        found = sums_of(item, (), extra, beside)
        total = found if total is None else total + found
    assert total is not None
    rest = total.projected(beside.deviations(variances))
    first = sum(form.size for form in forms)
    # Over all joints and recordings together.
    limit = DIFFERENT / len(places)
    chosen: list[tuple[int, int]] = []
    # The strongest first, each beside those found before: one change is not told on every joint that it moves.
    while True:
        chances = {place: _chance(rest, first, places, chosen, place) for place in places if place not in chosen}
        best = min(chances, key=lambda place: chances[place], default=None)
        if best is None or chances[best] >= limit:
            break
        chosen.append(best)
    values, covariance = _fit(rest, first, places, chosen)
    deviations = np.sqrt(np.diag(covariance))
    terms = []
    for number, (recording, joint) in enumerate(chosen):
        own = slice(first + _OWN * number, first + _OWN * (number + 1))
        others = [place for place in chosen if place != (recording, joint)]
        chance = _chance(rest, first, places, others, (recording, joint))
        terms.append(DayTerm(recording, joint, values[own], deviations[own], chance))
    return tuple(terms)


def _fit(
    rest: FloatArray, first: int, places: Sequence[tuple[int, int]], chosen: Sequence[tuple[int, int]]
) -> tuple[FloatArray, FloatArray]:
    """Coefficients of the named forms and of some changes, and their covariance."""
    own = [_OWN * places.index(place) + column + first for place in chosen for column in range(_OWN)]
    kept = np.array([*range(first), *own], dtype=np.int64)
    covariance = scaled_inverse(rest[kept[:, None], kept])
    return covariance @ rest[kept, -1], covariance


def _chance(
    rest: FloatArray, first: int, places: Sequence[tuple[int, int]], chosen: Sequence[tuple[int, int]],
    place: tuple[int, int],
) -> float:  # fmt: skip
    """Of a change that large by noise, beside those that are chosen."""
    values, covariance = _fit(rest, first, places, [*chosen, place])
    own = covariance[-_OWN:, -_OWN:]
    square = float(values[-_OWN:] @ np.linalg.pinv(own, 1e-10, hermitian=True) @ values[-_OWN:])
    return float(chdtrc(_OWN, square)) if math.isfinite(square) else 1.0
