"""Claims about room to move: the penalty sees what the preflight measures, and the docs' example cell gets a motion.

Truth: central differences, distances by coal as the preflight takes them, and the preflight's own verdict.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daemon.motion.clearance import Room, room_of, safe_in
from daemon.motion.workspace import load_surroundings
from identification.excitation import default_trajectory, iiwa_limits
from identification.excitation.design import design_excitation
from identification.excitation.local_search import DesignSettings, Stage
from identification.robots import load_robot
from safety.collision import self_clearances, tool_pairs, workspace_clearances

CELL = """
floor_height_m: -0.75
walls:
  - {name: fence, normal: [1, 0, 0], offset_m: -0.8}
boxes:
  - {name: camera post, center_m: [0.7, 0.4, 0.9], size_m: [0.1, 0.1, 1.8], yaw_rad: 0.3}
tool: {length_m: 0.2, radius_m: 0.05}
margins: {self_collision_m: 0.02, workspace_m: 0.02}
"""


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """The example of docs/limits.md; a test keeps it the same but for the box's turn."""
    file = tmp_path / "cell.yaml"
    file.write_text(CELL)
    return file


def test_the_cell_of_these_tests_is_the_one_of_the_docs() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "limits.md").read_text()
    for line in CELL.strip().replace("yaw_rad: 0.3", "yaw_rad: 0.0").splitlines():
        assert line.split("#")[0].strip() in page


def test_the_penalty_has_the_gradient_of_its_differences(cell: Path) -> None:
    generator = np.random.default_rng(5)
    position = np.array([0.5, 1.2, 0.0, -0.5, 0.0, 0.4, 0.0]) + generator.uniform(-0.2, 0.2, (4, 7))
    room = room_of(load_surroundings("iiwa14", cell), None, 10.0)
    value, gradient = room.penalty(position)
    assert value > 0.0
    for sample, joint in ((0, 0), (1, 1), (2, 3), (3, 5), (0, 2), (1, 6)):
        step = np.zeros_like(position)
        step[sample, joint] = 1e-6
        slope = (room.penalty(position + step)[0] - room.penalty(position - step)[0]) / 2e-6
        assert gradient[sample, joint] == pytest.approx(slope, rel=1e-4, abs=1e-4 * np.abs(gradient).max())


def test_no_penalty_means_the_distances_that_the_preflight_measures_are_kept(cell: Path) -> None:
    around = load_surroundings("iiwa14", cell)
    room = room_of(around, None, 10.0)
    positions = np.random.default_rng(1).uniform(-1.5, 1.5, (60, 7))
    free = np.array([room.penalty(position[None])[0] == 0.0 for position in positions])
    assert 5 < free.sum() < 55
    for position in positions[free]:
        outer = workspace_clearances(position[None], around.geometry, around.workspace)
        beside = {f"link {i} - link {j}" for i, j in tool_pairs(around.geometry)}  # left to the preflight
        own = [each for each in self_clearances(position[None], around.geometry) if each.pair not in beside]
        # Balls no further apart than a radius: a capsule is at most 14 % of its radius thicker between them.
        assert min(each.distance_m for each in outer) > room.wanted_m - 0.03
        assert min(each.distance_m for each in own) > room.wanted_self_m - 0.04


def test_the_way_from_the_start_pose_counts_too(cell: Path) -> None:
    around = load_surroundings("iiwa14", cell)
    free = room_of(around, None, 10.0)
    at_the_post = np.array([0.5, 1.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    bound = Room(free.geometry, free.workspace, free.wanted_m, free.wanted_self_m, at_the_post, 0.5)
    assert free.penalty(at_the_post[None])[0] > 0.0

    class Still:
        position = velocity = np.zeros((8, 7))
        matrix = np.zeros((8, 7, 3))

    assert free(Still())[0] == 0.0
    value, by_matrix, by_position, by_velocity = bound(Still())
    assert value > 0.0
    assert np.abs(by_position[4]).max() > 0.0
    assert not by_matrix.any()
    assert not by_velocity.any()
    assert not np.delete(by_position, 4, axis=0).any()


def test_the_docs_example_cell_gets_a_motion_at_full_amplitude(cell: Path) -> None:
    """The shipped motion hits its fence and its post."""
    around, robot = load_surroundings("iiwa14", cell), load_robot("iiwa14")
    pose = np.zeros(7)
    accepted = safe_in(around, "iiwa14", pose)
    shipped = workspace_clearances(default_trajectory().table(100.0), around.geometry, around.workspace)
    assert min(each.distance_m for each in shipped) < 0.0
    settings = DesignSettings(starts=1, processes=1, samples=32, stages=(Stage(1.0, 25, 1.0),), seed=3)
    result = design_excitation(
        robot, iiwa_limits("iiwa14"), settings, acceptable=accepted, room=room_of(around, pose, settings.period_s)
    )
    assert result.trajectory.record["settings"]["shrunk_to"] == 1.0
    assert result.cond < 300.0
