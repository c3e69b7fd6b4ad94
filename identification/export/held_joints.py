"""Joints that an installation holds, in a URDF tree: fixed where they stand, with all that follows them.

What is exported is the arm that was identified: a gripper that was held is part of its link.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio

from identification.export.arm import origin
from identification.export.xml_text import add, numbers, roll_pitch_yaw
from identification.robots import RobotModel
from identification.robots.locking import motion_along

_OF_A_MOTION = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration", "origin")


def fix_held_joints(urdf: ElementTree.Element, robot: RobotModel) -> None:
    """Make fixed joints of the movable ones that are not the robot's, at their position; `urdf` is changed in place."""
    held = [
        joint
        for joint in urdf.findall("joint")
        if joint.get("type") != "fixed" and joint.get("name") not in robot.joint_names
    ]
    positions = dict(robot.locked_joints)
    for joint in held:
        stands = origin(joint) * _motion(joint, _position(joint, urdf, positions))
        joint.set("type", "fixed")
        for tag in _OF_A_MOTION:
            for element in joint.findall(tag):
                joint.remove(element)
        add(joint, "origin", xyz=numbers(stands.translation), rpy=numbers(roll_pitch_yaw(stands.rotation)))
    names = {joint.get("name") for joint in held}
    for transmission in urdf.findall("transmission"):
        if any(joint.get("name") in names for joint in transmission.findall("joint")):
            urdf.remove(transmission)


def _position(joint: ElementTree.Element, urdf: ElementTree.Element, positions: dict[str, float]) -> float:
    """Where a held joint stands, rad (m): as it was locked, or as it follows one that was."""
    name, rule = joint.get("name", ""), joint.find("mimic")
    if name not in positions and rule is not None:
        leader = next(item for item in urdf.findall("joint") if item.get("name") == rule.get("joint"))
        followed = _position(leader, urdf, positions)
        positions[name] = float(rule.get("multiplier", 1.0)) * followed + float(rule.get("offset", 0.0))
    return positions[name]


def _motion(joint: ElementTree.Element, position: float) -> pinocchio.SE3:
    """Of a joint from zero to its position, in its own frame."""
    stated = joint.find("axis")
    axis = np.array(("1 0 0" if stated is None else stated.get("xyz", "1 0 0")).split(), dtype=np.float64)
    axis /= np.linalg.norm(axis)
    return motion_along(axis, position, revolute=joint.get("type") != "prismatic")
