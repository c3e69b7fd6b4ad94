"""Claims about who checks a motion of `investigate` before it is driven: the command that drives it, every time.

Truth: a post in the way of the shipped excitation, at the place of the tool's tip that is farthest from its beginning.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from daemon.cli.app import main
from daemon.investigate import driver as driver_module
from daemon.investigate.account import Motion, read_account
from daemon.investigate.driver import FriDriver
from daemon.investigate.states import State
from daemon.motion.preparation import PreparedMotion, prepare_motion


@pytest.fixture(scope="module")
def motion() -> PreparedMotion:
    return prepare_motion(None)


@pytest.fixture
def post(motion: PreparedMotion, tmp_path: Path) -> Path:
    """A workspace with a post that the whole motion meets and its start ramp does not."""
    tip = motion.surroundings.geometry.tip_path(motion.table)
    there = tip[np.argmax(np.linalg.norm(tip - tip[0], axis=1))]
    file = tmp_path / "post.yaml"
    file.write_bytes(
        msgspec.yaml.encode({"boxes": [{"name": "post", "center_m": there.tolist(), "size_m": [0.06] * 3}]})
    )
    return file


@pytest.fixture(autouse=True)
def _nothing_is_driven(monkeypatch: pytest.MonkeyPatch) -> None:
    def drive(*_: object, **__: object) -> None:
        raise AssertionError("a motion was driven")

    monkeypatch.setattr(driver_module, "run_acquisition", drive)


def investigate(folder: Path, *words: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(["investigate", "--out", str(folder), *words])
    return int(end.value.code or 0)


def test_a_post_that_is_named_after_the_planning_is_not_driven_into(
    post: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "question"
    assert investigate(folder, "--budget", "4", "--plan-only") == 0
    planned = read_account(folder)
    assert planned is not None
    assert planned.state is State.PLANNED
    assert investigate(folder, "--workspace", str(post), "--yes") == 1
    blocked = read_account(folder)
    assert blocked is not None
    assert blocked.state is State.BLOCKED
    assert "post" in blocked.sentence
    assert "Nothing was moved." in capsys.readouterr().out


def test_on_a_real_arm_nobody_is_asked_about_a_motion_of_which_a_rung_is_unsafe(
    motion: PreparedMotion, post: Path, tmp_path: Path
) -> None:
    trajectory = tmp_path / "motion.json"
    trajectory.write_bytes(msgspec.json.encode(motion.trajectory.to_json()))

    def agree(prepared: PreparedMotion, periods: int) -> bool:
        raise AssertionError("the operator was asked")

    driver = FriDriver(
        robot="iiwa14",
        workspace=post,
        tool=None,
        installation=None,
        settings={},
        simulation=False,
        observe=lambda _: None,
        agree=agree,
    )
    asked = Motion(number=1, kind="k", purpose="to learn", trajectory=trajectory.name, periods=4, seconds=40.0)
    drive = driver.drive(asked, trajectory, tmp_path / "motion-01")
    assert drive.outcome == "unsafe"
    assert drive.sentence.startswith("At amplitude 1 the motion is not safe here: ")
