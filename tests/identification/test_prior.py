"""Claims about directions that the data leave open: they go to bodies that exist, and what is determined stays.

Truth: closed forms (the divergence is least, and zero, at the prior itself), the paper's Table 3 and Table 2, and
torques by Pinocchio of the numbers themselves.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import ModelFileError, RobotError
from identification.estimators.prior import BodyPrior, _Program, prior_of_bodies, settle_open_directions, uniform_bodies
from identification.excitation import default_trajectory
from identification.export.given_bodies import given_bodies
from identification.export.parameters import Origins
from identification.export.write import export_model
from identification.model_file import read_model
from identification.physical_parameters import PhysicalParameters, pseudo_inertia
from identification.robots import RobotModel, load_robot
from tests.identification.exported import consistent, model_of, random_arm, random_bodies
from tests.identification.synthetic import inverse_dynamics


def covariance_of(values: np.ndarray, share: float) -> np.ndarray:
    return np.diag((share * np.maximum(np.abs(values), 1e-2)) ** 2)


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_is_its_own_prior_comes_back(seed: int, tmp_path: Path) -> None:
    """Both terms are smallest at the truth, so it is the minimum whatever they weigh."""
    file = tmp_path / "arm.urdf"
    file.write_text(random_arm(4, seed))
    robot, truth = load_robot(file), random_bodies(4, seed)
    base = BaseRegressor(robot)
    values = base.base_from_physical(truth)
    prior = BodyPrior(truth.pseudo_inertia(), "truth")
    settled = settle_open_directions(values, covariance_of(values, 0.1), base, prior)
    assert settled.physical.mass == pytest.approx(truth.mass, rel=1e-4)
    assert np.abs(settled.physical.pseudo_inertia() - truth.pseudo_inertia()).max() < 1e-4


def test_without_data_the_bodies_of_the_prior_are_what_is_left(iiwa14: RobotModel) -> None:
    base, prior = BaseRegressor(iiwa14), uniform_bodies(iiwa14.kinematics)
    values = np.ones(base.size)
    settled = settle_open_directions(values, 1e12 * np.eye(base.size), base, prior)
    assert settled.physical.pseudo_inertia() == pytest.approx(prior.bodies, rel=1e-3, abs=1e-6)
    assert settled.from_data.reshape(7, -1)[:, :10].max() < 1e-6


def test_what_the_data_determine_stays_and_open_directions_are_bodies_of_a_links_size(
    iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    truth = consistent(table3)
    values = iiwa14_base.base_from_physical(truth)
    settled = settle_open_directions(values, covariance_of(values, 1e-3), iiwa14_base)
    motion = default_trajectory()
    states = motion.evaluate(np.linspace(0.0, motion.period_s, 200, endpoint=False))
    robot = iiwa14_base.robot
    difference = inverse_dynamics(robot, settled.physical, *states) - inverse_dynamics(robot, truth, *states)
    assert np.sqrt(np.mean(difference**2, axis=0)).max() < 5e-3
    assert np.linalg.eigvalsh(settled.physical.pseudo_inertia()).min() > 0.0
    gyration = np.sqrt(np.linalg.eigvalsh(settled.physical.inertia).max(axis=1) / settled.physical.mass)
    assert gyration.max() < 0.25
    assert settled.physical.mass.sum() < 40.0  # KUKA states 30 kg


def test_a_covariance_that_round_off_made_indefinite_is_no_end(
    iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """As of a motion in which two joints go alike: one direction has next to no information, and its square is lost."""
    values = iiwa14_base.base_from_physical(table3)
    direction = np.ones(len(values)) / np.sqrt(len(values))
    correlation = np.eye(len(values)) - (1.0 + 1e-9) * np.outer(direction, direction)
    assert np.linalg.eigvalsh(correlation)[0] < 0.0
    std = 0.1 * np.abs(values) + 0.01
    settled = settle_open_directions(values, correlation * np.outer(std, std), iiwa14_base)
    assert np.isfinite(settled.base_values).all()
    assert settled.misfit < 1.0


def test_an_offset_is_as_large_as_the_friction_of_its_joint(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """An arm of a tonne has offsets of tens of Nm, like its Coulomb friction: what is known of one stays."""
    base = BaseRegressor(iiwa14, RegressorOptions(offset=True))
    offset = np.array([46.0, -80.0, 30.0, 12.0, 5.0, -3.0, 2.0])
    full = 300.0 * base.full_from_physical(table3).reshape(7, -1)
    full[:, -1] = offset
    values = base.base_from_full(full.ravel())
    std = 0.05 * np.abs(values) + 1e-3
    std[[base.position_of(f"OFF_{joint}") for joint in range(1, 8)]] = 0.2 * np.abs(offset)
    settled = settle_open_directions(values, np.diag(std**2), base)
    moved = settled.moved[[base.position_of(f"OFF_{joint}") for joint in range(1, 8)]]
    assert np.abs(moved).max() < 0.5
    alone = np.zeros(len(base.full_names), dtype=np.bool_)
    sentence = " ".join(Origins(base.full_names, replace(settled, misfit=2.0), alone, base.names).sentences())
    assert f"most of all {base.names[int(np.argmax(np.abs(settled.moved)))]} by" in sentence


def test_each_parameter_says_whether_data_or_prior_determine_it(
    iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    values = iiwa14_base.base_from_physical(consistent(table3))
    settled = settle_open_directions(values, covariance_of(values, 1e-3), iiwa14_base)
    share = dict(zip(iiwa14_base.full_names, settled.from_data, strict=True))
    # No torque depends on these: joint 1 turns about the vertical.
    assert max(share[f"{symbol}_1"] for symbol in ("M", "MX", "MY", "MZ", "XX", "XY", "YY")) < 0.01
    # These are base parameters of their own.
    assert min(share[name] for name in ("MX_7", "MY_7", "XY_7", "FV_3", "FS_1")) > 0.99
    # A sum of several: known as a sum only.
    assert 0.05 < share["M_4"] < 0.99


def test_base_parameters_of_no_robot_end_at_one_that_exists(
    iiwa14_base: BaseRegressor, table2: dict[str, float]
) -> None:
    """Table 2 has ZZR_1 < 0, which no body can have."""
    values = np.array([table2[name] for name in iiwa14_base.names])
    settled = settle_open_directions(values, covariance_of(values, 0.02), iiwa14_base)
    assert settled.misfit > 1.0
    moments = np.linalg.eigvalsh(settled.physical.inertia)
    assert (moments[:, 0] + moments[:, 1] - moments[:, 2]).min() > 0.0
    assert settled.base_values[iiwa14_base.names.index("ZZR_1")] > 0.0


def test_a_description_with_impossible_inertias_is_mended_just_enough(iiwa14: RobotModel) -> None:
    good = consistent_bodies = pseudo_inertia(np.array([[2.0, 0.1, 0.0, 0.2, 0.1, 0.0, 0.0, 0.1, 0.0, 0.05]] * 7))
    inertial = np.array([[2.0, 0.1, 0.0, 0.2, 0.1, 0.0, 0.0, 0.1, 0.0, 0.05]] * 7)
    assert np.abs(prior_of_bodies(inertial, iiwa14.kinematics, "").bodies - consistent_bodies).max() < 1e-12
    inertial[2, 4:] = inertial[5] = 0.0  # a point away from the axis with no inertia about it; no mass at all
    mended = prior_of_bodies(inertial, iiwa14.kinematics, "").bodies
    assert np.linalg.eigvalsh(mended).min() > 0.0
    assert np.abs(mended[[0, 1, 3, 4, 6]] - good[[0, 1, 3, 4, 6]]).max() < 1e-12


def test_bodies_of_a_urdf_are_found_in_the_identified_robots_frames(tmp_path: Path, table3: PhysicalParameters) -> None:
    """The file has its base on the floor; the table of the paper measures from the shoulder."""
    physical, robot = consistent(table3), load_robot("iiwa14")
    file = tmp_path / "arm.urdf"
    export_model(model_of(tmp_path, "iiwa14", physical), file, "urdf", parameter_set="physical")
    assert np.abs(given_bodies(file, robot).bodies - physical.pseudo_inertia()).max() < 1e-9
    elsewhere = file.read_text().replace('xyz="0.0 -0.42', 'xyz="0.0 -0.45').replace('xyz="0.0 0.42', 'xyz="0.0 0.45')
    assert elsewhere != file.read_text()
    file.write_text(elsewhere)
    with pytest.raises(RobotError, match=r"joint \d stands elsewhere"):
        given_bodies(file, robot)


def test_a_prior_with_a_gripper_adds_it_to_the_link_that_carries_it(tmp_path: Path) -> None:
    arm = random_arm(3, 2)
    finger = (
        '<link name="finger"><inertial><origin xyz="0 0 0.1"/><mass value="0.5"/><inertia ixx="1e-3" ixy="0" ixz="0" '
        'iyy="1e-3" iyz="0" izz="1e-3"/></inertial></link><joint name="grip" type="prismatic"><parent link="tool"/>'
        '<child link="finger"/><axis xyz="0 1 0"/><limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>'
        "</robot>"
    )
    (tmp_path / "arm.urdf").write_text(arm)
    (tmp_path / "with_gripper.urdf").write_text(arm.replace("</robot>", finger))
    robot = load_robot(tmp_path / "arm.urdf")
    plain, gripping = (given_bodies(tmp_path / name, robot).bodies for name in ("arm.urdf", "with_gripper.urdf"))
    assert gripping[2, 3, 3] - plain[2, 3, 3] == pytest.approx(0.5)


def test_a_prior_of_negative_mass_is_refused_with_the_joint(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(random_arm(3, 2))
    robot = load_robot(file)
    file.write_text(file.read_text().replace('<mass value="9"/>', '<mass value="-2"/>'))
    with pytest.raises(RobotError, match=r"joint \d moves has a mass of -2 kg"):
        given_bodies(file, robot)


def test_a_covariance_in_the_file_is_read_in_the_order_of_the_regressor(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(random_arm(2, 1))
    base = BaseRegressor(load_robot(file))
    root = np.random.default_rng(4).normal(size=(base.size, base.size))
    covariance = root @ root.T + np.eye(base.size)
    rows = [row[: place + 1].tolist() for place, row in enumerate(covariance)]
    physical = random_bodies(2, 1)
    model = model_of(tmp_path, str(file), physical, base_covariance=rows)
    assert np.array_equal(model.base_covariance(base), covariance)
    data = json.loads((tmp_path / "model.json").read_text())
    data["base_parameters"].reverse()
    (tmp_path / "model.json").write_text(json.dumps(data))
    turned = read_model(tmp_path / "model.json").base_covariance(base)
    assert np.array_equal(turned, covariance[::-1, ::-1])
    broken = model_of(tmp_path, str(file), physical, base_covariance=rows[:-1])
    with pytest.raises(ModelFileError, match="base_covariance"):
        broken.base_covariance(base)


@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-6])
def test_exact_data_are_kept_to_their_digits(iiwa14: RobotModel, table3: PhysicalParameters, noise: float) -> None:
    """Weighed a million million times against the prior: the program ended in a numerical error."""
    base = BaseRegressor(iiwa14)
    truth = base.base_from_physical(table3)
    covariance = np.diag((noise * np.maximum(np.abs(truth), 1e-2)) ** 2 + 1e-30)
    settled = settle_open_directions(truth, covariance, base)
    np.testing.assert_allclose(settled.base_values, truth, atol=1e-6)
    assert np.linalg.eigvalsh(pseudo_inertia(settled.full.reshape(7, -1)[:, :10])).min() > 0.0


def test_a_body_that_is_all_but_flat_has_a_curvature() -> None:
    """Of log det of symmetric (4, 4) matrices the Hessian has the determinant det(P)^−5 times that at P = 1."""
    random, basis = np.random.default_rng(3), pseudo_inertia(np.eye(10)).reshape(10, 16).T
    turn = np.linalg.qr(random.normal(size=(4, 4)))[0]
    moments = np.array([1e-12, 1e-7, 0.1, 5.0])
    logarithms = []
    for matrix in (np.eye(4), turn @ np.diag(moments) @ turn.T):
        inertial = np.linalg.lstsq(basis, matrix.ravel(), rcond=None)[0]
        empty = np.zeros((1, 0))
        program = SimpleNamespace(_stride=10, _free=empty.astype(bool), _typical=empty)
        root = _Program._prior_curvature(program, inertial[None])  # type: ignore[arg-type]
        logarithms.append(2.0 * np.log(np.abs(np.diag(root))).sum())
    assert logarithms[1] - logarithms[0] == pytest.approx(-5.0 * np.log(moments).sum(), rel=1e-3)
