"""The kinematics of a built-in arm as URDF text: joints, limits, a simple shape to look at, and no inertias.

Here: text from a RobotModel. Not here: inertial parameters (they are what is identified) and reading URDF (`robots`).
The log carries this text on /robot_description, so that a viewer shows the arm that was recorded.

The table of the paper measures from the shoulder and has its base turned by π about z against every public URDF of the
iiwa. The joint that carries the arm turns it back and lifts it to the shoulder's height, and the flange is turned by π
about its z; then the flange has the usual pose for every joint position, and joints keep their signs. The link frames
in between are the table's, turned by π about their z against the usual ones.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence

import numpy as np

from identification.errors import RobotError
from identification.robots import RobotModel
from identification.robots.model import FloatArray

__all__ = ["kinematic_urdf"]

_SHOULDER_HEIGHT_M = {"iiwa14": 0.36, "iiwa7": 0.34}
_FLANGE_M = 0.126
"""From the wrist to the flange without media flange, both arms (KUKA brochure LBR iiwa)."""
_LINK_RADIUS_M = 0.06


def kinematic_urdf(robot: RobotModel, *, joint_names: Sequence[str] | None = None) -> str:
    """URDF text of a built-in robot: base_link, link_1 ... link_7, flange; positions in rad, velocities in rad/s, Nm.

    joint_names: defaults to the robot's own. Raises RobotError for a robot whose base and flange are not known here.
    """
    if robot.name not in _SHOULDER_HEIGHT_M:
        known = ", ".join(_SHOULDER_HEIGHT_M)
        raise RobotError(f"There is no base and flange for '{robot.name}'; known are {known}.", field="name")
    names = list(joint_names or robot.joint_names)
    kinematics = robot.kinematics
    root = ElementTree.Element("robot", name=f"lbr_{robot.name}")
    ends = [*kinematics.translation[1:].tolist(), [0.0, 0.0, _FLANGE_M]]
    base = _add(root, "link", name="base_link")
    _add_tube(base, [0.0, 0.0, _SHOULDER_HEIGHT_M[robot.name]])
    for joint in range(kinematics.n):
        _add_tube(_add(root, "link", name=f"link_{joint + 1}"), ends[joint])
    _add(root, "link", name="flange")
    carrier = _yaw(math.pi)
    for joint, name in enumerate(names):
        rotation, translation = kinematics.rotation[joint], kinematics.translation[joint]
        if joint == 0:
            rotation = carrier @ rotation
            translation = carrier @ translation + (0.0, 0.0, _SHOULDER_HEIGHT_M[robot.name])
        element = _add(root, "joint", name=name, type="revolute")
        _add_place(element, "base_link" if joint == 0 else f"link_{joint}", f"link_{joint + 1}", rotation, translation)
        _add(element, "axis", xyz=_numbers(kinematics.axis[joint]))
        _add(
            element,
            "limit",
            lower=_number(robot.position_lower[joint]),
            upper=_number(robot.position_upper[joint]),
            velocity=_number(robot.velocity[joint]),
            effort=_number(robot.effort[joint]),
        )
    fixed = _add(root, "joint", name="flange_joint", type="fixed")
    _add_place(fixed, f"link_{kinematics.n}", "flange", _yaw(math.pi), np.array([0.0, 0.0, _FLANGE_M]))
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _add(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _add_place(
    joint: ElementTree.Element, parent: str, child: str, rotation: FloatArray, translation: FloatArray
) -> None:
    """Where the joint sits: parent link, child link, and rotation and translation (m) of its frame in the parent's."""
    _add(joint, "parent", link=parent)
    _add(joint, "child", link=child)
    _add(joint, "origin", xyz=_numbers(translation), rpy=_numbers(_roll_pitch_yaw(rotation)))


def _add_tube(link: ElementTree.Element, end: Sequence[float]) -> None:
    """A ball at the link's origin and a tube to the next joint, m: something to look at, nobody's collision model."""
    length = math.hypot(*end)
    ball = _add(link, "visual")
    _add(_add(ball, "geometry"), "sphere", radius=_number(1.2 * _LINK_RADIUS_M))
    if length > 0.0:
        tube = _add(link, "visual")
        direction = (0.0, math.atan2(math.hypot(end[0], end[1]), end[2]), math.atan2(end[1], end[0]))
        _add(tube, "origin", xyz=_numbers([value / 2 for value in end]), rpy=_numbers(direction))
        _add(_add(tube, "geometry"), "cylinder", radius=_number(_LINK_RADIUS_M), length=_number(length))


def _yaw(angle: float) -> FloatArray:
    """Rotation about z; exact for π, so that no 1e-16 stands in the file."""
    cosine, sine = round(math.cos(angle), 15), round(math.sin(angle), 15)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _roll_pitch_yaw(rotation: FloatArray) -> tuple[float, float, float]:
    """Angles of Rz(yaw) Ry(pitch) Rx(roll), rad, as URDF wants them; pitch must not be ±π/2, which no iiwa has."""
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[2, 1], rotation[2, 2]))
    return roll, pitch, math.atan2(rotation[1, 0], rotation[0, 0])


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


def _numbers(values: Sequence[float] | FloatArray) -> str:
    return " ".join(_number(value) for value in values)
