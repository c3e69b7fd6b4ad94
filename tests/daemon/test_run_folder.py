"""Claims about the run's folder before anything is started: what is written into it and what is refused."""

from __future__ import annotations

from pathlib import Path

import pinocchio

from daemon.log.cdr import JOINT_NAMES
from daemon.run_folder import prepare_folder

from .producer import make_request


def test_a_built_in_arm_gets_a_urdf_whose_joints_are_those_of_joint_states(tmp_path: Path) -> None:
    """So that a viewer moves the arm of /robot_description by /joint_states; Pinocchio reads it."""
    request = make_request(tmp_path / "in", out_dir=str(tmp_path / "run"))
    prepare_folder(request)
    model = pinocchio.buildModelFromUrdf(str(tmp_path / "run" / "robot.urdf"))
    assert tuple(model.names)[1:] == JOINT_NAMES


def test_a_urdf_of_the_operators_own_is_copied_and_not_replaced(tmp_path: Path) -> None:
    own = tmp_path / "mine.urdf"
    own.write_text("<robot name='mine'/>")
    resolved = prepare_folder(make_request(tmp_path / "in", out_dir=str(tmp_path / "run"), urdf_file=str(own)))
    assert resolved.urdf_file == str(tmp_path / "run" / "mine.urdf")
    assert not (tmp_path / "run" / "robot.urdf").exists()
