"""MJCF (MuJoCo) of an identified arm: damping, dry friction and rotor inertia all have their place there.

Shapes are to look at only (no contacts), and meshes stay behind: MuJoCo reads neither package:// names nor DAE files.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

from identification.export.arm import Arm, Body, joint_placement
from identification.export.parameters import ModelParameters
from identification.export.xml_text import add, number, numbers, quaternion
from identification.robots import RobotModel

TIME_STEP_S = 0.001

_HARD_FRICTION = (f"{2.0 * TIME_STEP_S!r} 1.0", "0.9999 0.9999 0.001 0.5 2.0")
"""As hard as MuJoCo's dry friction gets at this step: by default it is so soft that a light wrist hardly feels it."""


def write_mjcf(
    arm: Arm, urdf: ElementTree.Element, robot: RobotModel, parameters: ModelParameters
) -> ElementTree.Element:
    """The MJCF tree: one body, joint and motor per joint, sites for frames; steps of 1 ms, gravity of the model."""
    physical = parameters.physical
    root = ElementTree.Element("mujoco", model=arm.name)
    add(root, "compiler", angle="radian", autolimits="true")
    gravity = numbers(robot.gravity_in_files)
    add(root, "option", timestep=number(TIME_STEP_S), integrator="implicitfast", gravity=gravity)
    world = add(root, "worldbody")
    base = world if arm.base.name == "world" else add(world, "body", name=arm.base.name)
    _add_shapes(base, arm.base)
    actuator = ElementTree.Element("actuator")
    bodies: list[ElementTree.Element] = []
    for index, link in enumerate(arm.links):
        above = int(robot.kinematics.parent[index])
        pose = joint_placement(robot, urdf, index)
        body = add(
            base if above < 0 else bodies[above], "body", name=link.name,
            pos=numbers(pose.translation), quat=numbers(quaternion(pose.rotation)),
        )  # fmt: skip
        bodies.append(body)
        tensor = physical.inertia[index]
        entries = [tensor[row, column] for row, column in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        add(
            body, "inertial", pos=numbers(physical.center_of_mass[index]), mass=number(physical.mass[index]),
            fullinertia=numbers(entries),
        )  # fmt: skip
        joint = add(
            body, "joint", name=robot.joint_names[index],
            type="hinge" if robot.kinematics.revolute[index] else "slide",
            axis=numbers(robot.kinematics.axis[index]),
            damping=number(physical.viscous[index]),
            frictionloss=number(physical.coulomb[index]),
            armature=number(parameters.rotor_inertia[index]),
            solreffriction=_HARD_FRICTION[0],
            solimpfriction=_HARD_FRICTION[1],
        )  # fmt: skip
        lower, upper = robot.position_lower[index], robot.position_upper[index]
        if math.isfinite(lower) and math.isfinite(upper):
            joint.set("range", numbers([lower, upper]))
        motor = add(actuator, "motor", name=f"{robot.joint_names[index]}_motor", joint=robot.joint_names[index])
        if math.isfinite(robot.effort[index]) and robot.effort[index] > 0.0:
            motor.set("ctrlrange", numbers([-robot.effort[index], robot.effort[index]]))
        _add_shapes(body, link)
    root.append(actuator)
    return root


def _add_shapes(element: ElementTree.Element, body: Body) -> None:
    for name, pose in body.frames:
        add(element, "site", name=name, pos=numbers(pose.translation), quat=numbers(quaternion(pose.rotation)))
    for shape in body.shapes:
        size = _size(shape.geometry)
        if shape.kind != "visual" or size is None:
            continue
        add(
            element, "geom", type=shape.geometry.tag, size=size, contype="0", conaffinity="0", group="2",
            pos=numbers(shape.placement.translation), quat=numbers(quaternion(shape.placement.rotation)),
        )  # fmt: skip


def _size(geometry: ElementTree.Element) -> str | None:
    """MuJoCo's size, m: half lengths; None for shapes that are left out."""
    if geometry.tag == "sphere":
        return number(float(geometry.get("radius", "0")))
    if geometry.tag in ("cylinder", "capsule"):
        return numbers([float(geometry.get("radius", "0")), 0.5 * float(geometry.get("length", "0"))])
    if geometry.tag == "box":
        return numbers(0.5 * float(value) for value in geometry.get("size", "").split())
    return None
