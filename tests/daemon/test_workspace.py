"""Claims about the workspace file: what it says is what the preflight gets, and every mistake is named by its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daemon.errors import ConfigurationError, MissingInputError
from daemon.motion.workspace import load_surroundings
from safety.collision import workspace_clearances

WHOLE = """
floor_height_m: -0.75
walls:
  - {name: fence, normal: [2, 0, 0], offset_m: -0.8}
boxes:
  - {name: camera post, center_m: [0.7, 0.4, 0.9], size_m: [0.1, 0.1, 1.8], yaw_rad: 0.2}
tool: {length_m: 0.2, radius_m: 0.05}
margins: {self_collision_m: 0.03, workspace_m: 0.05}
"""


def written(folder: Path, text: str) -> Path:
    file = folder / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_everything_in_the_file_reaches_the_preflight(tmp_path: Path) -> None:
    found = load_surroundings("iiwa14", written(tmp_path, WHOLE))
    assert [plane.name for plane in found.workspace.planes()] == ["floor", "fence"]
    assert found.workspace.walls[0].normal == (1.0, 0.0, 0.0)
    assert found.workspace.boxes[0].yaw_rad == 0.2
    assert (found.margins.self_collision_m, found.margins.workspace_m) == (0.03, 0.05)
    # Straight up, the tool ends 0.2 m above the flange at 1.306 m and the floor is 0.75 m below the base.
    nearest = {c.second: c for c in workspace_clearances(np.zeros((1, 7)), found.geometry, found.workspace)}
    assert set(nearest) == {"floor", "fence", "camera post"}
    top = max(capsule.extent_m for capsule in found.geometry.capsules if capsule.part == "tool")
    assert top == pytest.approx(0.126 + 0.2 + 0.05)


def test_without_a_file_there_is_a_floor_at_the_mounting_face() -> None:
    assert load_surroundings("iiwa14").workspace.planes()[0].offset_m == 0.0


def test_null_takes_the_floor_away(tmp_path: Path) -> None:
    assert load_surroundings("iiwa7", written(tmp_path, "floor_height_m: null\n")).workspace.planes() == ()


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("flor: 1\n", "flor"),
        ("floor_height_m: low\n", "floor_height_m"),
        ("floor_height_m: .nan\n", "floor_height_m"),
        ("walls:\n- {name: a, normal: [0, 0, 0], offset_m: 0}\n", "walls[0]"),
        ("walls:\n- {name: a, normal: [1, 0], offset_m: 0}\n", "walls"),
        ("walls:\n- {name: floor, normal: [1, 0, 0], offset_m: 0}\n", "walls[0]"),
        # Judged by name: in the stops such a box was held against the smaller margin of two links.
        ("boxes:\n- {name: link 7, center_m: [1, 0, 0], size_m: [1, 1, 1]}\n", "boxes[0]"),
        ("boxes:\n- {name: a, center_m: [0, 0, 0], size_m: [1, 1, 0]}\n", "boxes[0]"),
        ("boxes:\n- {name: a, center_m: [0, 0, 0], size_m: [1, 1, 1], colour: red}\n", "colour"),
        ("tool: {length_m: 0.1, radius_m: -1}\n", "tool"),
        ("tool: {length_m: .inf, radius_m: 1}\n", "tool"),
        ("margins: {workspace_m: -0.1}\n", "margins.workspace_m"),
        ("floor_height_m: -750\n", "floor_height_m"),
        ("walls:\n- {name: in mm, normal: [1, 0, 0], offset_m: -800}\n", "walls[0]"),
        ("boxes:\n- {name: in mm, center_m: [700, 400, 900], size_m: [100, 100, 1800]}\n", "boxes[0]"),
        ("boxes:\n- {name: in degrees, center_m: [1, 0, 0], size_m: [1, 1, 1], yaw_rad: 45}\n", "boxes[0]"),
        ("walls:\n- {name: a, normal: [1, 0, 0], offset_m: -1}\nfloor_height_m: 0\nwalls: []\n", "walls"),
        ("tool: {mass_kg: 9, center_of_mass_m: [0, 0, 0.1], mass_kg: 0}\n", "mass_kg"),
    ],
)
def test_a_mistake_is_refused_with_file_and_place(text: str, field: str, tmp_path: Path) -> None:
    file = written(tmp_path, text)
    with pytest.raises(ConfigurationError) as refusal:
        load_surroundings("iiwa14", file)
    assert refusal.value.exit_code == 78
    assert str(file) in str(refusal.value)
    assert field in str(refusal.value)


def test_a_file_that_is_not_there_is_missing_input(tmp_path: Path) -> None:
    with pytest.raises(MissingInputError, match="workspace"):
        load_surroundings("iiwa14", tmp_path / "none.yaml")


def test_a_box_that_is_far_away_but_reaches_here_counts(tmp_path: Path) -> None:
    text = "boxes:\n- {name: hall, center_m: [12, 0, 0], size_m: [22, 22, 22]}\n"
    assert load_surroundings("iiwa14", written(tmp_path, text)).workspace.boxes[0].name == "hall"
