"""One torque of a SCARA with the wrong sign, beside its MJCF.

Truth: the closed form, with rotors, friction and noise.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from identification.audit import audit
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
