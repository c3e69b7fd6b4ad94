"""What a motion can show of each effect. Truth: NumPy's least squares, identities of the physics."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.detectability import (
    ORACLE_STRENGTH,
    Candidate,
    candidates,
    confusable,
    planned_rows,
)
from identification.mismatch.effects import effect_named
from identification.mismatch.effects.equivalence import relation
from identification.mismatch.evidence import PlannedRows
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from tests.identification.mismatch.effects.motions import motion_of, shipped_motion

FloatArray = npt.NDArray[np.float64]
NOISE = np.array([0.17, 0.17, 0.12, 0.12, 0.08, 0.05, 0.04])


@pytest.fixture(scope="module")
def rows(iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters) -> PlannedRows:
    motion = shipped_motion(iiwa14, table3, rate_hz=125.0)
    return planned_rows(motion, iiwa14_base, NOISE, periods=16)


@pytest.fixture(scope="module")
def found(rows: PlannedRows) -> tuple[Candidate, ...]:
    return candidates([rows])


def the(found: tuple[Candidate, ...], name: str, **place: int | None) -> Candidate:
    (candidate,) = (
        item
        for item in found
        if item.effect.name == name and all(getattr(item.place, key) == value for key, value in place.items())
    )
    return candidate


def whitened(rows: PlannedRows, candidate: Candidate) -> tuple[FloatArray, FloatArray]:
    """The nominal rows and the first column of an effect, stacked joint by joint, in units of the noise."""
    columns = candidate.effect.columns(rows.motion, candidate.place, candidate.shape)
    assert columns is not None
    full = np.zeros((rows.motion.samples, 7))
    full[:, list(columns.joints)] = columns.values[..., 0]
    nominal = (rows.nominal / rows.noise[..., None]).transpose(1, 0, 2).reshape(-1, rows.nominal.shape[2])
    return nominal, (rows.project(full) / rows.noise).T.ravel()


@pytest.mark.parametrize("name", ["stribeck_friction", "joint_elasticity", "nonlinear_viscous_friction"])
def test_the_smallest_size_leaves_the_oracles_strength_after_the_fit(
    rows: PlannedRows, found: tuple[Candidate, ...], name: str
) -> None:
    candidate = the(found, name, joint=4)
    nominal, column = whitened(rows, candidate)
    smallest = candidate.smallest()
    size = 1.0 / smallest.value if name == "joint_elasticity" else smallest.value
    shift, *_ = np.linalg.lstsq(nominal, size * column, rcond=None)
    left = size * column - nominal @ shift
    assert left @ left == pytest.approx(ORACLE_STRENGTH, rel=1e-6)
    assert candidate.absorbed_fraction == pytest.approx(1.0 - left @ left / (size**2 * column @ column))


def test_what_is_a_base_parameter_in_other_words_is_absorbed_whole(found: tuple[Candidate, ...]) -> None:
    hidden = (
        the(found, "torque_sensor_gain", joint=None),
        the(found, "payload", link=7),
        the(found, "joint_zero_offset", joint=7),
        the(found, "rotor_inertia", joint=1),
        the(found, "rotor_inertia", joint=2),
    )
    for candidate in hidden:
        assert not candidate.identifiable, candidate.effect.name
        assert candidate.absorbed_fraction == pytest.approx(1.0, abs=1e-9)
        assert candidate.smallest().value == np.inf
        assert candidate.space.shape[1] == 0


def test_absorbed_shares_stand_in_the_order_measured_for_this_kind_of_motion(found: tuple[Candidate, ...]) -> None:
    """Medians over joints as on other excitations of five harmonics: zero offset ≈ 99 %, ripple ≈ 1 %."""

    def median(name: str) -> float:
        return float(np.median([item.absorbed_fraction for item in found if item.effect.name == name]))

    assert median("joint_zero_offset") > 0.95
    assert 0.93 < median("nonlinear_viscous_friction") < 0.98
    assert median("torque_sensor_gain") > median("bending_crosstalk") > median("stribeck_friction")
    assert median("torque_ripple") < 0.05


def test_noise_raises_the_smallest_size_in_proportion_and_periods_lower_it_by_their_root(
    rows: PlannedRows, iiwa14_base: BaseRegressor, found: tuple[Candidate, ...]
) -> None:
    names = ("stribeck_friction", "base_tilt")
    effects = [effect_named(name) for name in names]
    louder = candidates([planned_rows(rows.motion, iiwa14_base, 2.0 * NOISE, periods=4)], effects)
    for name in names:
        before, after = (
            the(item, name, joint=3 if name == "stribeck_friction" else None).smallest().value
            for item in (found, louder)
        )
        assert after == pytest.approx(4.0 * before, rel=1e-6)


def test_a_second_motion_fitted_together_never_absorbs_more_strength(
    rows: PlannedRows, iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """λ of both is at least the sum of what each leaves by itself: one set of parameters serves both."""
    other = planned_rows(motion_of(iiwa14, table3, rate_hz=125.0, seed=4), iiwa14_base, NOISE, periods=16)
    names = ("joint_elasticity", "torque_offset", "torque_sensor_gain")
    effects = [effect_named(name) for name in names]
    alone, beside, together = (candidates(part, effects) for part in ([rows], [other], [rows, other]))
    for name in names:
        strength = [float(the(item, name, joint=2).strength[0, 0]) for item in (alone, beside, together)]
        assert strength[2] >= strength[0] + strength[1] - 1e-6 * strength[2]


def test_known_equals_are_found_among_the_candidates(found: tuple[Candidate, ...]) -> None:
    offset, cable = (the(found, name, joint=3) for name in ("torque_offset", "cable_spring"))
    assert relation(offset.space, cable.space).kind == "first_in_second"
    # Joint 2's axis lies across joint 1's, through the same point: its torque is a moment that bends joint 1.
    crosstalk, bending = the(found, "joint_crosstalk", joint=1), the(found, "bending_crosstalk", joint=1)
    assert relation(crosstalk.space, bending.space).kind == "first_in_second"
    assert relation(offset.space, the(found, "torque_offset", joint=4).space).cosine < 0.5


def test_confusable_pairs_are_listed_from_the_closest(found: tuple[Candidate, ...]) -> None:
    pairs = confusable(found, 0.9)
    cosines = [pair.relation.cosine for pair in pairs]
    assert cosines == sorted(cosines, reverse=True)
    names = {frozenset((pair.first.effect.name, pair.second.effect.name)) for pair in pairs}
    assert frozenset(("torque_offset", "cable_spring")) in names
    assert frozenset(("bending_crosstalk", "torque_sensor_gain")) in names
