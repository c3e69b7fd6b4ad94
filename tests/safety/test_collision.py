"""Distances against a segment-to-segment search of our own, and the bound between samples against denser paths."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from safety.collision import (
    ForbiddenBox,
    Plane,
    Workspace,
    self_clearances,
    self_collision_pairs,
    workspace_clearances,
)
from safety.errors import GeometryError
from safety.geometry import Capsule, RobotGeometry, load_geometry
from safety.limits import IIWA14_R820

GEOMETRY = load_geometry("iiwa14")


def _points(geometry: RobotGeometry, capsule: Capsule, q: np.ndarray, count: int = 401) -> np.ndarray:
    rotations, origins = geometry.link_poses(q[None])
    start, end = np.array(capsule.start_m), np.array(capsule.end_m)
    local = start + np.linspace(0, 1, count)[:, None] * (end - start)
    points: np.ndarray = origins[0, capsule.link] + local @ rotations[0, capsule.link].T
    return points


def _brute_force(q: np.ndarray, links: tuple[int, int]) -> float:
    """Smallest distance of two links from many points on the capsules' axes: an upper bound within 1 mm."""
    best = np.inf
    for a in (c for c in GEOMETRY.capsules if c.link == links[0]):
        for b in (c for c in GEOMETRY.capsules if c.link == links[1]):
            gaps = np.linalg.norm(_points(GEOMETRY, a, q)[:, None] - _points(GEOMETRY, b, q)[None], axis=2)
            best = min(best, float(gaps.min()) - a.radius_m - b.radius_m)
    return best


def test_straight_up_is_free_of_collision() -> None:
    found = self_clearances(np.zeros((1, 7)), GEOMETRY)
    assert found[0].distance_m > 0.1
    assert workspace_clearances(np.zeros((1, 7)), GEOMETRY, Workspace())[0].distance_m > 0.1


def test_distances_equal_a_brute_force_search() -> None:
    generator = np.random.default_rng(11)
    for q in generator.uniform(IIWA14_R820.position_lower, IIWA14_R820.position_upper, (6, 7)):
        for clearance in self_clearances(q[None], GEOMETRY):
            links = (int(clearance.first[5:]), int(clearance.second[5:]))
            assert clearance.distance_m == pytest.approx(_brute_force(q, links), abs=1e-3)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_folding_shoulder_and_elbow_to_opposite_sides_brings_the_wrist_to_the_base(side: float) -> None:
    """A2 and A4 turn about opposite axes at rest, so angles of opposite sign fold both bends the same way."""
    opened = self_clearances(np.zeros((1, 7)), GEOMETRY)
    distances = []
    for share in (0.4, 0.7, 0.85, 1.0):
        folded = np.array([[0.0, side * 1.8, 0.0, -side * 2.09, 0.0, -side * 1.7, 0.0]]) * share
        distances.append(next(c.distance_m for c in self_clearances(folded, GEOMETRY) if c.pair == "link 0 - link 6"))
    assert distances == sorted(distances, reverse=True)
    assert distances[-1] < 0.0 < 0.1 < opened[0].distance_m


def test_pairs_have_two_bending_joints_between_them() -> None:
    pairs = self_collision_pairs(GEOMETRY)
    assert (0, 7) in pairs
    assert (1, 4) in pairs
    for neighbours in ((3, 4), (2, 4), (5, 7), (0, 3), (4, 7), (2, 5)):
        assert neighbours not in pairs


@pytest.mark.parametrize(("length", "radius"), [(0.2, 0.08), (0.02, 0.1)])
def test_a_wide_tool_is_held_off_the_forearm_that_one_bending_joint_folds_it_to(length: float, radius: float) -> None:
    """Truth: points on the rim and the axis of the flange's face and of what lies before it, to the housings' axes."""
    geometry = GEOMETRY.with_tool(length, radius)
    around = np.linspace(0.0, 2.0 * np.pi, 73)[:, None]
    rings = [
        np.column_stack([share * radius * np.cos(around), share * radius * np.sin(around), np.full((73, 1), z)])
        for z in np.linspace(0.126, 0.126 + length + radius, 13)
        for share in np.linspace(0.0, 1.0, 5)
    ]
    local = np.concatenate(rings)
    for bend in (-2.09, 1.2, 2.09):
        q = np.array([0.3, -0.5, 0.2, 0.9, 1.1, bend, -0.7])
        rotations, origins = geometry.link_poses(q[None])
        tool = origins[0, 7] + local @ rotations[0, 7].T
        found = {clearance.pair: clearance for clearance in self_clearances(q[None], geometry)}
        for link in (4, 5):
            near = min(
                np.linalg.norm(tool[:, None] - _points(geometry, part, q, 61)[None], axis=2).min() - part.radius_m
                for part in geometry.capsules
                if part.link == link
            )
            # Where they overlap, the depth is measured along another way.
            if near > 0.0:
                assert found[f"link {link} - link 7"].distance_m == pytest.approx(near, abs=3e-3)
            else:
                assert found[f"link {link} - link 7"].distance_m < 0.0
    assert not {"link 5 - link 7", "link 4 - link 7"} & {each.pair for each in self_clearances(q[None], GEOMETRY)}


def test_the_guaranteed_distance_holds_on_a_denser_path() -> None:
    """A coarse path's bound is below what any point between its samples shows; the fine path is the witness."""
    generator = np.random.default_rng(12)
    for _ in range(5):
        corners = generator.uniform(0.7 * IIWA14_R820.position_lower, 0.7 * IIWA14_R820.position_upper, (4, 7))
        coarse = np.vstack([np.linspace(a, b, 15) for a, b in pairwise(corners)])
        fine = np.vstack([np.linspace(a, b, 40) for a, b in pairwise(coarse)])
        box = ForbiddenBox("post", (0.5, 0.2, 0.6), (0.1, 0.1, 1.2))
        workspace = Workspace(boxes=(box,), walls=(Plane("wall", (0.0, -1.0, 0.0), -0.9),))
        for search in (
            lambda path: self_clearances(path, GEOMETRY),
            lambda path, w=workspace: workspace_clearances(path, GEOMETRY, w),
        ):
            truth = {c.pair: c.distance_m for c in search(fine)}
            for clearance in search(coarse):
                assert clearance.guaranteed_m <= truth[clearance.pair] + 1e-9
                assert clearance.distance_m >= truth[clearance.pair] - 1e-3


def test_a_joint_that_turns_round_between_two_samples_is_covered_by_its_turn() -> None:
    """A2 dips towards the floor and back within one sample: both samples look alike, only the turn bound knows."""
    period = 0.1
    acceleration = float(IIWA14_R820.acceleration[1])
    turn = IIWA14_R820.acceleration * period**2 / 4.0

    def path(times: np.ndarray) -> np.ndarray:
        q = np.zeros((times.size, 7))
        q[:, 1] = 1.6 - 0.5 * acceleration * times**2
        return q

    coarse = path(np.array([-0.5, 0.5]) * period)
    witness = path(np.linspace(-0.05, 0.05, 201))
    truth = {c.pair: c.distance_m for c in workspace_clearances(witness, GEOMETRY, Workspace())}
    without = {c.pair: c.guaranteed_m for c in workspace_clearances(coarse, GEOMETRY, Workspace())}
    covered = {c.pair: c.guaranteed_m for c in workspace_clearances(coarse, GEOMETRY, Workspace(), turn_rad=turn)}
    assert without["link 7 - floor"] > truth["link 7 - floor"] + 0.005
    assert all(covered[pair] <= truth[pair] for pair in truth)


def test_leaping_over_samples_finds_the_same_minimum_within_a_millimetre() -> None:
    t = np.arange(2000) * 1e-3
    generator = np.random.default_rng(13)
    path = 1.5 * np.sin(2 * np.pi * 0.5 * t[:, None] + generator.uniform(0, 6, 7))
    every_row = np.array([self_clearances(row[None], GEOMETRY)[0].distance_m for row in path[::5]])
    found = self_clearances(path, GEOMETRY)[0]
    assert found.distance_m == pytest.approx(every_row.min(), abs=2e-3)
    assert found.distance_m - found.guaranteed_m < 5e-3


def test_a_pose_that_reaches_below_the_floor_has_a_negative_distance() -> None:
    stretched = np.zeros((1, 7))
    stretched[0, 1] = 2.05  # A2 lays the straight arm down past the horizontal: 117 degrees from straight up
    found = workspace_clearances(stretched, GEOMETRY, Workspace())[0]
    assert (found.first, found.second) == ("link 7", "floor")
    # Flange centre: shoulder height 0.36 m + 0.946 m * cos(2.05 rad) = -0.076 m.
    assert found.distance_m < -0.07
    assert workspace_clearances(stretched, GEOMETRY, Workspace(floor_height_m=None)) == ()
    assert workspace_clearances(stretched, GEOMETRY, Workspace(floor_height_m=-0.5))[0].distance_m > 0.3


def test_a_box_in_front_of_the_base_is_in_front() -> None:
    """A2 = +90 degrees lays the arm along +x of KUKA's base frame, so a box there is hit and one behind is not."""
    forwards = np.zeros((1, 7))
    forwards[0, 1] = np.pi / 2
    in_front = ForbiddenBox("front", (0.8, 0.0, 0.36), (0.1, 0.1, 0.1))
    behind = ForbiddenBox("back", (-0.8, 0.0, 0.36), (0.1, 0.1, 0.1))
    found = workspace_clearances(forwards, GEOMETRY, Workspace(floor_height_m=None, boxes=(in_front, behind)))
    distances = {c.second: c.distance_m for c in reversed(found)}
    assert distances["front"] < 0.0 < 0.5 < distances["back"]


def test_impossible_workspaces_and_paths_are_refused() -> None:
    with pytest.raises(GeometryError, match="normal of length 1"):
        Plane("wall", (1.0, 1.0, 0.0), 0.0)
    with pytest.raises(GeometryError, match="edges above 0 m"):
        ForbiddenBox("box", (0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    with pytest.raises(GeometryError, match=r"shape \(3, 6\)"):
        self_clearances(np.zeros((3, 6)), GEOMETRY)
    with pytest.raises(GeometryError, match="not finite"):
        self_clearances(np.full((1, 7), np.nan), GEOMETRY)
