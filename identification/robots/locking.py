"""A robot with some joints held still: their links become part of the links that carry them.

Pure functions of robots.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.errors import RobotError
from identification.robots.flange import Flange
from identification.robots.model import Kinematics, Mimic, RobotModel, build_pinocchio_model, snap_to_right_angles


def lock_joints(robot: RobotModel, positions: Mapping[str, float]) -> RobotModel:
    """The robot whose joints in `positions` (name → rad or m) do not move: n smaller by their number.

    Joints that a mimic rule ties to a locked one are locked with it, at multiplier · position + offset (of the URDF);
    those that follow one that moves go on following it, the joint with the motor, also through others between.
    Inertias of held links are added to the links that carry them. Raises RobotError for a joint the robot does not
    have, for one that itself follows another, where none would be left to move, and for joints that follow in a circle.
    """
    unknown = [name for name in positions if name not in robot.joint_names]
    if unknown:
        raise RobotError(
            f"{robot.source} has no joint '{unknown[0]}' to lock; its joints are {', '.join(robot.joint_names)}.",
            file=robot.source,
            field=unknown[0],
        )
    held, mimics = _with_followers(robot, dict(positions))
    if not held:
        return replace(robot, mimics=mimics)
    if len(held) == robot.n:
        raise RobotError.at(robot.source, "all of its joints are locked.", field="joint")
    kinematics, inertias, kept = _without(robot, held)
    names = tuple(robot.joint_names[joint] for joint in kept)
    return replace(
        robot,
        joint_names=names,
        kinematics=kinematics,
        pinocchio_model=build_pinocchio_model(robot.name, kinematics, names, robot.gravity, inertias),
        modified_denavit_hartenberg=None,
        mimics=mimics,
        flange=_flange(robot, kept),
        **{name: getattr(robot, name)[kept] for name in ("position_lower", "position_upper", "velocity", "effort")},
    )


def _flange(robot: RobotModel, kept: list[int]) -> Flange | None:
    """The flange on the link that still moves; None where that link is held."""
    if robot.flange is None or robot.flange.link not in kept:
        return None
    return replace(robot.flange, link=kept.index(robot.flange.link))


def _with_followers(robot: RobotModel, held: dict[str, float]) -> tuple[dict[str, float], tuple[Mimic, ...]]:
    """The locked joints and all that follow them; and who follows a joint that moves."""
    followers = {item.joint: item for item in robot.mimics}
    for name in held:
        if name in followers:
            raise RobotError.at(
                robot.source, f"joint '{name}' follows '{followers[name].leader}'; lock that one.", field=name
            )
    moving = []
    for item in followers.values():
        motor = item
        for _ in followers:
            if motor.leader not in followers:
                break
            before = followers[motor.leader]
            motor = Mimic(
                item.joint,
                before.leader,
                motor.multiplier * before.multiplier,
                motor.multiplier * before.offset + motor.offset,
            )
        else:
            raise RobotError.at(
                robot.source, f"joint '{item.joint}' follows itself through '{item.leader}'.", field=item.joint
            )
        if motor.leader in held:
            held[item.joint] = motor.multiplier * held[motor.leader] + motor.offset
        else:
            moving.append(motor)
    return held, tuple(moving)


def _without(
    robot: RobotModel, held: Mapping[str, float]
) -> tuple[Kinematics, tuple[pinocchio.Inertia, ...], list[int]]:
    """Tree and inertias of the joints that are left, and their numbers in the whole robot."""
    tree, model = robot.kinematics, robot.pinocchio_model
    kept = [joint for joint in range(robot.n) if robot.joint_names[joint] not in held]
    number = {joint: place for place, joint in enumerate(kept)}
    carrier: list[int] = []
    placement: list[pinocchio.SE3] = []
    for joint in range(robot.n):
        # Placement in the frame of the link that moves: through the held joints between.
        at = pinocchio.SE3(tree.rotation[joint], tree.translation[joint])
        parent = int(tree.parent[joint])
        if parent >= 0 and robot.joint_names[parent] in held:
            at, parent = placement[parent] * _moved(robot, parent, held) * at, carrier[parent]
        carrier.append(parent)
        placement.append(at)
    inertias = [model.inertias[joint + 1].copy() for joint in range(robot.n)]
    for joint in range(robot.n):
        if joint not in number and carrier[joint] >= 0:
            turned = (placement[joint] * _moved(robot, joint, held)).act(inertias[joint])
            inertias[carrier[joint]] = inertias[carrier[joint]] + turned
    kinematics = Kinematics(
        np.array([number[carrier[joint]] if carrier[joint] >= 0 else -1 for joint in kept], dtype=np.int64),
        np.array([snap_to_right_angles(placement[joint].rotation) for joint in kept]),
        np.array([placement[joint].translation for joint in kept]),
        tree.axis[kept].copy(),
        tree.revolute[kept].copy(),
    )
    return kinematics, tuple(inertias[joint] for joint in kept), kept


def _moved(robot: RobotModel, joint: int, held: Mapping[str, float]) -> pinocchio.SE3:
    """Motion of a held joint from zero to where it stands."""
    tree = robot.kinematics
    return motion_along(tree.axis[joint], held[robot.joint_names[joint]], revolute=bool(tree.revolute[joint]))


def motion_along(axis: FloatArray, position: float, *, revolute: bool) -> pinocchio.SE3:
    """Motion of a joint from zero to a position, rad (m), about (along) a unit axis (3,) in its own frame."""
    if revolute:
        return pinocchio.SE3(pinocchio.AngleAxis(position, axis).toRotationMatrix(), np.zeros(3))
    return pinocchio.SE3(np.eye(3), position * axis)
