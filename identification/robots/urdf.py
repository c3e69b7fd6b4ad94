"""Robots from URDF files, read by Pinocchio and brought to one configuration number per joint.

Inertias are optional: the kinematics is what identification needs. Fixed joints are merged into their parent link.
"""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.errors import RobotError
from identification.robots.flange import flange_of_frames
from identification.robots.installation import STANDARD_GRAVITY
from identification.robots.model import Kinematics, Mimic, RobotModel, build_pinocchio_model, snap_to_right_angles
from identification.robots.urdf_parser import parsed_urdf, refuse_xacro


def robot_from_urdf(
    text: str, *, name: str | None = None, source: str, gravity: tuple[float, float, float] = STANDARD_GRAVITY
) -> RobotModel:
    """The fixed-base robot of a URDF text; revolute, continuous and prismatic joints, any number of them.

    Raises RobotError for text that is no URDF, a robot without movable joints, and floating or planar joints.
    """
    declared_name = _check_xml(text, source)
    try:
        parsed = parsed_urdf(text)
    except ValueError as error:
        raise RobotError(f"{source} cannot be read as a URDF: {error}.", file=source) from error
    if parsed.njoints < 2:
        raise RobotError(f"{source} describes no movable joint.", file=source, field="joint")
    joint_names = tuple(parsed.names[1:])
    kinematics = _kinematics(parsed, joint_names, source)
    base_gravity = np.array(gravity, dtype=np.float64)
    robot_name = name or declared_name or Path(source).stem
    limits = _limits(text, joint_names)
    return RobotModel(
        name=robot_name,
        joint_names=joint_names,
        kinematics=kinematics,
        pinocchio_model=build_pinocchio_model(
            robot_name, kinematics, joint_names, base_gravity, tuple(parsed.inertias[1:])
        ),
        modified_denavit_hartenberg=None,
        position_lower=limits[:, 0],
        position_upper=limits[:, 1],
        velocity=limits[:, 2],
        effort=limits[:, 3],
        gravity=base_gravity,
        source=source,
        digest=hashlib.sha256(text.encode()).hexdigest(),
        mimics=_mimics(text, joint_names, source),
        flange=flange_of_frames(parsed),
    )


def _check_xml(text: str, source: str) -> str | None:
    """Name of the robot element; the errors that Pinocchio would print to stderr instead of raising."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise RobotError(f"{source} is not well-formed XML: {error}.", file=source) from error
    if root.tag != "robot":
        raise RobotError(f"{source} is no URDF: its root element is <{root.tag}>, not <robot>.", file=source)
    refuse_xacro(root, source)
    links = {link.get("name") for link in root.findall("link")}
    joints = root.findall("joint")
    if not links:
        raise RobotError(f"{source} describes no link.", file=source, field="link")
    if not any(joint.get("type") not in (None, "fixed") for joint in joints):
        raise RobotError(
            f"{source} describes no movable joint; is it the robot's description, or only its meshes?",
            file=source,
            field="joint",
        )
    for joint in joints:
        if joint.get("type") in ("floating", "planar"):
            raise RobotError.at(
                source,
                f"joint '{joint.get('name')}' is {joint.get('type')}; only fixed, revolute, continuous and "
                "prismatic joints of a fixed-base robot are supported.",
                field=joint.get("name"),
            )
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if link not in links:
                raise RobotError.at(
                    source,
                    f"joint '{joint.get('name')}' names {end} link '{link}', which is not described.",
                    field=joint.get("name"),
                )
    return root.get("name")


def _kinematics(parsed: pinocchio.Model, joint_names: tuple[str, ...], source: str) -> Kinematics:
    count = len(joint_names)
    parent = np.empty(count, dtype=np.int64)
    rotation = np.empty((count, 3, 3))
    translation = np.empty((count, 3))
    axis = np.empty((count, 3))
    revolute = np.empty(count, dtype=np.bool_)
    data = parsed.createData()
    pinocchio.computeJointJacobians(parsed, data, pinocchio.neutral(parsed))
    for joint in range(count):
        parent[joint] = parsed.parents[joint + 1] - 1
        placement = parsed.jointPlacements[joint + 1]
        rotation[joint] = snap_to_right_angles(placement.rotation)
        translation[joint] = np.where(np.abs(placement.translation) < 1e-9, 0.0, placement.translation)
        model_joint = parsed.joints[joint + 1]
        jacobian = pinocchio.getJointJacobian(parsed, data, joint + 1, pinocchio.ReferenceFrame.LOCAL).reshape(6, -1)
        subspace = jacobian[:, model_joint.idx_v : model_joint.idx_v + model_joint.nv]
        revolute[joint], axis[joint] = _joint_type_and_axis(model_joint, subspace, source, joint_names[joint])
    return Kinematics(parent, rotation, translation, axis, revolute)


def _joint_type_and_axis(
    joint: pinocchio.JointModel, subspace: FloatArray, source: str, name: str
) -> tuple[bool, FloatArray]:
    """Whether the joint is revolute, and its axis, read off its (6, 1) motion subspace (linear over angular)."""
    kind = joint.shortname().removeprefix("JointModel")
    if not np.any(subspace):
        raise RobotError.at(source, f"the axis of joint '{name}' is 0 0 0, which is no direction.", field=name)
    if joint.nv == 1 and kind.startswith(("R", "P")):
        linear, angular = subspace[:3, 0], subspace[3:, 0]
        revolute = bool(np.any(angular))
        vector = angular if revolute else linear
        if revolute != bool(np.any(linear)):
            return revolute, np.asarray(vector / np.linalg.norm(vector), dtype=np.float64)
    raise RobotError.at(
        source,
        f"joint '{name}' is of a kind that is not supported ({kind}); only revolute, continuous and "
        "prismatic joints are.",
        field=name,
    )


def _limits(text: str, joint_names: tuple[str, ...]) -> FloatArray:
    """(n, 4) position lower, upper, velocity, effort as the file states them; nan where it does not."""
    limits = np.full((len(joint_names), 4), np.nan)
    for element in ElementTree.fromstring(text).findall("joint"):
        limit = element.find("limit")
        name = element.get("name")
        if limit is None or name not in joint_names:
            continue
        columns = (
            ("lower", "upper", "velocity", "effort")
            if element.get("type") != "continuous"
            else (None, None, "velocity", "effort")
        )
        for column, attribute in enumerate(columns):
            value = limit.get(attribute) if attribute else None
            if value is not None:
                limits[joint_names.index(name), column] = float(value)
    return limits


def _mimics(text: str, joint_names: tuple[str, ...], source: str) -> tuple[Mimic, ...]:
    """The movable joints that follow another one."""
    found = []
    for element in ElementTree.fromstring(text).findall("joint"):
        rule, name = element.find("mimic"), element.get("name")
        if rule is None or name not in joint_names:
            continue
        leader = rule.get("joint")
        try:
            multiplier, offset = float(rule.get("multiplier", 1.0)), float(rule.get("offset", 0.0))
        except ValueError as error:
            raise RobotError.at(source, f"joint '{name}' follows by no number ({error}).", field=name) from error
        if leader not in joint_names or leader == name:
            raise RobotError.at(
                source, f"joint '{name}' follows '{leader}', which is no other movable joint.", field=name
            )
        found.append(Mimic(name, leader, multiplier, offset))
    return tuple(found)
