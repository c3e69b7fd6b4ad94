"""Do two descriptions mean the same arm? Asked of the joints' axes in space, so that frames and names do not matter.
Parameters of links stand in the links' frames, though: whether those are the same is asked of the frames themselves.

Called where a model of one robot meets a recording of another: an iiwa 7 and an iiwa 14 have the same joints and
other lengths, and nothing but this tells them apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio

from identification.arrays import FloatArray
from identification.robots.model import RobotModel

TOLERANCE = 2e-3
"""m, and rad, by which two descriptions of one arm differ."""
GRAVITY_TOLERANCE = 0.05
"""m/s²; a place on the ground."""
FRAME_TOLERANCE = 2e-4
"""m, and rad: a description written with four decimals is the same."""
OTHER_GRAVITY = "gravity in another direction of the base"
SEED = 7
STATES = 3


def difference_of_arms(one: RobotModel, other: RobotModel) -> str:
    """What tells two robots apart, as half a sentence; empty where their joints move alike.

    Compared are the number and kind of the joints, angles and distances between all pairs of axes at a few positions,
    and the angle between gravity and the axes that do not move; names, frames and where the base stands do not count.
    """
    if one.n != other.n:
        return f"{other.n} joints in place of {one.n}"
    if not np.array_equal(one.kinematics.revolute, other.kinematics.revolute):
        return "joints of another kind"
    generator = np.random.default_rng(SEED)
    for position in (np.zeros(one.n), *generator.uniform(-1.0, 1.0, (STATES, one.n))):
        (angle, distance), (other_angle, other_distance) = (_pairs(robot, position) for robot in (one, other))
        if np.abs(angle - other_angle).max() > TOLERANCE:
            place = np.unravel_index(np.argmax(np.abs(angle - other_angle)), angle.shape)
            return f"the axes of joints {place[0] + 1} and {place[1] + 1} make another angle"
        if np.abs(distance - other_distance).max() > TOLERANCE:
            a, b = np.unravel_index(np.argmax(np.abs(distance - other_distance)), distance.shape)
            return (
                f"the axes of joints {a + 1} and {b + 1} are {1e3 * other_distance[a, b]:.0f} mm apart in place of "
                f"{1e3 * distance[a, b]:.0f} mm"
            )
    falls = [robot.gravity @ _axes(robot, np.zeros(robot.n))[0].T for robot in (one, other)]
    if np.abs(falls[0] - falls[1]).max() > GRAVITY_TOLERANCE:
        return OTHER_GRAVITY
    return ""


def frames_of(robot: RobotModel) -> list[dict[str, Any]]:
    """The frame of each joint in that of the link that carries it, plain JSON types: what link parameters stand in."""
    tree = robot.kinematics
    return [
        {
            "name": robot.joint_names[joint],
            "parent": int(tree.parent[joint]) + 1,
            "revolute": bool(tree.revolute[joint]),
            "translation": tree.translation[joint].tolist(),
            "rotation": tree.rotation[joint].ravel().tolist(),
            "axis": tree.axis[joint].tolist(),
        }
        for joint in range(robot.n)
    ]


def difference_of_frames(frames: Sequence[Mapping[str, Any]], robot: RobotModel) -> str:
    """What tells a robot's frames from those of `frames_of`, as half a sentence; empty where they are the same.

    Where the base stands does not count, nor how far it is turned about gravity: no link's frame depends on it.
    """
    if len(frames) != robot.n:
        return f"{robot.n} joints in place of {len(frames)}"
    for joint, (one, other) in enumerate(zip(frames, frames_of(robot), strict=True), start=1):
        if one["parent"] != other["parent"] or one["revolute"] != other["revolute"]:
            return f"joint {joint} is of another kind, or hangs on another link"
        apart = float(np.linalg.norm(np.subtract(one["translation"], other["translation"])))
        if apart > FRAME_TOLERANCE and one["parent"] > 0:
            return f"joint {joint} stands {1e3 * apart:.3g} mm elsewhere on the link that carries it"
        frame, other_frame = (np.reshape(item["rotation"], (3, 3)) for item in (one, other))
        if one["parent"] == 0:  # of the base's frame no more is felt than where gravity comes from
            gravity = robot.gravity / max(float(np.linalg.norm(robot.gravity)), 1.0)
            frame, other_frame = gravity @ frame, gravity @ other_frame
        turned = max(np.abs(frame - other_frame).max(), np.abs(np.subtract(one["axis"], other["axis"])).max())
        if turned > FRAME_TOLERANCE:
            return f"the frame or the axis of joint {joint} is turned"
    return ""


def _axes(robot: RobotModel, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Directions and points (n, 3) of the joints' axes in the base frame."""
    model = robot.pinocchio_model
    data = model.createData()
    pinocchio.forwardKinematics(model, data, position)
    placements = [data.oMi[joint + 1] for joint in range(robot.n)]
    directions = [item.rotation @ axis for item, axis in zip(placements, robot.kinematics.axis, strict=True)]
    return np.array(directions), np.array([item.translation for item in placements])


def _pairs(robot: RobotModel, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, n) cosine of the angle and distance in m between the axes; a prismatic joint's axis has no place."""
    direction, point = _axes(robot, position)
    cosine = direction @ direction.T
    between = point[None, :, :] - point[:, None, :]
    normal = np.cross(direction[:, None, :], direction[None, :, :])
    sine = np.linalg.norm(normal, axis=2)
    crossing = np.abs(np.einsum("abi,abi->ab", between, normal)) / np.maximum(sine, 1e-6)
    parallel = np.linalg.norm(np.cross(between, direction[:, None, :]), axis=2)
    distance = np.where(sine > 1e-3, crossing, parallel)
    placed = robot.kinematics.revolute
    return cosine, np.where(placed[:, None] & placed[None, :], distance, 0.0)
