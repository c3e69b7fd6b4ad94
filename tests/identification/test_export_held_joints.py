"""Claims about exported arms with joints that were held: they stand where they stood, and the file is read back.

Truth: Pinocchio's forward kinematics of the robot's own file, every joint where it is told to be.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio
import pytest

from identification.export.write import export_model
from identification.robots import Installation, load_robot
from tests.identification.exported import model_of, random_bodies
from tests.identification.test_installation import ARM

POSITIONS = {"a": 0.7, "b": 0.5, "c": -0.4, "finger": 0.3, "thumb": -0.6}
"""The thumb follows the finger by -2; b is held in the middle of the chain."""


def pose_of(model: pinocchio.Model, link: str) -> np.ndarray:
    data, q = model.createData(), pinocchio.neutral(model)
    for joint in range(1, model.njoints):
        q[model.joints[joint].idx_q] = POSITIONS[model.names[joint]]
    pinocchio.framesForwardKinematics(model, data, q)
    return np.asarray(data.oMf[model.getFrameId(link)].homogeneous)


@pytest.mark.parametrize("form", ["urdf", "sdf", "mjcf"])
def test_held_joints_are_fixed_where_they_stood(form: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    held = {name: POSITIONS[name] for name in ("b", "finger")}
    stand = Installation(locked_joints=tuple(held.items()))
    robot = load_robot(file, stand)
    assert robot.joint_names == ("a", "c")
    model = model_of(tmp_path, str(file), random_bodies(2, 3), installation=stand)
    result = export_model(model, tmp_path / f"out.{form}", form, parameter_set="physical")
    assert len(result.agreements) >= 1
    if form == "urdf":
        text = (tmp_path / "out.urdf").read_text()
        free = ARM.replace('<mimic joint="finger" multiplier="-2"/>', "")
        for link in ("lower", "hand", "left", "right"):
            exported, whole = (pose_of(pinocchio.buildModelFromXML(each), link) for each in (text, free))
            np.testing.assert_allclose(exported, whole, atol=1e-12)
