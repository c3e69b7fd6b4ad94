"""An angle that is off by a function of its joint's load or position. Truth: Pinocchio's torque at the true angles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.extended_model import extended_model
from identification.mismatch.findings import Diagnosis
from identification.mismatch.prediction import validate_with_effects
from identification.mismatch.prepared import prepare
from identification.mismatch.settings import SPEAK, DiagnosisSettings
from identification.mismatch.unknown.angle import AngleBasis
from identification.mismatch.unknown.angle_search import columns_of
from identification.mismatch.unknown.claims import AngleCurve
from identification.mismatch.unknown.dependence import find_dependence
from identification.mismatch.unknown.rows import build_rows
from identification.model_file import read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.report.class_section import class_section
from identification.report.document import Figure
from identification.robots import RobotModel
from tests.identification.mismatch.plant import NOISE_NM, PERIOD_S, SAMPLES, on_joint, record
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

FloatArray = npt.NDArray[np.float64]
OWN = 4
"""Joint whose angle is off."""


def runs_untrue(q: FloatArray, torque: FloatArray) -> FloatArray:
    """True minus measured angle of a gear with an error that comes three times a turn, rad."""
    del torque
    return np.asarray(2e-3 * np.sin(3.0 * q[:, OWN - 1] + 0.5))


def yields_at_first(q: FloatArray, torque: FloatArray) -> FloatArray:
    """That of a transmission with lost motion: it yields to a small load and hardly to more."""
    del q
    load = torque[:, OWN - 1]
    return np.asarray(-1e-3 * np.tanh(load / (0.2 * np.abs(load).max())))


def record_off(
    robot: RobotModel, parameters: PhysicalParameters, law: object, *, motion: int, periods: int, seed: int
) -> Recording:
    """A recording of which joint OWN's position is the motor's, and the link runs the motion."""
    random = np.random.default_rng(seed)
    q, dq, ddq = fourier_motion(robot.n, period_s=PERIOD_S, samples=SAMPLES, seed=motion)
    rigid = replace(parameters, viscous=0.0 * parameters.viscous, coulomb=0.0 * parameters.coulomb)
    torque = inverse_dynamics(robot, parameters, q, dq, ddq)
    assert callable(law)
    measured = q.copy()
    measured[:, OWN - 1] -= law(q, inverse_dynamics(robot, rigid, q, dq, ddq))
    noise = NOISE_NM * random.normal(size=(periods * SAMPLES, robot.n))
    return recording_of(
        np.tile(measured, (periods, 1)), np.tile(torque, (periods, 1)) + noise, period_s=PERIOD_S, periods=periods
    )


@pytest.fixture(scope="module")
def untrue(iiwa14: RobotModel, table3: PhysicalParameters) -> Diagnosis:
    fitted = record_off(iiwa14, table3, runs_untrue, motion=9, periods=8, seed=1)
    return diagnose([fitted], iiwa14, heldout=[record_off(iiwa14, table3, runs_untrue, motion=3, periods=4, seed=2)])


@pytest.mark.parametrize(("law", "name"), [(runs_untrue, "own_position"), (yields_at_first, "own_load")])
def test_an_angle_that_is_off_is_found_and_no_other_joint_has_a_class_for_it(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters, law: object, name: str
) -> None:
    settings = DiagnosisSettings()
    recordings = [
        record_off(iiwa14, table3, law, motion=motion, periods=periods, seed=seed)
        for motion, periods, seed in ((9, 8, 1), (3, 4, 2))
    ]
    fitted, unseen = (prepare([item], iiwa14, iiwa14_base, settings, None) for item in recordings)
    found = find_dependence(fitted, unseen)
    assert found.angles[0].angle == (name, OWN - 1)
    assert found.angles[0].loss > SPEAK
    assert {item.joint for item in found.held if item.loss >= SPEAK} <= {OWN - 1}
    assert found.every.without_angles().prior.size == build_rows(fitted, unseen).prior.size


def test_a_torque_of_a_joint_s_own_position_or_load_is_no_angle(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    def hump(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
        del dq, torque
        return on_joint(OWN, 0.3 / (1.0 + ((q[:, OWN - 1] - 0.1) / 0.3) ** 4))

    def dead_zone(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
        del q, dq
        load = torque[:, OWN - 1]
        return on_joint(OWN, -0.05 * np.clip(load, -0.3 * np.abs(load).max(), 0.3 * np.abs(load).max()))

    settings = DiagnosisSettings()
    for hidden in (hump, dead_zone):
        recordings = record(iiwa14, table3, hidden, motion=9), record(iiwa14, table3, hidden, periods=4, seed=2)
        found = find_dependence(*(prepare([item], iiwa14, iiwa14_base, settings, None) for item in recordings))
        assert found.held
        assert not found.angles


def test_columns_of_an_angle_are_the_torque_of_a_small_displacement(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """Truth: Pinocchio's torque at angles that a smooth function of the position displaces, less that at the others."""
    fitted = prepare([record(iiwa14, table3, periods=4)], iiwa14, iiwa14_base, DiagnosisSettings(), None)
    rows = build_rows(fitted, None)
    basis = AngleBasis.of("own_position", 0, OWN - 1, rows.inputs)
    assert basis is not None
    own = np.eye(7)[OWN - 1]
    q, dq, ddq = fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=3)
    half = 0.5 * np.ptp(q[:, OWN - 1])
    # Its first function is straight: a share of the half range.
    size = 1e-5 * basis.scale / half
    middle = q[:, OWN - 1].mean()
    moved = (q + size * np.outer(q[:, OWN - 1] - middle, own), dq + size * dq * own, ddq + size * ddq * own)
    rigid = replace(table3, viscous=0.0 * table3.viscous, coulomb=0.0 * table3.coulomb)
    change = (inverse_dynamics(iiwa14, rigid, *moved) - inverse_dynamics(iiwa14, rigid, q, dq, ddq)) / 1e-5
    truth = rows.evidences[0].project(change).T
    assert np.abs(columns_of(rows, basis)[..., 0] - truth).max() < 0.02 * np.abs(truth).max()


def test_the_curve_of_an_angle_is_in_radians_and_within_its_band(untrue: Diagnosis) -> None:
    (claim,) = (item for item in untrue.classes if item.angle)
    assert (claim.name, claim.joint, claim.named) == ("own_position", OWN, False)
    assert untrue.verdict == "unexplained"
    assert "its true angle is not the measured one" in claim.sentence
    assert set(claim.shows_on) >= {2, OWN}
    assert isinstance(claim.curve, AngleCurve)
    truth = 2e-3 * np.sin(3.0 * claim.curve.place + 0.5)
    assert np.mean(np.abs(truth - claim.curve.mean_rad) < 3.0 * claim.curve.std_rad) > 0.9
    section = class_section(untrue)
    assert section is not None
    (figure,) = (item for item in section.blocks if isinstance(item, Figure))
    assert "(rad)" in figure.panels[0].y_label


def test_an_angle_is_part_of_the_model_that_validate_reads(
    untrue: Diagnosis, iiwa14: RobotModel, table3: PhysicalParameters, tmp_path: Path
) -> None:
    fitted = record_off(iiwa14, table3, runs_untrue, motion=9, periods=8, seed=1)
    another = record_off(iiwa14, table3, runs_untrue, motion=3, periods=4, seed=5)
    data = extended_model(untrue, [fitted], iiwa14)
    assert {term["joint"] for term in data["class_terms"]["terms"] if term.get("angle")} == {OWN}
    write_model(data, tmp_path / "with.json")
    write_model({name: value for name, value in data.items() if name != "class_terms"}, tmp_path / "without.json")
    left, without = (
        validate_with_effects(read_model(tmp_path / name), [another]).rows[0].rms_nm
        for name in ("with.json", "without.json")
    )
    noise = NOISE_NM / 2.0
    assert np.sum(left**2 - noise**2) < 0.3 * np.sum(without**2 - noise**2)


def test_a_straight_spring_keeps_its_name(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """Functions of the load hold it as a special case."""

    def spring(q: FloatArray, torque: FloatArray) -> FloatArray:
        del q
        return np.asarray(-1e-4 * torque[:, OWN - 1])

    recordings = [
        record_off(iiwa14, table3, spring, motion=motion, periods=periods, seed=seed)
        for motion, periods, seed in ((9, 8, 1), (3, 4, 2))
    ]
    found = diagnose(recordings[:1], iiwa14, heldout=recordings[1:])
    assert [(item.effect, item.place.joint) for item in found.findings] == [("joint_elasticity", OWN)]
    assert all(item.named for item in found.classes)
