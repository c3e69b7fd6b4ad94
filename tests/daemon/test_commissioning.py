"""Claims about the commissioning ladder: what may follow what, what begins anew, and what the log says.

Truth: the order 0.1, 0.25, 0.5, 1 of the operating rules.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from daemon.api import RunOutcome, RunRequest
from daemon.errors import LadderError, TooFastForT1Error
from daemon.motion.tip_speed import rounded_up
from daemon.run.commissioning import admit, held_to_modes, is_first_rung, ladder_file, remember
from daemon.run.ladder import RUNGS, highest_allowed, tags

from .producer import make_request


def request(folder: Path, amplitude: float, **changes: Any) -> RunRequest:
    values = {"bind_host": "192.170.10.1", "bind_port": 30200, "ladder_file": str(folder / "ladder.jsonl"), **changes}
    return make_request(folder, amplitude=amplitude, **values)


def outcome(how: str = "completed", exit_code: int = 0) -> RunOutcome:
    return RunOutcome(run_id="r", outcome=how, exit_code=exit_code, sentences=(), out_dir="")  # type: ignore[arg-type]


def test_a_real_arm_climbs_rung_by_rung(tmp_path: Path) -> None:
    for amplitude, too_much in ((0.1, 0.11), (0.25, 0.5), (0.5, 0.75), (1.0, None)):
        if too_much is not None:
            with pytest.raises(LadderError, match=f"--amplitude {amplitude:g}") as refusal:
                admit(request(tmp_path, too_much))
            assert refusal.value.exit_code == 1
        assert f"amplitude {amplitude:g}" in admit(request(tmp_path, amplitude))
        assert "is completed on this arm" in remember(request(tmp_path, amplitude), outcome())
    assert admit(request(tmp_path, 1.0))


@pytest.mark.parametrize(("how", "exit_code"), [("stopped", 1), ("dropped", 1), ("completed", 1), ("no_robot", 69)])
def test_only_a_completed_run_opens_the_next_rung(how: str, exit_code: int, tmp_path: Path) -> None:
    assert remember(request(tmp_path, 0.1), outcome(how, exit_code)) == ""
    with pytest.raises(LadderError, match="nothing was completed yet"):
        admit(request(tmp_path, 0.25))


def test_another_arm_trajectory_or_workspace_begins_at_the_bottom(tmp_path: Path) -> None:
    remember(request(tmp_path, 0.1, serial="1234"), outcome())
    assert admit(request(tmp_path, 0.25, serial="1234"))
    workspace = tmp_path / "cell.yaml"
    workspace.write_text("floor_height_m: -0.5\n")
    for changes in ({"serial": "1235"}, {"serial": "1234", "workspace_file": str(workspace)}):
        with pytest.raises(LadderError):
            admit(request(tmp_path, 0.25, **changes))
    (tmp_path / "trajectory.json").write_text('{"a": 1}')
    other = RunRequest(
        **{
            **{f: getattr(request(tmp_path, 0.25, serial="1234"), f) for f in RunRequest.__struct_fields__},
            "trajectory_file": str(_written(tmp_path / "other.json", '{"a": 2}')),
        }
    )
    with pytest.raises(LadderError):
        admit(other)


def test_an_arm_that_is_hung_otherwise_begins_at_the_bottom(tmp_path: Path) -> None:
    remember(request(tmp_path, 0.1), outcome())
    with pytest.raises(LadderError):
        admit(request(tmp_path, 0.25, gravity_m_s2=(0.0, 0.0, 9.81)))
    remember(request(tmp_path, 0.1, gravity_m_s2=(0.0, 0.0, 9.81)), outcome())
    assert admit(request(tmp_path, 0.25, gravity_m_s2=(0.0, 0.0, 9.81)))
    assert admit(request(tmp_path, 0.25))


def test_a_completed_run_whose_folder_went_away_is_still_a_completed_run(tmp_path: Path) -> None:
    done = request(tmp_path, 0.1)
    Path(done.trajectory_file).unlink()
    assert "counts as not done" in remember(done, outcome())


def _written(file: Path, text: str) -> Path:
    file.write_text(text)
    return file


def test_the_layout_of_the_files_does_not_matter(tmp_path: Path) -> None:
    cell = _written(tmp_path / "cell.yaml", "floor_height_m: -0.5\nmargins: {workspace_m: 0.03}\n")
    remember(request(tmp_path, 0.1, workspace_file=str(cell)), outcome())
    other = _written(tmp_path / "same.yaml", "# the same cell\nmargins:\n  workspace_m: 0.03\nfloor_height_m: -0.5\n")
    assert admit(request(tmp_path, 0.25, workspace_file=str(other)))


def test_an_address_says_nothing_of_whether_an_arm_may_move(tmp_path: Path) -> None:
    relayed = request(tmp_path, 1.0, bind_host="127.0.0.1")
    with pytest.raises(LadderError):
        admit(relayed)


def test_the_fake_robot_needs_no_ladder_and_the_log_says_so(tmp_path: Path) -> None:
    simulated = request(tmp_path, 1.0, bind_host="127.0.0.1", simulation=True)
    assert admit(simulated) == ""
    assert remember(simulated, outcome()) == ""
    assert not ladder_file(simulated).exists()
    assert tags(simulated) == {"commissioning": "1", "commissioning_ladder": "not needed: fake robot"}


def test_skipping_is_allowed_only_when_asked_for_and_is_written_down(tmp_path: Path) -> None:
    skipping = request(tmp_path, 0.5, skip_ladder=True)
    assert "although nothing yet was completed; the log says so" in admit(skipping)
    assert tags(skipping) == {"commissioning": "0.5", "commissioning_ladder": "skipped"}
    assert tags(request(tmp_path, 0.25))["commissioning_ladder"] == "kept"


def test_a_damaged_record_can_only_forbid(tmp_path: Path) -> None:
    remember(request(tmp_path, 0.1), outcome())
    file = tmp_path / "ladder.jsonl"
    whole = json.loads(file.read_text())
    file.write_text(
        json.dumps({**whole, "amplitude": 40})[:-1] + "\n\x00\xff garbage\n" + json.dumps({**whole, "x": 1})[:-3]
    )
    with pytest.raises(LadderError):
        admit(request(tmp_path, 0.25))
    remember(request(tmp_path, 0.1), outcome())
    assert admit(request(tmp_path, 0.25))


def test_the_record_is_the_users_own_unless_a_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert ladder_file(request(tmp_path, 0.1, ladder_file=None)) == tmp_path / "state" / "iiwa-ident" / "ladder.jsonl"


def test_a_record_that_cannot_be_written_is_told_and_ends_nothing(tmp_path: Path) -> None:
    blocked = request(tmp_path, 0.1, ladder_file=str(_written(tmp_path / "file", "")) + "/ladder.jsonl")
    assert "cannot be written" in remember(blocked, outcome())


@given(st.floats(0.0, 1.0))
def test_no_rung_is_ever_skipped(done: float) -> None:
    allowed = highest_allowed(done)
    assert allowed in RUNGS
    assert not any(done < rung < allowed for rung in RUNGS if rung - done > 1e-6)


def test_the_first_run_of_a_motion_on_an_arm_is_one_in_t1(tmp_path: Path) -> None:
    assert is_first_rung(request(tmp_path, 0.1))
    assert "in T1" in admit(request(tmp_path, 0.1))
    assert not is_first_rung(request(tmp_path, 0.1, simulation=True))
    assert not is_first_rung(request(tmp_path, 0.1, skip_ladder=True))
    remember(request(tmp_path, 0.1), outcome())
    assert not is_first_rung(request(tmp_path, 0.25))
    assert "T1" not in admit(request(tmp_path, 0.25))


def test_a_first_run_faster_than_t1_allows_is_refused_with_the_amplitude_that_is_not(tmp_path: Path) -> None:
    # Level, the arm turns about joint 1: the flange is 0.42 + 0.4 + 0.126 m from the axis (KUKA's drawing).
    radius_m, amplitude_rad, rate = 0.946, 0.2, 2 * np.pi / 2.0
    first = request(tmp_path, 0.1)
    table = np.zeros((2000, 7))
    table[:, 1] = 0.5 * np.pi
    table[:, 0] = amplitude_rad * np.sin(rate * 0.001 * np.arange(2000))
    np.save(first.table_file, table)
    speed = radius_m * amplitude_rad * rate
    with pytest.raises(TooFastForT1Error) as refusal:
        admit(first)
    assert refusal.value.speed_m_s == pytest.approx(speed, rel=0.01)
    assert refusal.value.allowed == pytest.approx(0.1 * 0.25 / speed, abs=0.002)
    assert f"--amplitude {refusal.value.allowed:g}" in str(refusal.value)
    assert refusal.value.exit_code == 1
    np.save(first.table_file, table * [1.007 * 0.25 / refusal.value.speed_m_s, 1, 1, 1, 1, 1, 1])
    with pytest.raises(TooFastForT1Error, match=r"reaches 0\.252 m/s"):  # it said 0.25, which allows 0.25
        admit(first)
    np.save(first.table_file, table * [0.9 * 0.25 / speed, 1, 1, 1, 1, 1, 1])
    assert admit(first)
    assert not held_to_modes(first).too_fast_for_t1
    # Of a later rung, or of one taken before its turn, the loop is told, which knows the mode of the robot.
    for later in (request(tmp_path, 0.25, skip_ladder=True), request(tmp_path, 0.1, simulation=True)):
        np.save(later.table_file, table)
        told = held_to_modes(later).too_fast_for_t1
        assert f"reach {rounded_up(refusal.value.speed_m_s):.3f} m/s" in told
    assert not held_to_modes(request(tmp_path, 1.0, monitor_only=True, table_file="")).too_fast_for_t1
