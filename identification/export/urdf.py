"""URDF of an identified arm: the robot's own file with the identified numbers put in, or a new one for built-in arms.

Names, meshes, limits and everything else of the file stay. Here: inertials, <dynamics>, Drake's rotor tags. Not here:
which numbers (`parameters`) and the reading back (`check`).
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from identification.arrays import FloatArray
from identification.export.arm import attachments, joint_placement, link_at, origin
from identification.export.parameters import ModelParameters
from identification.export.xml_text import INERTIA_SYMBOLS, add, number, numbers, roll_pitch_yaw
from identification.robots import RobotModel
from identification.robots.urdf_parser import DRAKE


def write_urdf(urdf: ElementTree.Element, robot: RobotModel, parameters: ModelParameters) -> ElementTree.Element:
    """Put the identified numbers into a URDF tree (changed in place) and return it.

    The parameters of link i are those of everything that joint i moves and no later joint does: links fixed to it lose
    their own inertials. Joint origins are rewritten only where the file's right angles were rounded.
    """
    attached = attachments(urdf, robot)
    physical = parameters.physical
    for link in urdf.findall("link"):
        body, _ = attached[link.get("name", "")]
        if body < 0:
            continue
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    for joint in (item for item in urdf.findall("joint") if item.get("name") in robot.joint_names):
        index = robot.joint_names.index(joint.get("name", ""))
        _set_origin(joint, urdf, robot, index)
        name = link_at(joint, "child")
        link = next(item for item in urdf.findall("link") if item.get("name") == name)
        link.insert(0, urdf_inertial(physical.mass[index], physical.center_of_mass[index], physical.inertia[index]))
        for stated in joint.findall("dynamics"):
            joint.remove(stated)
        add(joint, "dynamics", damping=number(physical.viscous[index]), friction=number(physical.coulomb[index]))
        _set_drake_actuator(urdf, robot.joint_names[index], float(parameters.rotor_inertia[index]))
    return urdf


def urdf_inertial(mass: float, center: FloatArray, tensor: FloatArray) -> ElementTree.Element:
    """What a link weighs: kg, its centre (3,) m and the inertia (3, 3) kg m² about it, along the link's axes."""
    inertial = ElementTree.Element("inertial")
    add(inertial, "origin", xyz=numbers(center), rpy="0 0 0")
    add(inertial, "mass", value=number(mass))
    add(inertial, "inertia", **{symbol: number(tensor[row, column]) for row, column, symbol in INERTIA_SYMBOLS})
    return inertial


def _set_origin(joint: ElementTree.Element, urdf: ElementTree.Element, robot: RobotModel, index: int) -> None:
    _, carrier = attachments(urdf, robot)[link_at(joint, "parent")]
    exact = carrier.inverse() * joint_placement(robot, urdf, index)
    if np.abs(exact.homogeneous - origin(joint).homogeneous).max() < 1e-14:
        return
    for stated in joint.findall("origin"):
        joint.remove(stated)
    add(joint, "origin", xyz=numbers(exact.translation), rpy=numbers(roll_pitch_yaw(exact.rotation)))


def _set_drake_actuator(urdf: ElementTree.Element, joint: str, rotor_inertia: float) -> None:
    """Drake reads rotor inertias from a joint's actuator: inertia as seen at the joint, hence a gear ratio of 1."""
    transmission = next(
        (t for t in urdf.findall("transmission") for j in t.findall("joint") if j.get("name") == joint), None
    )
    if transmission is None:
        if rotor_inertia == 0.0:
            return
        transmission = add(urdf, "transmission", name=f"{joint}_transmission")
        add(transmission, "type", "transmission_interface/SimpleTransmission")
        add(transmission, "joint", name=joint)
    actuator = transmission.find("actuator")
    if actuator is None:
        actuator = add(transmission, "actuator", name=f"{joint}_motor")
    for tag, value in (("gear_ratio", 1.0), ("rotor_inertia", rotor_inertia)):
        for stated in actuator.findall(f"{{{DRAKE}}}{tag}"):
            actuator.remove(stated)
        add(actuator, f"{{{DRAKE}}}{tag}", value=number(value))


def move_meshes(urdf: ElementTree.Element, source_folder: Path, target_folder: Path) -> None:
    """Make relative mesh file names, which count from the file they stand in, count from the target folder."""
    for mesh in urdf.iter("mesh"):
        name = mesh.get("filename", "")
        if name and "://" not in name and not os.path.isabs(name):
            mesh.set("filename", os.path.relpath(source_folder / name, target_folder))
