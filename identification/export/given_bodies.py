"""The bodies that a robot description states, in the link frames of an identified robot: a prior for open directions.

The description may be another file than the one that was identified with, have other link frames and carry a gripper;
its joints must stand where the robot's do.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.errors import RobotError
from identification.estimators.prior import BodyPrior, prior_of_bodies
from identification.export.kinematic_urdf import arm_without_inertias
from identification.export.xml_text import document
from identification.robots import Kinematics, RobotModel, load_robot, robot_from_urdf
from identification.robots.installation import Installation
from identification.robots.simulator_models import held_in

_LARGEST_ANGLE = 0.01
"""rad between the axes of one joint in both descriptions; files print right angles with three to five digits."""
_LARGEST_DISTANCE_M = 0.005
_ORDER = (0, 1, 2, 3, 4, 5, 7, 6, 8, 9)
"""Pinocchio's order of ten inertial parameters, XX XY YY XZ YZ ZZ, as ours, XX XY XZ YY YZ ZZ."""


def given_bodies(file: str | Path, robot: RobotModel) -> BodyPrior:
    """Bodies stated by a URDF for a robot: joints matched in order, or by name where the file has more.

    Further joints of the file stand as the robot holds them, else at zero, their bodies belong to the link that carries
    them. Raises RobotError where the file states no masses or one below zero, lacks joints, or has one of them in
    another place.
    """
    given = load_as_held(file, robot)
    ours = in_file_base(robot)
    matched = _matched(given, ours, Path(file))
    here, there = poses_at_zero(ours.kinematics), poses_at_zero(given.kinematics)
    for joint, other in matched.items():
        _compare(here[other], there[joint], ours.kinematics.axis[other], given.kinematics.axis[joint], other, file)
    inertial = np.zeros((robot.n, 10))
    for joint, inertia in enumerate(given.pinocchio_model.inertias[1:]):
        carrier = next((link for link in reversed(given.kinematics.upstream(joint)) if link in matched), None)
        if carrier is None:
            continue
        link = matched[carrier]
        moved = pinocchio.SE3(np.linalg.solve(here[link], there[joint])).act(inertia)
        inertial[link] += moved.toDynamicParameters()[list(_ORDER)]
    if inertial[:, 0].min() < 0.0:
        joint = int(np.argmin(inertial[:, 0]))
        raise RobotError(
            f"{file}: what joint {joint + 1} moves has a mass of {inertial[joint, 0]:.4g} kg; a prior needs bodies "
            "that exist.",
            file=file,
            field="inertial",
            joint=joint + 1,
        )
    if not inertial[:, 0].any():
        raise RobotError(f"{file} states no masses; a prior needs them.", file=file, field="inertial")
    return prior_of_bodies(inertial, robot.kinematics, f"bodies of {Path(file).name}")


def load_as_held(file: str | Path, robot: RobotModel) -> RobotModel:
    """The robot of a URDF with those of its joints held that the given robot holds, too. Raises RobotError."""
    held = held_in(load_robot(file).joint_names, robot)
    return load_robot(file, Installation(locked_joints=tuple(held.items())))


def in_file_base(robot: RobotModel) -> RobotModel:
    """The robot as a file has it: the table of a built-in arm measures from the shoulder, a file from the floor."""
    if robot.modified_denavit_hartenberg is None:
        return robot
    return robot_from_urdf(document(arm_without_inertias(robot)), source=robot.source, name=robot.name)


def poses_at_zero(kinematics: Kinematics) -> FloatArray:
    """(n, 4, 4) poses of the link frames in the base frame at zero."""
    poses = np.zeros((kinematics.n, 4, 4))
    for joint, parent in enumerate(kinematics.parent):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = kinematics.rotation[joint], kinematics.translation[joint]
        poses[joint] = pose if parent < 0 else poses[parent] @ pose
    return poses


def _matched(given: RobotModel, robot: RobotModel, file: Path) -> dict[int, int]:
    """Joint of the file → joint of the robot."""
    if given.n == robot.n:
        return {joint: joint for joint in range(robot.n)}
    missing = [name for name in robot.joint_names if name not in given.joint_names]
    if missing:
        raise RobotError(
            f"{file} has {given.n} joints and none called {', '.join(missing)}; {robot.name} has {robot.n} joints.",
            file=file,
            field="joint",
        )
    return {given.joint_names.index(name): joint for joint, name in enumerate(robot.joint_names)}


def _compare(
    here: FloatArray, there: FloatArray, axis: FloatArray, other: FloatArray, joint: int, file: str | Path
) -> None:
    """Refuse a joint whose axis is another line in space. here, there: (4, 4); axis, other: (3,) in these frames."""
    mine, its = here[:3, :3] @ axis, there[:3, :3] @ other
    angle = float(np.arccos(np.clip(mine @ its, -1.0, 1.0)))
    distance = float(np.linalg.norm(np.cross(mine, there[:3, 3] - here[:3, 3])))
    if angle > _LARGEST_ANGLE or distance > _LARGEST_DISTANCE_M:
        raise RobotError.at(
            file,
            f"joint {joint + 1} stands elsewhere than the identified robot's at zero, its axis turned by "
            f"{np.degrees(angle):.1f}° and {1e3 * distance:.0f} mm away; it is another robot, or zero is elsewhere.",
            joint=joint + 1,
        )
