"""The arm's kinematics and shape, against the public URDF chain of the iiwa, which is written out here."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from safety.errors import GeometryError
from safety.geometry import Capsule, load_geometry
from safety.limits import IIWA14_R820
from tests.reference import TABLES


def _rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


# Joint origins (xyz, rpy) of the iiwa 14 in Drake's manipulation/models/iiwa_description; all joints turn about z.
URDF_IIWA14 = [
    ((0, 0, 0.1575), (0, 0, 0)),
    ((0, 0, 0.2025), (np.pi / 2, 0, np.pi)),
    ((0, 0.2045, 0), (np.pi / 2, 0, np.pi)),
    ((0, 0, 0.2155), (np.pi / 2, 0, 0)),
    ((0, 0.1845, 0), (-np.pi / 2, np.pi, 0)),
    ((0, 0, 0.2155), (np.pi / 2, 0, 0)),
    ((0, 0.081, 0), (-np.pi / 2, np.pi, 0)),
]


def _urdf_poses(q: np.ndarray) -> list[np.ndarray]:
    pose, poses = np.eye(4), [np.eye(4)]
    for (xyz, rpy), angle in zip(URDF_IIWA14, q, strict=True):
        step = np.eye(4)
        step[:3, :3] = _rpy(*rpy) @ _rpy(0, 0, angle)
        step[:3, 3] = xyz
        pose = pose @ step
        poses.append(pose)
    return poses


def test_the_flange_is_where_the_public_urdf_puts_it() -> None:
    generator = np.random.default_rng(7)
    geometry = load_geometry("iiwa14")
    for q in generator.uniform(-2, 2, (20, 7)):
        rotations, origins = geometry.link_poses(q[None])
        expected = _urdf_poses(q)[7] @ [0, 0, 0.045, 1]
        flange = origins[0, 7] + rotations[0, 7] @ [0, 0, 0.126]
        assert flange == pytest.approx(expected[:3], abs=1e-12)


def test_every_capsule_follows_its_link_of_the_public_urdf() -> None:
    """A capsule is fixed to its link: seen from the URDF's link frame its ends do not move with the joints."""
    geometry = load_geometry("iiwa14")
    generator = np.random.default_rng(8)
    seen: dict[str, np.ndarray] = {}
    for q in [np.zeros(7), *generator.uniform(-2, 2, (5, 7))]:
        rotations, origins = geometry.link_poses(q[None])
        for capsule in geometry.capsules:
            world = origins[0, capsule.link] + rotations[0, capsule.link] @ np.array(capsule.end_m)
            local = np.linalg.inv(_urdf_poses(q)[capsule.link]) @ [*world, 1.0]
            assert local == pytest.approx(seen.setdefault(capsule.part, local), abs=1e-12)
    # The housing of link 2 leans to +z of the URDF's frame, the thin part of the forearm to +y (Drake's sphere model).
    assert seen["shoulder cover"][2] == pytest.approx(0.045)
    assert seen["forearm, thin part"][1] == pytest.approx(0.06)


def test_the_capsules_enclose_the_public_sphere_model() -> None:
    """Spheres of Drake's dense model of the iiwa 14, in URDF link frames, stay within 15 mm of our capsules.

    A sphere at the far end of a link reaches into the next one round their common axis, so that one may cover it.
    """
    spheres = {
        0: [((0, 0, 0.03), 0.12), ((-0.08, 0, 0.103), 0.08), ((0, 0, 0.14), 0.1)],
        1: [((0, 0, -0.0005), 0.08), ((0, -0.045, 0.1025), 0.07)],
        2: [((0, 0, -0.01), 0.095), ((0, 0.13, 0.02), 0.065), ((0, 0.18, 0), 0.075)],
        3: [((0, 0, 0.0355), 0.075), ((0, 0.056, 0.1755), 0.06), ((0, 0.045, 0.2155), 0.075)],
        4: [((0, 0.01, 0.046), 0.078), ((0, 0.184, 0), 0.075)],
        5: [((0, 0, 0.0335), 0.075), ((0, 0.065, 0.1655), 0.04)],
        6: [((0, 0, -0.059), 0.055), ((0, -0.03, 0.011), 0.065), ((0, 0, 0), 0.08)],
        7: [((0, 0, 0.001), 0.06)],
    }
    geometry = load_geometry("iiwa14")
    generator = np.random.default_rng(10)
    for q in [np.zeros(7), *generator.uniform(IIWA14_R820.position_lower, IIWA14_R820.position_upper, (20, 7))]:
        rotations, origins = geometry.link_poses(q[None])
        urdf = _urdf_poses(q)
        for link, listed in spheres.items():
            for center, radius in listed:
                point = (urdf[link] @ [*center, 1.0])[:3]
                sticks_out = min(
                    _distance_to_segment(point, *_ends(rotations, origins, capsule)) + radius - capsule.radius_m
                    for capsule in geometry.capsules
                    if capsule.link in (link, link + 1)
                )
                assert sticks_out < 0.015, (link, center, sticks_out)


def _ends(rotations: np.ndarray, origins: np.ndarray, capsule: Capsule) -> tuple[np.ndarray, np.ndarray]:
    rotation, origin = rotations[0, capsule.link], origins[0, capsule.link]
    return origin + rotation @ np.array(capsule.start_m), origin + rotation @ np.array(capsule.end_m)


def _distance_to_segment(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    share = np.clip((point - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    return float(np.linalg.norm(point - start - share * (end - start)))


def test_the_shipped_table_is_the_papers() -> None:
    geometry = load_geometry("iiwa14")
    angles = {"0": 0.0, "pi/2": np.pi / 2, "-pi/2": -np.pi / 2}
    with (TABLES / "table1_mdh.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert geometry.alpha == pytest.approx([angles[row["alpha_rad"]] for row in rows])
    assert geometry.d == pytest.approx([float(row["d_m"]) for row in rows])
    assert geometry.r == pytest.approx([float(row["rl_m"]) for row in rows])


@pytest.mark.parametrize("robot", ["iiwa14", "iiwa7"])
def test_no_point_moves_further_than_its_reach_allows(robot: str) -> None:
    geometry = load_geometry(robot)
    generator = np.random.default_rng(9)
    start = generator.uniform(IIWA14_R820.position_lower, IIWA14_R820.position_upper, (300, 7))
    step = generator.uniform(-0.05, 0.05, (300, 7))
    before, after = geometry.link_poses(start), geometry.link_poses(start + step)
    for capsule in geometry.capsules:
        bound = np.abs(step) @ geometry.reach(capsule)
        for end in (capsule.start_m, capsule.end_m):
            ends = [pose[1][:, capsule.link] + pose[0][:, capsule.link] @ np.array(end) for pose in (before, after)]
            assert np.all(np.linalg.norm(ends[1] - ends[0], axis=1) <= bound + 1e-12)


def test_a_tool_begins_at_the_flange_and_reaches_its_length() -> None:
    tool = load_geometry("iiwa14").with_tool(0.2, 0.05).capsules[-1]
    assert (tool.link, tool.start_m[2], tool.end_m[2]) == (7, 0.126, pytest.approx(0.326))


def test_an_unknown_robot_and_an_impossible_capsule_are_refused() -> None:
    with pytest.raises(GeometryError, match="iiwa14, iiwa7"):
        load_geometry("../../etc/passwd")
    with pytest.raises(GeometryError, match="'tool' of link 7"):
        load_geometry("iiwa14").with_tool(0.1, -0.05)
