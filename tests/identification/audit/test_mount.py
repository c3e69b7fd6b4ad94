"""Claims about how a base stands, asked of recordings of real arms that stood level (shared/recordings)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.audit.mount import Mounting, mounting_of
from identification.recordings import read_recording
from identification.robots import Installation, load_robot

ARMS = {"ur10.npz": "ur10_mdh.csv", "tx40_excitation.npz": "tx40.urdf", "panda_excitation.npz": "panda.urdf"}

OTHERS = {"kr300_a.npz": "kr300.urdf", "lbrmed7.npz": "med7dock.urdf"}


def found(folder: Path, file: str, stated: Installation | None = None) -> Mounting:
    robot = folder / "recordings" / {**ARMS, **OTHERS}[file]
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


def test_a_motion_of_half_a_radian_does_not_tell_how_the_base_stands(shared_folder: Path) -> None:
    undecided = found(shared_folder, "kr300_a.npz")
    assert not undecided.is_other
    assert "does not tell" in undecided.sentence


def test_the_lean_of_the_med_7_is_what_its_vertical_joint_feels(shared_folder: Path) -> None:
    # Level, gravity has no moment about joint 1; the 0.3 Nm that it carries need a lean of near 2 degrees.
    lean = found(shared_folder, "lbrmed7.npz")
    assert np.degrees(lean.angle) < 2.5
    assert lean.rms_found[0] < 0.3 * lean.rms_stated[0]
