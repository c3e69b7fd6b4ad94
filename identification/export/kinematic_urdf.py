"""The kinematics of an arm as URDF: joints, limits, a simple shape to look at, and no inertias.

Here: an element tree or text from a RobotModel. Not here: inertial parameters (`urdf` puts them in) and reading URDF
(`robots`). The log carries this text on /robot_description, so that a viewer shows the arm that was recorded.

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
import pinocchio

from identification.errors import RobotError
from identification.export.xml_text import add, document, number, numbers, roll_pitch_yaw
from identification.robots import RobotModel
from identification.robots.flange import IIWA_FLANGE
from identification.robots.model import TABLE_IN_FILES

_SHOULDER_HEIGHT_M = {"iiwa14": 0.36, "iiwa7": 0.34}
_LINK_RADIUS_M = 0.06
_UNKNOWN_LIMIT = 1e4
"""URDF wants numbers for velocity and effort, and for a prismatic joint's range; this one stands for 'not stated'."""


def kinematic_urdf(robot: RobotModel, *, joint_names: Sequence[str] | None = None) -> str:
    """URDF text of a built-in robot: base_link, link_1 ... link_7, flange; positions in rad, velocities in rad/s, Nm.

    joint_names: defaults to the robot's own. Raises RobotError for a robot whose base and flange are not known here.
    """
    if robot.name not in _SHOULDER_HEIGHT_M:
        known = ", ".join(_SHOULDER_HEIGHT_M)
        raise RobotError(f"There is no base and flange for '{robot.name}'; known are {known}.", field="name")
    return document(arm_without_inertias(robot, joint_names=joint_names))


def arm_without_inertias(robot: RobotModel, *, joint_names: Sequence[str] | None = None) -> ElementTree.Element:
    """The same as an element tree, for any robot with kinematics; where base and flange are not known, none is added.

    A revolute joint without limits becomes a continuous one.
    """
    known = robot.name in _SHOULDER_HEIGHT_M
    names = list(joint_names or robot.joint_names)
    kinematics = robot.kinematics
    root = ElementTree.Element("robot", name=f"lbr_{robot.name}" if known else robot.name)
    carrier = pinocchio.SE3.Identity()
    if known:
        carrier = pinocchio.SE3(np.diag(TABLE_IN_FILES), np.array([0.0, 0.0, _SHOULDER_HEIGHT_M[robot.name]]))
    _add_tubes(add(root, "link", name="base_link"), [carrier.translation])
    for link in range(kinematics.n):
        ends = [kinematics.translation[joint] for joint in np.flatnonzero(kinematics.parent == link)]
        if known and link == kinematics.n - 1:
            ends = [IIWA_FLANGE.origin]
        _add_tubes(add(root, "link", name=f"link_{link + 1}"), ends)
    for joint, name in enumerate(names):
        pose = pinocchio.SE3(kinematics.rotation[joint], kinematics.translation[joint])
        parent = int(kinematics.parent[joint])
        if parent < 0:
            pose = carrier * pose
        bounded = bool(np.isfinite([robot.position_lower[joint], robot.position_upper[joint]]).all())
        kind = ("revolute" if bounded else "continuous") if kinematics.revolute[joint] else "prismatic"
        element = add(root, "joint", name=name, type=kind)
        _add_place(element, "base_link" if parent < 0 else f"link_{parent + 1}", f"link_{joint + 1}", pose)
        add(element, "axis", xyz=numbers(kinematics.axis[joint]))
        limits = {"velocity": robot.velocity[joint], "effort": robot.effort[joint]}
        if kind != "continuous":
            limits = {"lower": robot.position_lower[joint], "upper": robot.position_upper[joint], **limits}
        stated = {
            key: value if math.isfinite(value) else (-_UNKNOWN_LIMIT if key == "lower" else _UNKNOWN_LIMIT)
            for key, value in limits.items()
        }
        add(element, "limit", **{key: number(value) for key, value in stated.items()})
    if known:
        add(root, "link", name="flange")
        fixed = add(root, "joint", name="flange_joint", type="fixed")
        flange = pinocchio.SE3(IIWA_FLANGE.rotation, IIWA_FLANGE.origin)
        _add_place(fixed, f"link_{kinematics.n}", "flange", flange)
    return root


def _add_place(joint: ElementTree.Element, parent: str, child: str, pose: pinocchio.SE3) -> None:
    """Where the joint sits: parent link, child link, and the pose of its frame in the parent's (m)."""
    add(joint, "parent", link=parent)
    add(joint, "child", link=child)
    add(joint, "origin", xyz=numbers(pose.translation), rpy=numbers(roll_pitch_yaw(pose.rotation)))


def _add_tubes(link: ElementTree.Element, ends: Sequence[np.ndarray]) -> None:
    """A ball at the link's origin and a tube to each next joint, m: to look at, nobody's collision model."""
    ball = add(link, "visual")
    add(add(ball, "geometry"), "sphere", radius=number(1.2 * _LINK_RADIUS_M))
    for end in ends:
        length = math.hypot(*end)
        if length == 0.0:
            continue
        tube = add(link, "visual")
        direction = (0.0, math.atan2(math.hypot(end[0], end[1]), end[2]), math.atan2(end[1], end[0]))
        add(tube, "origin", xyz=numbers(0.5 * end), rpy=numbers(direction))
        add(add(tube, "geometry"), "cylinder", radius=number(_LINK_RADIUS_M), length=number(length))
