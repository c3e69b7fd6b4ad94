"""Room to move: how near a motion comes to floor, walls, boxes and its own links, differentiable, for the design.

Here: a penalty that the search of an excitation adds to its objective, and the judge of what it found, the preflight.
The penalty takes capsules as rows of balls and needs to be about right only: what counts is the preflight, which
measures capsules and proves what lies between samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daemon.motion.preparation import LEAD_IN_S, TABLE_RATE_HZ, check_table
from daemon.motion.torque_foresight import torque_foresight
from daemon.motion.workspace import Surroundings
from identification.arrays import FloatArray
from identification.excitation.fourier import Trajectory
from identification.excitation.objective import Samples
from identification.robots import Installation
from identification.robots.installation import ON_THE_FLOOR
from safety.collision import ForbiddenBox, Workspace, self_collision_pairs
from safety.geometry import RobotGeometry

_STOPPING_ROOM_M = 0.18
"""Beyond the margins: what stops add, and the proof between stops (150 mm at the speeds of a full excitation)."""
_STEEPNESS = 300.0
_START_ROWS = np.linspace(0.0, 1.0, 9)[:-1]


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """The penalty k · mean over samples of Σ max(0, 1 − d / d_wanted)², d the distances of balls and obstacles, m.

    The tool beside forearm and elbow is left to the preflight: they are nearer than d_wanted at most angles of A6.

    wanted_m: distance from floor, walls and boxes; wanted_self_m: between links. start: (n,) rad, where the arm stands
    before the motion, None for anywhere; the straight way from there to the row where the start ramp ends is kept free.
    start_share: of the period, where that row lies.
    """

    geometry: RobotGeometry
    workspace: Workspace
    wanted_m: float
    wanted_self_m: float
    start: FloatArray | None
    start_share: float

    def __call__(self, samples: Samples) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """A term of the search: value, and gradients in the regressor (none), position and velocity (none)."""
        position = samples.position
        count = len(position)
        value, gradient = self.penalty(position)
        if self.start is not None:
            row = round(self.start_share * count) % count
            way = self.start + _START_ROWS[:, None] * (position[row] - self.start)
            further, slope = self.penalty(way)
            value += further
            gradient[row] += _START_ROWS @ slope
        return value, np.zeros_like(samples.matrix), gradient, np.zeros_like(samples.velocity)

    def penalty(self, position: FloatArray) -> tuple[float, FloatArray]:
        """Value, and its gradient (S, n), of positions (S, n) rad."""
        rotations, origins = self.geometry.link_poses(position)
        links, radii, centers = self._balls(rotations, origins)
        force = np.zeros_like(centers)  # gradient in the balls' centres
        value = 0.0
        moving = links >= self.workspace.first_link
        for plane in self.workspace.planes():
            normal = np.array(plane.normal)
            distance = centers[:, moving] @ normal - radii[moving] - plane.offset_m
            lack = np.maximum(1.0 - distance / self.wanted_m, 0.0)
            value += float(np.sum(lack**2))
            force[:, moving] -= (2.0 / self.wanted_m) * lack[..., None] * normal
        for box in self.workspace.boxes:
            distance, direction = _box_distance(centers[:, moving], box)
            lack = np.maximum(1.0 - (distance - radii[moving]) / self.wanted_m, 0.0)
            value += float(np.sum(lack**2))
            force[:, moving] -= (2.0 / self.wanted_m) * lack[..., None] * direction
        between, thick = self._pairs(links, radii)
        apart = np.einsum("kb,sbi->ski", between, centers, optimize=True)
        length = np.linalg.norm(apart, axis=-1)
        lack = np.maximum(1.0 - (length - thick) / self.wanted_self_m, 0.0)
        value += float(np.sum(lack**2))
        push = (2.0 / self.wanted_self_m) * lack[..., None] * apart / np.maximum(length, 1e-9)[..., None]
        force -= np.einsum("kb,ski->sbi", between, push, optimize=True)
        gradient = np.zeros_like(position)
        for joint in range(position.shape[1]):
            beyond = links > joint
            arm = centers[:, beyond] - origins[:, None, joint + 1]
            turned = np.cross(arm, force[:, beyond]).sum(axis=1)
            gradient[:, joint] = np.einsum("si,si->s", rotations[:, joint + 1, :, 2], turned)
        scale = _STEEPNESS / len(position)
        return scale * value, scale * gradient

    def _balls(self, rotations: FloatArray, origins: FloatArray) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """Links (B,), radii (B,) and centres (S, B, 3) of balls along the capsules, no further apart than a radius."""
        links, radii, centers = [], [], []
        for capsule in self.geometry.capsules:
            start, end = np.array(capsule.start_m), np.array(capsule.end_m)
            count = 1 + int(np.ceil(np.linalg.norm(end - start) / capsule.radius_m))
            for share in np.linspace(0.0, 1.0, count):
                links.append(capsule.link)
                radii.append(capsule.radius_m)
                point = start + share * (end - start)
                centers.append(origins[:, capsule.link] + rotations[:, capsule.link] @ point)
        return np.array(links), np.array(radii), np.stack(centers, axis=1)

    def _pairs(self, links: NDArray[np.int64], radii: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pairs of balls of links held against each other: (K, B) with 1 and −1, and the sums of their radii (K,)."""
        rows = []
        for one, other in self_collision_pairs(self.geometry):
            first, second = np.meshgrid(np.flatnonzero(links == one), np.flatnonzero(links == other))
            block = np.zeros((first.size, len(links)))
            block[np.arange(first.size), first.ravel()] = -1.0
            block[np.arange(first.size), second.ravel()] = 1.0
            rows.append(block)
        between = np.vstack(rows)
        return between, np.abs(between) @ radii


def _box_distance(points: FloatArray, box: ForbiddenBox) -> tuple[FloatArray, FloatArray]:
    """Signed distances of points (..., 3) from a box, m, and the unit directions away from it."""
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    inside_out = (points - np.array(box.center_m)) @ turn
    beyond = np.abs(inside_out) - 0.5 * np.array(box.size_m)
    outer = np.maximum(beyond, 0.0)
    length = np.linalg.norm(outer, axis=-1)
    nearest = np.eye(3)[np.argmax(beyond, axis=-1)]
    inner = np.where((length > 0.0)[..., None], outer / np.maximum(length, 1e-12)[..., None], nearest)
    sign = np.where(inside_out < 0.0, -1.0, 1.0)
    distance = np.where(length > 0.0, length, np.max(beyond, axis=-1))
    return distance, (inner * sign) @ turn.T


def room_of(around: Surroundings, start: FloatArray | None, period_s: float) -> Room:
    """The penalty for a cell, with room for stops beside the margins."""
    return Room(
        around.geometry,
        around.workspace,
        around.margins.workspace_m + _STOPPING_ROOM_M,
        around.margins.self_collision_m + _STOPPING_ROOM_M,
        start,
        1.0 - LEAD_IN_S / period_s,
    )


def safe_in(
    around: Surroundings, robot: str, start: FloatArray | None, installation: Installation = ON_THE_FLOOR
) -> Callable[[Trajectory], bool]:
    """Whether the preflight accepts a trajectory in a cell, its start ramp from `start` included."""
    foresight = torque_foresight(robot, None, around.tool, installation)
    return lambda trajectory: check_table(trajectory.table(TABLE_RATE_HZ), robot, around, foresight, start=start).safe
