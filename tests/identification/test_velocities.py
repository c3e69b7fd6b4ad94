"""Claims about velocities that were recorded beside the positions. Truth: the derivatives of a closed-form motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.physics import iiwa14_table_three
from identification.mismatch.set_up import examine_set_up
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording, read_recording, write_recording
from identification.robots import RobotModel, load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics
from tests.reference import recording_file

PERIODS, SAMPLES, PERIOD_S = 2, 1000, 10.0
EXCHANGED = [0, 3, 2, 1, 4, 5, 6]


@pytest.fixture(scope="module")
def columns() -> dict[str, Any]:
    """Two periods of the paper's arm with noise in torque and velocity."""
    links = iiwa14_table_three()
    physical = PhysicalParameters(links.mass, links.center_of_mass, links.inertia, links.viscous, links.coulomb)
    states = fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=7)
    torque = inverse_dynamics(load_robot("iiwa14"), physical, *states)
    generator = np.random.default_rng(7)
    position, velocity, torque = (np.tile(values, (PERIODS, 1)) for values in (states[0], states[1], torque))
    velocity += 0.01 * generator.standard_normal(velocity.shape)
    torque += 0.05 * generator.standard_normal(torque.shape)
    return {"t": np.arange(len(position)) * PERIOD_S / SAMPLES, "q": position, "dq": velocity, "tau": torque,
            "period_s": PERIOD_S, "robot": "iiwa14"}  # fmt: skip


def read(folder: Path, columns: dict[str, Any], **changed: Any) -> Recording:
    np.savez(folder / "a.npz", **{**columns, **changed})
    return read_recording(folder / "a.npz")


def of_order(recording: Recording) -> list[tuple[int | None, str]]:
    return [(item.joint, item.sentence) for item in recording.report.of_kind("wrong_joint_order")]


def test_velocities_under_other_joints_are_said_once_of_each(tmp_path: Path, columns: dict[str, Any]) -> None:
    """And an import that is read again does not say it twice."""
    recording = read(tmp_path, columns, dq=columns["dq"][:, EXCHANGED])
    again = read_recording(write_recording(recording, tmp_path / "a.mcap"))
    for each in (recording, again):
        (second, of_fourth), (fourth, of_second) = of_order(each)
        assert (second, fourth) == (2, 4)
        assert "derivative of joint 4's position" in of_fourth
        assert "derivative of joint 2's position" in of_second
    assert of_order(read(tmp_path, columns, q=columns["q"][:, EXCHANGED])) == of_order(recording)


@pytest.mark.parametrize("file", ["kr300_a.npz", "kr300_b.npz", "ur10.npz"])
def test_velocities_of_real_arms_go_with_their_positions(file: str) -> None:
    recording = read_recording(recording_file(file))
    assert recording.velocity is not None
    assert not recording.report.of_kind("wrong_joint_order")
    assert not [item for item in recording.report.findings if "velocity" in item.sentence]


def test_a_velocity_of_no_motion_is_said_and_one_that_was_not_recorded_is_not(
    tmp_path: Path, columns: dict[str, Any]
) -> None:
    other = columns["dq"].copy()
    other[:, 2] = np.random.default_rng(1).standard_normal(len(other))
    (finding,) = read(tmp_path, columns, dq=other).report.findings
    assert finding.sentence.startswith("joint 3: the recorded velocity is the derivative of no position")
    other[:, 2] = np.nan
    assert read(tmp_path, columns, dq=other).report.findings == ()
    assert read(tmp_path, columns).report.findings == ()


def test_the_examination_of_a_log_says_what_is_wrong_with_its_velocities(
    tmp_path: Path, columns: dict[str, Any], iiwa14: RobotModel
) -> None:
    turned = columns["dq"] * np.where(np.arange(7) == 2, -1.0, 1.0)
    cases = {"order of joints": columns["dq"][:, EXCHANGED], "units": turned}
    for name, velocity in cases.items():
        checks = {item.name: item for item in examine_set_up([read(tmp_path, columns, dq=velocity)], iiwa14)}
        assert [item.name for item in checks.values() if item.status != "ok"] == [name]
        assert checks[name].status == "warning"
        assert "the recorded velocity is" in checks[name].sentence
