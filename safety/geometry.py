"""The arm as capsules on a kinematic chain: forward kinematics in NumPy and how far each joint can move each part.

Lives here: reading the geometry file of a robot (safety/geometry_<robot>.json, sources inside it), the poses of its
links, and the bound on motion that lets a path be checked with gaps. Lives elsewhere: distances (collision.py).
Independent of the identification's kinematics on purpose: what guards a trajectory should not share its mistakes.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from importlib import resources
from typing import Any

import numpy as np

from safety.errors import GeometryError
from safety.limits import FloatArray

FLANGE_M = 0.126
"""Distance of the flange from the origin of the last link, along its axis."""

SELF_COLLISION_MARGIN_M = 0.02
"""Distance that links keep from each other. The capsules already enclose the housings."""

WORKSPACE_MARGIN_M = 0.02
"""Distance that links keep from floor, walls and boxes."""

TOOL = "tool"


@dataclass(frozen=True, slots=True)
class Capsule:
    """A cylinder with round ends on one link: every point within `radius_m` of the segment start_m..end_m.

    link: 0 is the base, i the link that joint i moves. start_m, end_m: in the link's frame, m.
    """

    link: int
    part: str
    start_m: tuple[float, float, float]
    end_m: tuple[float, float, float]
    radius_m: float

    def __post_init__(self) -> None:
        numbers = (*self.start_m, *self.end_m, self.radius_m)
        if len(numbers) != 7 or not all(math.isfinite(value) for value in numbers) or self.radius_m <= 0.0:
            raise GeometryError(
                f"The capsule {self.part!r} of link {self.link} needs two finite points and a radius above "
                f"0 m, not {self.start_m}, {self.end_m}, {self.radius_m}."
            )

    @property
    def extent_m(self) -> float:
        """Largest distance of any of its points from the origin of the link's frame."""
        return max(math.hypot(*self.start_m), math.hypot(*self.end_m)) + self.radius_m


@dataclass(frozen=True, slots=True, eq=False)
class RobotGeometry:
    """A serial arm of n revolute joints with capsules around its links.

    alpha, d, r: (n,) rad, m, m: modified Denavit-Hartenberg rows; frame i follows from frame i-1 by Rx(alpha), the
    translation (d, -sin(alpha) r, cos(alpha) r) and Rz(q_i). base: (4, 4) pose of frame 0 in the base frame, whose z
    = 0 is the mounting face. bending_joints: those that fold the arm (counted from 1); the others turn it about its
    own line.
    """

    robot: str
    alpha: FloatArray
    d: FloatArray
    r: FloatArray
    base: FloatArray
    bending_joints: tuple[int, ...]
    capsules: tuple[Capsule, ...]

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return int(self.alpha.size)

    def with_tool(self, length_m: float, radius_m: float) -> RobotGeometry:
        """The same arm with a tool: a capsule on the last link from the flange (0.126 m from the wrist) outwards."""
        tool = Capsule(self.joint_count, TOOL, (0.0, 0.0, FLANGE_M), (0.0, 0.0, FLANGE_M + length_m), radius_m)
        return replace(self, capsules=(*self.capsules, tool))

    def link_poses(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (N, n+1, 3, 3) and origins (N, n+1, 3) m of the base and of all link frames for positions (N, n)
        rad.
        """
        count, n = positions.shape
        rotations = np.empty((count, n + 1, 3, 3))
        origins = np.empty((count, n + 1, 3))
        rotations[:, 0] = np.eye(3)
        origins[:, 0] = 0.0
        rotation = np.broadcast_to(self.base[:3, :3], (count, 3, 3))
        origin = np.broadcast_to(self.base[:3, 3], (count, 3))
        for i in range(n):
            ca, sa = math.cos(self.alpha[i]), math.sin(self.alpha[i])
            c, s = np.cos(positions[:, i]), np.sin(positions[:, i])
            step = np.zeros((count, 3, 3))
            step[:, 0, 0], step[:, 0, 1] = c, -s
            step[:, 1, 0], step[:, 1, 1], step[:, 1, 2] = ca * s, ca * c, -sa
            step[:, 2, 0], step[:, 2, 1], step[:, 2, 2] = sa * s, sa * c, ca
            offset = np.array([self.d[i], -sa * self.r[i], ca * self.r[i]])
            origin = origin + rotation @ offset
            rotation = rotation @ step
            rotations[:, i + 1] = rotation
            origins[:, i + 1] = origin
        return rotations, origins

    def tip_path(self, positions: FloatArray) -> FloatArray:
        """Where the end of the tool is, or the flange where there is none, (N, 3) m, for positions (N, n) rad."""
        tip = next((c.end_m for c in self.capsules if c.part == TOOL), (0.0, 0.0, FLANGE_M))
        rotations, origins = self.link_poses(positions)
        path: FloatArray = origins[:, -1] + rotations[:, -1] @ np.array(tip)
        return path

    def reach(self, capsule: Capsule) -> FloatArray:
        """(n,) m: for each joint, a bound on the distance from its axis to any point of the capsule; 0 beyond its link.

        A turn of joint j by dq moves no point of the capsule by more than reach[j] |dq|, whatever the other joints do.
        """
        reach = np.zeros(self.joint_count)
        distance = capsule.extent_m
        if capsule.part == TOOL:
            distance = math.hypot(distance, capsule.radius_m)  # to the rim of the cylinder that it is taken for
        for j in range(capsule.link - 1, -1, -1):
            # The origin of frame j lies on the axis of joint j, so the chain from there to the capsule is a bound.
            reach[j] = distance
            distance += math.hypot(float(self.d[j]), float(self.r[j]))
        return reach


def load_geometry(robot: str) -> RobotGeometry:
    """Geometry of "iiwa14" or "iiwa7" as shipped. Raises GeometryError for another name or a damaged file."""
    known = sorted(
        entry.name[len("geometry_") : -len(".json")]
        for entry in resources.files("safety").iterdir()
        if entry.name.startswith("geometry_") and entry.name.endswith(".json")
    )
    if robot not in known:
        raise GeometryError(
            f"There is no collision geometry for a robot named {robot!r}; known are {', '.join(known)}."
        )
    file = f"geometry_{robot}.json"
    try:
        return _parse(json.loads(resources.files("safety").joinpath(file).read_text(encoding="utf-8")))
    except (KeyError, TypeError, ValueError) as error:
        raise GeometryError(f"The geometry file {file} cannot be used: {error!r}.") from error


def _parse(data: dict[str, Any]) -> RobotGeometry:
    rows = data["links"]
    yaw = float(data["base_yaw_rad"])
    base = np.eye(4)
    base[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    base[2, 3] = float(data["base_height_m"])
    capsules = tuple(
        Capsule(int(c["link"]), str(c["part"]), _point(c["start_m"]), _point(c["end_m"]), float(c["radius_m"]))
        for c in data["capsules"]
    )
    for capsule in capsules:
        if not 0 <= capsule.link <= len(rows):
            raise GeometryError(
                f"The capsule {capsule.part!r} sits on link {capsule.link}, but there are {len(rows)} links."
            )
    return RobotGeometry(
        str(data["robot"]),
        np.array([float(row["alpha_rad"]) for row in rows]),
        np.array([float(row["d_m"]) for row in rows]),
        np.array([float(row["r_m"]) for row in rows]),
        base,
        tuple(int(joint) for joint in data["bending_joints"]),
        capsules,
    )


def _point(values: list[float]) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)
