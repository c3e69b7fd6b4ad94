"""Claims about the picture of a motion: the file is one, and what it shows can be read in it (SVG keeps its words)."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest
from PIL import Image

from daemon.errors import ConfigurationError, LogIOError
from daemon.motion.picture import draw_motion
from daemon.motion.preparation import PreparedMotion, prepare_motion, start_row_of
from safety.geometry import load_geometry
from safety.limits import limits_for
from safety.preflight import start_path


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> PreparedMotion:
    cell = tmp_path_factory.mktemp("cell") / "cell.yaml"
    cell.write_text(
        "floor_height_m: -0.3\nwalls: [{name: fence, normal: [0, 1, 0], offset_m: -0.5}]\n"
        "boxes: [{name: camera post, center_m: [0.7, 0.4, 0.4], size_m: [0.1, 0.1, 1.0], yaw_rad: 0.3}]\n"
    )
    return prepare_motion(None, amplitude=0.5, workspace=cell)


def test_an_svg_names_axes_units_limits_and_surroundings(motion: PreparedMotion, tmp_path: Path) -> None:
    with matplotlib.rc_context({"svg.fonttype": "none"}):
        draw_motion(motion, tmp_path / "path.svg")
    words = " ".join(ElementTree.parse(tmp_path / "path.svg").getroot().itertext())
    for word in ("x (m)", "y (m)", "z (m)", "time (s)", "(rad), limits dashed", "A1", "A7", "fence", "camera post"):
        assert word in words, word
    assert "amplitude 0.5" in words
    assert "arm as it sweeps" in words
    assert "start ramp" in words
    assert ("NOT safe" in words) is not motion.preflight.safe


def test_a_png_is_a_picture_that_is_not_empty(motion: PreparedMotion, tmp_path: Path) -> None:
    draw_motion(motion, tmp_path / "path.png")
    pixels = np.asarray(Image.open(tmp_path / "path.png").convert("L"))
    assert pixels.shape[0] > 900
    assert pixels.shape[1] > 1200
    assert 0.02 < float((pixels < 250).mean()) < 0.5


def test_other_formats_and_places_are_refused(motion: PreparedMotion, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"\.png or \.svg"):
        draw_motion(motion, tmp_path / "path.pdf")
    with pytest.raises(LogIOError):
        draw_motion(motion, tmp_path / "none" / "path.png")


def test_the_end_effector_stands_where_the_arm_ends() -> None:
    """Straight up: 0.36 + 0.42 + 0.4 + 0.126 m; A2 at 90 degrees lays 0.946 m along x at shoulder height."""
    geometry = load_geometry("iiwa14")
    poses = np.zeros((2, 7))
    poses[1, 1] = np.pi / 2
    assert geometry.tip_path(poses) == pytest.approx(np.array([[0, 0, 1.306], [0.946, 0, 0.36]]), abs=1e-9)
    assert geometry.with_tool(0.2, 0.05).tip_path(poses[:1])[0, 2] == pytest.approx(1.506)


def test_the_start_ramp_of_the_picture_ends_where_the_motion_takes_over(motion: PreparedMotion) -> None:
    row = start_row_of(motion.table, motion.lead_in_s)
    ramp = start_path(motion.table, 0.001, limits_for("iiwa14"), row)
    assert ramp is not None
    np.testing.assert_allclose(ramp.positions[0], motion.table.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(ramp.positions[-1], motion.table[row], atol=1e-6)
    assert row == len(motion.table) - 1000  # the last second of the period leads in
