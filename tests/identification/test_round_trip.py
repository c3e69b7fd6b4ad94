"""Every option of a fit survives model.json: validated on the fitted rows, the file leaves what the fit said it leaves.

Truth: the fit's own table. The recording is a real one without periods, whose noise nobody measured (EMPS, published at
nonlinearbenchmark.org), and a simulated one with periods.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest

from identification.base_parameters import BaseRegressor
from identification.errors import ModelFileError
from identification.export.write import export_model
from identification.model_file import Model, read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import RobotModel, load_robot
from identification.robots.same_arm import difference_of_frames, frames_of
from identification.validation import validate_model
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

RECORDINGS = Path(__file__).parents[2] / "fixtures" / "recordings"
WITHOUT_PERIODS = (
    {},
    {"coulomb_velocity": 0.02},
    {"rotor_inertia": "yes"},
    {"rotor_inertia": "no"},
    {"offset": "yes"},
    {"offset": "no"},
    {"low_pass_hz": 12.0},
    {"delay_correction": "common"},
    {"delay_correction": "per_joint"},
    {"estimator": "ols"},
    {"estimator": "huber"},
    {"flip_torque": True, "check_torque_sign": False},
)
WITH_PERIODS = (
    {"pipeline": "paper"},
    {"pipeline": "aperiodic", "low_pass_hz": 8.0},
    {"coulomb_velocity": 0.02},
    {"delay_correction": "per_joint"},
    {"motion_bandwidth_hz": 4.0, "torque_bandwidth_hz": 12.0},
)


def _written(fit: FitResult, folder: Path) -> Model:
    return read_model(write_model(fit.to_model_json(notes=False), folder / "model.json"))


@pytest.mark.parametrize("options", WITHOUT_PERIODS, ids=str)
def test_an_option_of_a_fit_without_periods_is_kept(options: dict[str, Any], tmp_path: Path) -> None:
    recording, robot = read_recording(RECORDINGS / "emps_a.npz"), load_robot(RECORDINGS / "emps.urdf")
    fit = fit_recordings([recording], robot, FitSettings(physical=False, **options))
    left = validate_model(_written(fit, tmp_path), [recording], robot=robot).rows[0].rms_nm
    np.testing.assert_allclose(left, fit.rms.row("fit, base").rms_nm, rtol=1e-9)


@pytest.fixture(scope="module")
def periodic(iiwa14: RobotModel, table3: PhysicalParameters) -> Recording:
    """Four periods of a motion whose torque is 3 ms late."""
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=2000, seed=8)
    late = np.fft.irfft(
        np.fft.rfft(inverse_dynamics(iiwa14, table3, q, dq, ddq), axis=0)
        * np.exp(-2j * np.pi * np.fft.rfftfreq(2000, 5e-3) * 3e-3)[:, None],
        n=2000,
        axis=0,
    )
    noise = 0.05 * np.random.default_rng(8).normal(size=(8000, 7))
    return recording_of(np.tile(q, (4, 1)), np.tile(late, (4, 1)) + noise, period_s=10.0, periods=4)


@pytest.mark.parametrize("options", WITH_PERIODS, ids=str)
def test_an_option_of_a_fit_with_periods_is_kept(
    options: dict[str, Any], periodic: Recording, iiwa14: RobotModel, tmp_path: Path
) -> None:
    fit = fit_recordings([periodic], iiwa14, FitSettings(physical=False, **options))
    left = validate_model(_written(fit, tmp_path), [periodic]).rows[0].rms_nm
    np.testing.assert_allclose(left, fit.rms.row("fit, base").rms_nm, rtol=1e-9)


def test_the_width_of_friction_stands_beside_an_export_where_no_noise_was_measured(tmp_path: Path) -> None:
    recording, robot = read_recording(RECORDINGS / "emps_a.npz"), load_robot(RECORDINGS / "emps.urdf")
    fit = fit_recordings([recording], robot, FitSettings(coulomb_velocity=0.02))
    exported = export_model(_written(fit, tmp_path), tmp_path / "arm.urdf", "urdf")
    assert exported.effects_path is not None
    assert '"velocity": 0.02' in exported.effects_path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("stood", "stands", "said"),
    [
        ("1.15 0 -0.189", "1.10 0 -0.189", "joint 3 stands 50 mm elsewhere"),
        # The same axis in space, but another frame of link 6: what stands in it means something else.
        (
            'rpy="-1.570796327 -0 0" />\n    <parent link="link5"',
            'rpy="-1.570796327 -0 0.5" />\n    <parent link="link5"',
            "joint 6 is turned",
        ),
    ],
    ids=["moved", "turned"],
)
def test_a_robot_file_that_changed_since_the_fit_is_refused(stood: str, stands: str, said: str, tmp_path: Path) -> None:
    """Base parameters keep their names in other link frames, so nothing else noticed: only the torque was wrong."""
    text = (RECORDINGS / "kr300.urdf").read_text(encoding="utf-8")
    file = tmp_path / "arm.urdf"
    file.write_text(text, encoding="utf-8")
    recording = read_recording(RECORDINGS / "kr300_a.npz", robot=str(file))
    fit = fit_recordings([recording], load_robot(file), FitSettings(physical=False))
    model = _written(fit, tmp_path)
    assert model.load_robot().n == 6
    file.write_text(text.replace("</robot>", "<!-- a comment --></robot>"), encoding="utf-8")
    assert model.load_robot().n == 6
    assert stood in text
    file.write_text(text.replace(stood, stands), encoding="utf-8")
    with pytest.raises(ModelFileError, match=said):
        model.load_robot()
    with pytest.raises(ModelFileError, match=said):
        model.base_values(BaseRegressor(load_robot(file), model.options))


@pytest.mark.parametrize(
    ("base", "said"),
    [("0 0 0", ""), ("0 0 1.57", ""), ("0.3 0 0", "joint 1 is turned")],
    ids=["on_a_pedestal", "turned_about_gravity", "leaning"],
)
def test_where_the_base_stands_in_the_robots_file_changes_no_link_frame(base: str, said: str, tmp_path: Path) -> None:
    """The same arm on a pedestal, or in a cell's frame, was refused: 'joint 1 stands 500 mm elsewhere'."""
    text = (RECORDINGS / "kr300.urdf").read_text(encoding="utf-8")
    (root,) = {
        link.get("name")
        for link in ElementTree.fromstring(text).findall("link")
        if link.get("name") not in {child.get("link") for child in ElementTree.fromstring(text).iter("child")}
    }
    cell = (
        f'<link name="cell"/><joint name="stand" type="fixed"><parent link="cell"/><child link="{root}"/>'
        f'<origin xyz="0.2 0 0.5" rpy="{base}"/></joint></robot>'
    )
    (tmp_path / "cell.urdf").write_text(text.replace("</robot>", cell), encoding="utf-8")
    alone, stands = load_robot(RECORDINGS / "kr300.urdf"), load_robot(tmp_path / "cell.urdf")
    assert stands.n == alone.n
    difference = difference_of_frames(frames_of(alone), stands)
    assert difference.endswith(said)
    assert bool(difference) == bool(said)


def test_a_model_says_in_which_frame_gravity_is_given(periodic: Recording, iiwa14: RobotModel, tmp_path: Path) -> None:
    """A positive turn of joint 2 leans the arm towards +x of base_link, which is −x of the paper's base."""
    recording, robot = read_recording(RECORDINGS / "emps_a.npz"), load_robot(RECORDINGS / "emps.urdf")
    said = [
        _written(fit_recordings([item], arm, FitSettings(physical=False)), tmp_path).data["provenance"]["robot"]
        for item, arm in ((periodic, iiwa14), (recording, robot))
    ]
    assert [item["gravity_m_s2"] for item in said] == [[0.0, 0.0, -9.81]] * 2
    assert "turned by 180° about z" in said[0]["gravity_frame"]
    assert said[1]["gravity_frame"] == "base frame of the robot's file"
    model, data = iiwa14.pinocchio_model, iiwa14.pinocchio_model.createData()
    pinocchio.forwardKinematics(model, data, np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert data.oMi[7].translation[0] < -0.3
