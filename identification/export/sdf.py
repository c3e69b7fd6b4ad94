"""SDF (Gazebo, Drake) of an identified arm.

Bodies joined by fixed joints become one link with named frames: in SDF a link without <inertial> would weigh 1 kg.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.export.arm import Arm, Body, joint_placement
from identification.export.parameters import ModelParameters
from identification.export.xml_text import INERTIA_SYMBOLS, add, number, numbers, roll_pitch_yaw
from identification.robots import RobotModel
from identification.robots.urdf_parser import DRAKE

_WORLD = "world"


def write_sdf(
    arm: Arm, urdf: ElementTree.Element, robot: RobotModel, parameters: ModelParameters
) -> ElementTree.Element:
    """The SDF 1.9 tree of an arm whose base is fixed to the world."""
    root = ElementTree.Element("sdf", version="1.9")
    model = add(root, "model", name=arm.name)
    if arm.base.name != _WORLD:
        fixed = add(model, "joint", name=f"{arm.base.name}_to_world", type="fixed")
        add(fixed, "parent", _WORLD)
        add(fixed, "child", arm.base.name)
        _add_shapes(add(model, "link", name=arm.base.name), arm.base)
        _add_frames(model, arm.base)
    names, physical = [body.name for body in arm.links], parameters.physical
    for index, body in enumerate(arm.links):
        above = int(robot.kinematics.parent[index])
        parent = arm.base.name if above < 0 else names[above]
        joint = add(model, "joint", name=robot.joint_names[index], type=arm.joint_types[index])
        add(joint, "parent", parent)
        add(joint, "child", body.name)
        # A model's own frame is the world's where the base is welded at its origin.
        place_in = {} if parent == _WORLD else {"relative_to": parent}
        add(joint, "pose", _pose(joint_placement(robot, urdf, index)), **({"relative_to": "__model__"} | place_in))
        axis = add(joint, "axis")
        add(axis, "xyz", numbers(robot.kinematics.axis[index]))
        limit = add(axis, "limit")
        stated = (
            ("lower", robot.position_lower), ("upper", robot.position_upper),
            ("effort", robot.effort), ("velocity", robot.velocity),
        )  # fmt: skip
        for name, values in stated:
            if math.isfinite(values[index]):
                add(limit, name, number(values[index]))
        dynamics = add(axis, "dynamics")
        add(dynamics, "damping", number(physical.viscous[index]))
        add(dynamics, "friction", number(physical.coulomb[index]))
        add(joint, f"{{{DRAKE}}}rotor_inertia", number(parameters.rotor_inertia[index]))
        add(joint, f"{{{DRAKE}}}gear_ratio", "1.0")
        link = add(model, "link", name=body.name)
        add(link, "pose", "0 0 0 0 0 0", relative_to=robot.joint_names[index])
        link.append(sdf_inertial(physical.mass[index], physical.center_of_mass[index], physical.inertia[index]))
        _add_shapes(link, body)
        _add_frames(model, body)
    return root


def sdf_inertial(mass: float, center: FloatArray, tensor: FloatArray) -> ElementTree.Element:
    """What a link weighs: kg, its centre (3,) m and the inertia (3, 3) kg m² about it, along the link's axes."""
    inertial = ElementTree.Element("inertial")
    add(inertial, "pose", numbers([*center, 0.0, 0.0, 0.0]))
    add(inertial, "mass", number(mass))
    inertia = add(inertial, "inertia")
    for row, column, symbol in INERTIA_SYMBOLS:
        add(inertia, symbol, number(tensor[row, column]))
    return inertial


def _pose(placement: pinocchio.SE3) -> str:
    return numbers(np.concatenate([placement.translation, roll_pitch_yaw(placement.rotation)]))


def _add_frames(model: ElementTree.Element, body: Body) -> None:
    for name, placement in body.frames:
        add(add(model, "frame", name=name, attached_to=body.name), "pose", _pose(placement))


def _add_shapes(link: ElementTree.Element, body: Body) -> None:
    for count, shape in enumerate(body.shapes, start=1):
        element = add(link, shape.kind, name=f"{body.name}_{shape.kind}_{count}")
        add(element, "pose", _pose(shape.placement))
        kind = shape.geometry.tag
        geometry = add(add(element, "geometry"), kind)
        # URDF and SDF have the same words; only a mesh's file is called differently.
        for attribute, text in shape.geometry.attrib.items():
            add(geometry, {"filename": "uri"}.get(attribute, attribute), text)
