"""Claims about the command `design` that need no search; truth: the robot's own limits, the contract's exit codes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daemon.cli.design_parts import show_effects, show_verified
from identification.excitation import load_trajectory
from tests.daemon.command_line import run

SLED = """<robot name="sled"><link name="base"/><link name="sled"><inertial><origin xyz="0.1 0 0"/><mass value="3"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.3"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="sled"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="2" effort="50"/></joint></robot>"""


@pytest.mark.parametrize("kind", ["sine_series", "polynomial_10", "polynomial_20"])
def test_a_reference_motion_of_any_robot_is_written_inside_its_limits(kind: str, tmp_path: Path) -> None:
    (tmp_path / "sled.urdf").write_text(SLED, encoding="utf-8")
    words = ["design", "--reference", kind, "--robot", str(tmp_path / "sled.urdf"), "--out", str(tmp_path / "m.json")]
    assert run(*words) == 0
    table = load_trajectory(tmp_path / "m.json").table(1000.0)
    assert table.shape[1] == 1
    assert np.max(np.abs(table)) <= 1.0
    assert 0.1 < np.max(np.abs(np.diff(table, axis=0))) * 1000.0 <= 2.0


def test_a_motion_that_finds_no_room_on_the_disk_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """/dev/full is the kernel's own full disk; its error carries no file. By a link, so that nothing can replace it."""
    full = tmp_path / "motion.json"
    full.symlink_to("/dev/full")
    assert run("design", "--reference", "sine_series", "--out", str(full)) == 74
    assert f"{full}: No space left on device." in "".join(capsys.readouterr().err.split("\n"))


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["--reference", "nothing"], 2),
        (["--objective", "beauty"], 2),
        (["--noise", "0.1,0.2"], 2),
        (["--period", "0"], 2),
        (["--period", "1e9"], 2),
        (["--budget", "0"], 2),
        (["--budget", "inf"], 2),
        (["--from", "0,0,0,nan,0,0,0"], 2),
        (["--from", "0,0,0,2.5,0,0,0"], 2),
        (["--seed", "-1"], 2),
        (["--noise-colour", "pink"], 2),
        (["--model", "nowhere.json"], 66),
    ],
)
def test_what_cannot_be_designed_ends_with_the_contracts_exit_code(
    words: list[str], code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("design", *words, "--out", tmp_path / "m.json") == code
    assert "Traceback" not in capsys.readouterr().err
    assert not (tmp_path / "m.json").exists()


def test_a_pose_in_the_floor_is_refused_before_anything_is_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The upper arm level at 0.36 m, the forearm of 0.4 m at 204.6° from upright: the wrist is 4 mm below the floor."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("identification.excitation.design.design_excitation", lambda *_, **__: pytest.fail("searched"))
    assert run("design", "--from", "0,1.5708,0,-2.0,0,0,0") == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "No motion can begin at the pose of --from: link" in said
    assert "and floor overlap by" in said
    assert not list(tmp_path.iterdir())


def test_a_joint_without_a_limit_has_no_share_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    show_verified({
        "samples": 10, "position": [0.5], "velocity": [0.5], "acceleration": [0.0], "rest_at_start": [0.0, 0.0, 0.0],
        "paper": [1.0], "within_limits": True, "within_paper_limits": True,
    })  # fmt: skip
    assert "no limit" in capsys.readouterr().out.splitlines()[4]


def test_how_near_the_limits_a_design_comes_is_a_table_in_percent(capsys: pytest.CaptureFixture[str]) -> None:
    """Sixteen digits a joint in brackets nobody reads."""
    show_verified({
        "samples": 10000, "position": [0.18527857958339633, 0.35], "velocity": [0.9844099301785912, 0.94],
        "acceleration": [0.48, 0.33], "rest_at_start": [1.7e-16, 0.0, 0.0], "paper": [0.9999999999989999, 1.2],
        "within_limits": True, "within_paper_limits": False,
    })  # fmt: skip
    lines = capsys.readouterr().out.splitlines()
    assert "10000 rows" in lines[0]
    assert lines[2].split() == ["position", "18.5", "35.0"]
    assert lines[3].split() == ["velocity", "98.4", "94.0"]
    assert lines[5].split()[-2:] == ["100.0", "120.0"]
    assert lines[-1] == "Inside the limits of the arm: yes; inside (14) of the paper, at rest at the start: NO."


def test_what_is_found_and_what_gets_a_name_are_told_apart(capsys: pytest.CaptureFixture[str]) -> None:
    """Truth: docs/mismatch-proof.md; half a χ² of 14 is λ = 28, and a name needs λ ≥ 60."""
    show_effects((), periods=4)
    assert "reach the λ of 28 at which a diagnosis finds them; a name needs 60." in capsys.readouterr().out
