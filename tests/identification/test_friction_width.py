"""How gently friction turns over where no period repeats. Truth: tanh(q̇/v) written down here, beside Pinocchio."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from identification.mismatch.diagnosis import diagnose
from identification.model_file import read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import RobotModel, load_robot
from tests.identification.synthetic import inverse_dynamics

FloatArray = npt.NDArray[np.float64]

RATE_HZ, DURATION_S = 200.0, 40.0
BASE_ONLY = FitSettings(physical=False)

# A body that turns about an upright axis and a carriage that slides along it.
CARRIAGE = """<robot name="carriage"><link name="base"/>
<link name="column"><inertial><mass value="5"/><inertia ixx="1" iyy="1" izz="0.5" ixy="0" ixz="0" iyz="0"/></inertial>
</link><link name="sled"><inertial><mass value="3"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="column"/><axis xyz="0 0 1"/></joint>
<joint name="lift" type="prismatic"><parent link="column"/><child link="sled"/><axis xyz="0 0 1"/>
<limit lower="-9" upper="9" velocity="9" effort="900"/></joint></robot>"""


def motion(joints: int, seed: int, speed: float = 0.4) -> tuple[FloatArray, FloatArray, FloatArray]:
    """q, q̇, q̈ (S, n) of eight waves a joint below 0.5 Hz: nothing repeats. speed: rms rad/s (m/s) about."""
    random = np.random.default_rng(seed)
    clock = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
    turning = 2.0 * np.pi * random.uniform(0.05, 0.5, (8, joints))
    size, angle = random.normal(size=(8, joints)) * speed / (2.0 * turning), clock[:, None, None] * turning
    waves = size * np.sin(angle), size * turning * np.cos(angle), -size * turning**2 * np.sin(angle)
    q, dq, ddq = (wave.sum(axis=1) for wave in waves)
    return q, dq, ddq


def recorded(folder: Path, robot: str, q: FloatArray, torque: FloatArray, seed: int) -> Recording:
    noise = 0.02 * np.random.default_rng(seed).standard_normal(torque.shape)
    file = folder / f"{seed}.npz"
    np.savez(file, t=np.arange(len(q)) / RATE_HZ, q=q, tau=torque + noise, robot=robot)
    return read_recording(file)


def iiwa_with(widths: FloatArray, folder: Path, robot: RobotModel, table3: PhysicalParameters, seed: int) -> Recording:
    """Dry friction of each joint turns over between ± its width, rad/s; 0: sign(q̇)."""
    q, dq, ddq = motion(7, seed)
    gentle = np.where(widths > 0.0, np.tanh(dq / np.where(widths > 0.0, widths, 1.0)), np.sign(dq))
    torque = inverse_dynamics(robot, table3, q, dq, ddq) + table3.coulomb * (gentle - np.sign(dq))
    return recorded(folder, "iiwa14", q, torque, seed)


def test_a_width_that_all_joints_share_is_measured_and_nothing_is_called_missing(
    tmp_path: Path, iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """Fitted with sign(q̇), Coulomb friction is biased, and each joint seems to lack a torque of its own velocity."""
    fitted = iiwa_with(np.full(7, 0.02), tmp_path, iiwa14, table3, 1)
    found = fit_recordings([fitted], iiwa14, BASE_ONLY)
    assert found.regressor.options.coulomb_velocity == pytest.approx(0.02, rel=0.1)
    assert any(note.startswith("The friction of the whole arm turns over") for note in found.notes)
    friction = {name: value for name, value in zip(found.names, found.values, strict=True) if name.startswith("FS_")}
    np.testing.assert_allclose(list(friction.values()), table3.coulomb, rtol=0.02)
    diagnosis = diagnose([fitted], iiwa14)
    assert diagnosis.findings == ()
    assert not [item for item in diagnosis.classes if item.name == "own_velocity"]


@pytest.mark.parametrize(
    "widths",
    [np.zeros(7), np.where(np.arange(7) == 1, 0.03, 0.0), np.full(7, 0.6)],
    ids=["sign", "one joint", "a law of the velocity"],
)
def test_what_no_joint_or_one_alone_asks_for_is_not_taken(
    tmp_path: Path, iiwa14: RobotModel, table3: PhysicalParameters, widths: FloatArray
) -> None:
    found = fit_recordings([iiwa_with(widths, tmp_path, iiwa14, table3, 1)], iiwa14, BASE_ONLY)
    assert found.regressor.options.coulomb_velocity == 0.0


def carriage_fit(folder: Path) -> FitResult:
    """±20 mrad/s of the joint that turns, 2 Nm; ±4 mm/s of the one that slides, 6 N. It moves at 0.1 m/s."""
    (folder / "carriage.urdf").write_text(CARRIAGE)
    q, dq, ddq = motion(2, 3)
    q, dq, ddq = (part * (1.0, 0.25) for part in (q, dq, ddq))
    friction = np.tanh(dq / (0.02, 0.004)) * (2.0, 6.0) + dq * (0.5, 8.0)
    torque = ddq * (0.6, 3.0) + (0.0, 3.0 * 9.80665) + friction
    return fit_recordings(
        [recorded(folder, "carriage.urdf", q, torque, 3)], load_robot(folder / "carriage.urdf"), BASE_ONLY
    )


def test_joints_that_slide_have_a_width_of_their_own(tmp_path: Path) -> None:
    """0.02 rad/s says nothing of m/s; a lift that was given the width of the others was fitted several times worse."""
    found = carriage_fit(tmp_path)
    assert found.regressor.options.coulomb_velocity == pytest.approx((0.02, 0.004), rel=0.1)
    values = dict(zip(found.names, found.values, strict=True))
    assert (values["FS_1"], values["FS_2"]) == pytest.approx((2.0, 6.0), rel=0.02)
    (said,) = (note for note in found.notes if "turns over" in note)
    assert "mrad/s and ±" in said
    assert "mm/s" in said
    model = read_model(write_model(found.to_model_json(notes=False), tmp_path / "model.json"))
    assert model.options == found.regressor.options
