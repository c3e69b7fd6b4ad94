"""Claims about how a base stands, asked of recordings of real arms that stood level (shared/recordings)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.audit.mount import Mounting, mounting_of
from identification.recordings import read_recording
from identification.robots import Installation, load_robot

ARMS = {"ur10.npz": "ur10_mdh.csv", "tx40_excitation.npz": "tx40.urdf"}


def found(folder: Path, file: str, stated: Installation | None = None) -> Mounting:
    robot = folder / "recordings" / ARMS[file]
    result = mounting_of([read_recording(folder / "recordings" / file, robot=robot)], load_robot(robot, stated))
    assert result is not None
    return result


@pytest.mark.parametrize("file", ARMS)
def test_a_level_arm_is_found_level_within_one_degree(shared_folder: Path, file: str) -> None:
    level = found(shared_folder, file)
    assert np.degrees(level.angle) < 1.0
    assert not level.is_other


@pytest.mark.parametrize("file", ARMS)
def test_a_level_arm_that_is_said_to_hang_on_a_wall_is_told_so(shared_folder: Path, file: str) -> None:
    wall = found(shared_folder, file, Installation((9.81, 0.0, 0.0)))
    assert wall.is_other
    assert np.degrees(wall.angle) == pytest.approx(90.0, abs=1.0)
    assert "--mount auto" in wall.sentence
