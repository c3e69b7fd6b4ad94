"""Files of others as models: what a reader passes over in silence is said, and no order of links matters.

Truth: torque of two links by hand, and the rules of the formats (each error is one that the file states).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.errors import RobotError
from identification.robots import load_robot
from identification.robots.simulator_models import read_simulator_model

INERTIAL = (
    '<inertial><origin xyz="0.5 0 0"/><mass value="2"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
URDF = f"""<robot name="two">
  <link name="base"/><link name="a">{INERTIAL}</link><link name="b">{INERTIAL}</link><link name="tool">{INERTIAL}</link>
  <joint name="q1" type="continuous"><axis xyz="0 1 0"/><parent link="base"/><child link="a"/></joint>
  <joint name="q2" type="continuous"><origin xyz="1 0 0"/><axis xyz="0 1 0"/>
    <parent link="a"/><child link="b"/></joint>
  <joint name="weld" type="fixed"><origin xyz="1 0 0"/><parent link="b"/><child link="tool"/></joint>
</robot>"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    file = tmp_path / "arm.urdf"
    file.write_text(URDF)
    return file


def weight(file: Path, arm: Path) -> np.ndarray:
    """(2,) Nm at zero, of a file as the model of `arm`."""
    regressor = BaseRegressor(load_robot(arm))
    still = np.zeros((1, 2))
    return (regressor.matrix(still, still, still).reshape(2, -1) @ read_simulator_model(file, regressor)).copy()


def test_weight_of_links_and_tool_is_that_by_hand(arm: Path) -> None:
    """Both axes are +y, all links along +x: lifting is turning back, by 2 kg at 0.5, 1.5 and 2.5 m."""
    assert np.allclose(weight(arm, arm), [-2.0 * 9.81 * (0.5 + 1.5 + 2.5), -2.0 * 9.81 * (0.5 + 1.5)], rtol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('<mass value="2"/>', '<mass value="${mass}"/>', r"mass .*not a float.*Link .tool."),
        ('<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>', "", "must have inertia element.*tool"),
        ("</robot>", '<xacro:hand xmlns:xacro="http://wiki.ros.org/xacro"/></robot>', "not expanded .<xacro:hand>"),
    ],
)
def test_a_body_that_urdf_readers_pass_over_is_no_model(old: str, new: str, said: str, arm: Path) -> None:
    """The tool is welded on: without its body the joint still has a mass, and a torque that is too small."""
    file = arm.with_name("other.urdf")
    before, found, after = URDF.rpartition(old)
    assert found
    file.write_text(before + new + after)
    with pytest.raises(RobotError, match=said) as caught:
        weight(file, arm)
    assert "other.urdf" in str(caught.value)


def test_masses_below_zero_on_all_links_are_no_model(arm: Path) -> None:
    file = arm.with_name("other.urdf")
    file.write_text(URDF.replace('value="2"', 'value="-2"'))
    with pytest.raises(RobotError, match="'q1' moves has a mass of -2 kg"):
        weight(file, arm)


SDF_LINK = (
    "<link name='{0}'><pose>{1} 0 0 0 0 0</pose><inertial><pose>0.5 0 0 0 0 0</pose><mass>2</mass><inertia>"
    "<ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial></link>"
)
SDF_JOINT = (
    "<joint name='{0}' type='revolute'><parent>{1}</parent><child>{2}</child><axis><xyz>0 1 0</xyz></axis></joint>"
)
LINKS = [SDF_LINK.format("base", 0), SDF_LINK.format("a", 0), SDF_LINK.format("b", 1)]
JOINTS = [SDF_JOINT.format("q1", "base", "a"), SDF_JOINT.format("q2", "a", "b")]


def test_the_base_of_an_sdf_is_the_link_that_hangs_on_none_wherever_it_stands(arm: Path) -> None:
    pytest.importorskip("pydrake")
    for links in (LINKS, LINKS[::-1]):
        file = arm.with_name("other.sdf")
        file.write_text(f"<sdf version='1.7'><model name='two'>{''.join(links + JOINTS)}</model></sdf>")
        assert np.allclose(weight(file, arm), [-2.0 * 9.81 * (0.5 + 1.5), -2.0 * 9.81 * 0.5], rtol=1e-9)


def test_an_sdf_of_several_models_says_so(arm: Path) -> None:
    pytest.importorskip("pydrake")
    table = "<model name='table'><static>true</static><link name='top'/></model>"
    file = arm.with_name("cell.sdf")
    file.write_text(
        f"<sdf version='1.7'><world name='w'><model name='two'>{''.join(LINKS + JOINTS)}</model>{table}</world></sdf>"
    )
    with pytest.raises(RobotError, match="holds 2 models"):
        weight(file, arm)


def test_a_model_with_joints_that_nobody_knows_is_refused_where_it_matters_how_they_stand(arm: Path) -> None:
    """An arm of one joint was told to have a gain of 0.05 beside another one of two joints, of which one had its name.

    A finger of 1 g that slides 0.1 m at most may stand anywhere.
    """
    one, gripping = arm.with_name("one.urdf"), arm.with_name("gripping.urdf")
    one.write_text(URDF.replace('<joint name="q2" type="continuous">', '<joint name="q2" type="fixed">'))
    with pytest.raises(RobotError, match=r"arm\.urdf: has q2 beside the joints of .*, and \d+ % of the"):
        read_simulator_model(arm, BaseRegressor(load_robot(one)))
    finger = INERTIAL.replace('value="2"', 'value="1e-3"').replace('"0.1"', '"1e-6"')
    slides = '<limit lower="0" upper="0.1" effort="1" velocity="1"/><axis xyz="1 0 0"/>'
    gripping.write_text(
        URDF.replace(
            "</robot>",
            f"""<link name="finger">{finger}</link>
        <joint name="f" type="prismatic">{slides}<parent link="tool"/><child link="finger"/></joint></robot>""",
        )
    )
    assert weight(gripping, arm) == pytest.approx(weight(arm, arm), rel=1e-2)
