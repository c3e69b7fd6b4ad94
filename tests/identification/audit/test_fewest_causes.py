"""A SCARA beside its MJCF: one torque with the wrong sign, and what is said of its sliding joint.

Truth: the closed form, with rotors, friction and noise; the units of a force and of what slides.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.audit import audit
from identification.audit.columns import Geometry, SetUp
from identification.audit.foretold import lacking_friction
from identification.audit.hypotheses import Hypothesis, Layout
from identification.audit.numbers import Found
from identification.audit.rows import rows_of
from identification.audit.sentences import difference_of
from identification.audit.shown import Step
from identification.physical_parameters import PhysicalParameters
from identification.robots import load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

KINDS = ("revolute", "revolute", "prismatic", "revolute")
PLACES = ("0 0 0.3", "0.325 0 0.02", "0.275 0 -0.02", "0 0 -0.1")
MASS, ROTORS = np.array([6.0, 4.2, 1.3, 0.4]), np.array([0.5, 0.25, 1.5, 0.012])
CENTER = np.array([[0.16, 0.0, 0.01], [0.1, 0.0, 0.05], [0.0, 0.0, -0.05], [0.01, 0.004, -0.02]])
MOMENTS = np.array([[0.02, 0.09, 0.1], [0.02, 0.05, 0.05], [0.004, 0.004, 0.0005], [0.0006, 0.0006, 0.0004]])
PLANT = PhysicalParameters(
    MASS, CENTER, np.array([np.diag(each) for each in MOMENTS]),
    np.array([2.0, 1.0, 15.0, 0.06]), np.array([3.0, 2.0, 8.0, 0.12]),
)  # fmt: skip


def write_arm(folder: Path) -> tuple[Path, Path]:
    """URDF and MJCF of the same arm."""
    urdf, mjcf = '<robot name="scara"><link name="l0"/>', '<mujoco><compiler angle="radian"/><worldbody>'
    for k, (kind, place) in enumerate(zip(KINDS, PLACES, strict=True)):
        urdf += (
            f'<link name="l{k + 1}"/><joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="{place}"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="100" velocity="4"/></joint>'
        )
        center, moments = (" ".join(map(str, values)) for values in (CENTER[k], MOMENTS[k]))
        mjcf += (
            f'<body name="l{k}" pos="{place}"><joint name="j{k}" type="{"slide" if kind == "prismatic" else "hinge"}" '
            f'axis="0 0 1" armature="{ROTORS[k]}"/><inertial pos="{center}" mass="{MASS[k]}" diaginertia="{moments}"/>'
        )
    (folder / "scara.urdf").write_text(f"{urdf}</robot>")
    (folder / "scara.xml").write_text(f"{mjcf}{4 * '</body>'}</worldbody></mujoco>")
    return folder / "scara.urdf", folder / "scara.xml"


def test_one_wrong_sign_is_not_told_as_all_of_them_and_three_other_bodies(tmp_path: Path) -> None:
    """The two left as much, and the recording by itself showed which: it had to be clearly likelier, though it needs
    fewer causes.
    """
    urdf, mjcf = write_arm(tmp_path)
    robot = load_robot(urdf)
    q, dq, ddq = fourier_motion(4, period_s=20.0, samples=4000, seed=3)
    torque = inverse_dynamics(robot, PLANT, q, dq, ddq) + ROTORS * ddq
    torque += 0.02 * torque.std(axis=0) * np.random.default_rng(3).standard_normal(torque.shape)
    found = audit([recording_of(q, torque * np.array([1.0, 1.0, 1.0, -1.0]), period_s=20.0)], robot, mjcf)
    assert [(item.effect, item.joints) for item in found.differences] == [("inverted_torque_sign", (4,))]


@pytest.mark.parametrize(
    ("effect", "symbols", "unit", "said"),
    [
        ("friction_change", ("FV", "FS"), "N s/m", "by viscous +2.00 ± 0.20 N s/m, coulomb +2.00 ± 0.20 N:"),
        ("torque_offset", ("OFF",), "N", "Joint 3 has a constant force of 2.00 ± 0.20 N besides:"),
        ("rotor_inertia", ("IA",), "kg", "The rotor inertia of joint 3 is larger by 2.00 ± 0.20 kg:"),
        ("joint_zero_offset", ("OFF",), "m", "its true position is 2.00 ± 0.20 m larger:"),
    ],
)
def test_a_sliding_joint_differs_in_its_own_units(
    effect: str, symbols: tuple[str, ...], unit: str, said: str, tmp_path: Path
) -> None:
    """`compare` said Nm s/rad of it, and so did the numbers of `diagnosis.json`."""
    robot = load_robot(write_arm(tmp_path)[0])
    columns = np.array([Layout(robot.n).parameter(2, symbol) for symbol in symbols])
    what = Hypothesis(effect, columns, np.ones(len(columns)), 0.0, joint=2)
    found = Found(what, np.full(len(columns), 2.0), 0.01 * np.eye(len(columns)), 0.0)
    stand = SetUp.of(robot)
    told = difference_of(Step(what, 9.0, 0.8), found, stand, stand, "arm.json", robot)
    assert told.numbers[0].unit == unit
    assert said in told.sentence


def test_friction_that_a_file_lacks_on_a_sliding_joint_is_a_force(tmp_path: Path) -> None:
    robot = load_robot(write_arm(tmp_path)[0])
    q, dq, ddq = fourier_motion(4, period_s=20.0, samples=2000, seed=3)
    rows = rows_of([recording_of(q, inverse_dynamics(robot, PLANT, q, dq, ddq), period_s=20.0)])
    lacks, none = PLANT.viscous * rows.velocity + PLANT.coulomb * rows.direction, np.zeros(robot.n)
    found = lacking_friction(Geometry(robot, rows), lacks, none, none, "scara.xml")
    assert [item.numbers[1].value for item in found] == pytest.approx(PLANT.coulomb, rel=1e-3)
    units = [tuple(number.unit for number in item.numbers) for item in found]
    assert units == [("N s/m", "N", "N") if kind == "prismatic" else ("Nm s/rad", "Nm", "Nm") for kind in KINDS]
