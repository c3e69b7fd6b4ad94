"""Claims about the run's folder before anything is started: what is written into it and what is refused."""

from __future__ import annotations

from pathlib import Path

import pinocchio
import pytest

from daemon.api import LoopReport, PhaseSpan, RunOutcome
from daemon.errors import ConfigurationError
from daemon.json_files import write_json
from daemon.log.cdr import JOINT_NAMES
from daemon.run.folder import make_room, prepare_folder
from tests.daemon.command_line import run

from .producer import make_request


def test_a_built_in_arm_gets_a_urdf_whose_joints_are_those_of_joint_states(tmp_path: Path) -> None:
    """So that a viewer moves the arm of /robot_description by /joint_states; Pinocchio reads it."""
    request = make_request(tmp_path / "in", out_dir=str(tmp_path / "run"))
    prepare_folder(request)
    model = pinocchio.buildModelFromUrdf(str(tmp_path / "run" / "robot.urdf"))
    assert tuple(model.names)[1:] == JOINT_NAMES


def test_a_urdf_of_the_operators_own_is_copied_and_not_replaced(tmp_path: Path) -> None:
    own = tmp_path / "mine.urdf"
    own.write_text("<robot name='mine'/>")
    resolved = prepare_folder(make_request(tmp_path / "in", out_dir=str(tmp_path / "run"), urdf_file=str(own)))
    assert resolved.urdf_file == str(tmp_path / "run" / "mine.urdf")
    assert not (tmp_path / "run" / "robot.urdf").exists()


def leave_run(folder: Path, outcome: str, *phases: str, answered: int = 5) -> None:
    """What a run leaves: its account and its files."""
    folder.mkdir(exist_ok=True)
    report = LoopReport(
        outcome=outcome, reason="r", sentence="s", answered=answered,  # type: ignore[arg-type]
        phases=tuple(PhaseSpan(phase=phase) for phase in phases),
    )  # fmt: skip
    write_json(
        folder / "run.json",
        RunOutcome(
            run_id="r", outcome=report.outcome, exit_code=69, sentences=("s",), out_dir=str(folder), loop=report
        ),
    )
    (folder / "loop.log").write_text("words")
    (folder / "table.npy").write_text("an input")


@pytest.mark.parametrize(
    ("outcome", "phases", "answered"),
    [
        ("no_robot", ("WAITING",), 0),
        ("version_mismatch", ("WAITING",), 0),
        ("not_started", ("WAITING",), 900),
        ("refused", (), 0),
        ("stopped", ("WAITING", "DONE"), 4),
        ("fault", (), 0),
    ],
)
def test_a_start_at_which_nothing_moved_makes_room_for_the_next_and_is_kept(
    tmp_path: Path, outcome: str, phases: tuple[str, ...], answered: int
) -> None:
    for number in (1, 2):
        leave_run(tmp_path / "run", outcome, *phases, answered=answered)
        make_room(tmp_path / "run")
        kept = tmp_path / "run" / f"failed-start-{number}"
        assert {file.name for file in kept.iterdir()} == {"run.json", "loop.log"}
        assert not (tmp_path / "run" / "run.json").exists()
        assert (tmp_path / "run" / "table.npy").exists()


@pytest.mark.parametrize(
    ("outcome", "phases"),
    [
        ("completed", ("START_RAMP", "EXCITATION")),
        ("stopped", ("WAITING", "START_RAMP", "STOP_RAMP")),
        ("dropped", ("WAITING", "START_RAMP")),
        ("fault", ()),
    ],
)
def test_a_run_that_may_have_moved_the_arm_is_never_set_aside(
    tmp_path: Path, outcome: str, phases: tuple[str, ...]
) -> None:
    leave_run(tmp_path / "run", outcome, *phases)
    with pytest.raises(ConfigurationError, match="holds a run already"):
        make_room(tmp_path / "run")


def test_the_inputs_of_an_earlier_run_are_not_written_over_by_one_that_is_refused(tmp_path: Path) -> None:
    leave_run(tmp_path / "run", "completed", "START_RAMP")
    assert run("run", "--amplitude", "0.1", "--out", tmp_path / "run") == 78
    assert (tmp_path / "run" / "table.npy").read_text() == "an input"
    assert not (tmp_path / "run" / "trajectory.json").exists()


@pytest.mark.parametrize("by", ["name", "link"])
@pytest.mark.parametrize(
    ("option", "name"), [("--workspace", "workspace.yaml"), ("--model", "model.json"), (None, "trajectory.json")]
)
def test_a_run_does_not_write_over_a_file_that_it_is_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str | None, name: str, by: str
) -> None:
    """A workspace file came back without its tool after `--tool none`, and the next run knew of none."""
    folder, mine = tmp_path / "run", tmp_path / "mine"
    folder.mkdir()
    given = folder / name if by == "name" else mine
    given.write_text("margins: {workspace_m: 0.05}")
    if by == "link":
        (folder / name).symlink_to(mine)
    words = [given] if option is None else [option, given]
    assert run("run", *words, "--tool", "none", "--out", folder, "--bind", "127.0.0.1:0") == 78
    assert "write its own" in capsys.readouterr().err
    assert given.read_text() == "margins: {workspace_m: 0.05}"
