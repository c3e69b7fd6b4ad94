"""What leaps from one row to the next: whole turns are put back, a leap that no joint can make is refused.

Truth: one pendulum's equation of motion, and the same angles without the turns taken off.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.errors import RecordingError
from identification.recording_fit import fit_recordings
from identification.recordings import read_recording
from identification.recordings.leaps import rows_behind_hidden_gaps
from identification.recordings.writer import write_recording
from identification.robots import load_robot
from tests.identification.synthetic import fourier_motion
from tests.reference import ARM_OF, recording_file

ARM = """<robot name="arm"><link name="base"/><link name="one"/><link name="two"/>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="one"/><origin rpy="1.5707963267948966 0 0"/>
<axis xyz="0 0 1"/><limit effort="100" velocity="4"/></joint>
<joint name="elbow" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0 0 0.3"/>
<axis xyz="0 0 1"/><limit lower="-4" upper="4" effort="100" velocity="4"/></joint></robot>
"""
TIME = np.arange(4000) * 0.005


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.urdf").write_text(ARM)
    return tmp_path


def motion() -> tuple[np.ndarray, np.ndarray]:
    """Angles about π, and torques of a body without the second link's."""
    phase = TIME[:, None] * np.array([1.3, 1.9])
    q = np.array([3.0, 0.0]) + 0.6 * np.sin(phase) + 0.3 * np.cos(2.3 * phase)
    tau = 5.0 * np.sin(q) + 0.5 * np.gradient(q, TIME, axis=0)
    return q, tau + 0.02 * np.random.default_rng(1).standard_normal(q.shape)


def saved(path: Path, q: np.ndarray, tau: np.ndarray, **more: np.ndarray) -> Path:
    np.savez(path, t=TIME[: len(q)], q=q, tau=tau, robot="arm.urdf", **more)  # type: ignore[arg-type]
    return path


def within_a_turn(q: np.ndarray, low: float) -> np.ndarray:
    return np.column_stack([(q[:, 0] - low) % (2.0 * np.pi) + low, q[:, 1]])


@pytest.mark.parametrize("low", [-np.pi, -2.9])
def test_angles_that_start_anew_after_a_turn_are_continued(folder: Path, low: float) -> None:
    q, tau = motion()
    wrapped = within_a_turn(q, low)
    assert np.abs(np.diff(wrapped[:, 0])).max() > 6.0
    more = {"q_cmd": within_a_turn(q + 1e-3, low), "q_link": within_a_turn(q - 1e-3, low)}
    wrapped[100] = np.nan
    found = read_recording(saved(folder / "wrapped.npz", wrapped, tau, **more))
    kept = np.delete(np.arange(len(q)), 100)
    turns = (found.position - q[kept]) / (2.0 * np.pi)
    assert np.ptp(turns, axis=0) == pytest.approx(0.0, abs=1e-9)
    assert turns[0] == pytest.approx(np.round(turns[0]), abs=1e-9)
    assert found.command_position is not None
    assert found.link_position is not None
    assert found.command_position - found.position == pytest.approx(1e-3, abs=1e-9)
    assert found.link_position - found.position == pytest.approx(-1e-3, abs=1e-9)
    said = [finding.sentence for finding in found.report.findings if finding.kind == "whole_turns"]
    assert len(said) == 1
    assert said[0].startswith("joint 1: q starts anew after a whole turn")


def test_degrees_that_nobody_stated_are_no_whole_turns(folder: Path) -> None:
    """Sampled slowly, a joint goes on by about 6 degrees from row to row; 6.28 rad would be taken off each of them."""
    q, tau = motion()
    slow = slice(None, None, 13)
    assert np.abs(np.diff(np.rad2deg(q[slow, 0]))).max() == pytest.approx(6.0, abs=0.7)
    (folder / "arm.urdf").write_text(ARM.replace('type="revolute"', 'type="continuous"'))
    file = folder / "degrees.npz"
    np.savez(file, t=TIME[slow], q=np.rad2deg(q[slow]), tau=tau[slow], robot="arm.urdf")
    assert read_recording(file).position == pytest.approx(np.rad2deg(q[slow]), abs=1e-9)
    assert read_recording(file, units={"q": "deg"}).position == pytest.approx(q[slow], abs=1e-9)


def test_turns_are_put_back_beside_rows_that_are_left_out(folder: Path) -> None:
    """A spike, and rows without a number where the angle starts anew: cleaning takes them away first."""
    q, tau = motion()
    wrapped = within_a_turn(q, -np.pi)
    anew = np.flatnonzero(np.abs(np.diff(wrapped[:, 0])) > 6.0)[0]
    wrapped[anew], wrapped[700, 0] = np.nan, 50.0
    found = read_recording(saved(folder / "spoilt.npz", wrapped, tau))
    kept = np.delete(np.arange(len(q)), [700, anew])
    assert np.ptp((found.position - q[kept]) / (2.0 * np.pi), axis=0) == pytest.approx(0.0, abs=1e-9)


def test_a_recording_that_was_imported_without_its_robot_is_continued_with_it(folder: Path) -> None:
    q, tau = motion()
    np.savez(folder / "plain.npz", t=TIME, q=within_a_turn(q, -np.pi), tau=tau)
    write_recording(read_recording(folder / "plain.npz"), folder / "plain.mcap")
    found = read_recording(folder / "plain.mcap", robot=str(folder / "arm.urdf"))
    assert np.ptp((found.position - q) / (2.0 * np.pi), axis=0) == pytest.approx(0.0, abs=1e-9)


def test_a_motion_across_a_pause_is_no_whole_turn(folder: Path) -> None:
    """Five seconds that no row tells of: the joint has time to turn by 5.8 rad."""
    q, tau = motion()
    slow = np.column_stack([0.05 * np.sin(q[:, 1]) - 2.7, q[:, 1]])
    slow[2000:, 0] += 5.8
    time = TIME + 5.0 * (np.arange(len(q)) >= 2000)
    np.savez(folder / "pause.npz", t=time, q=slow, tau=tau, robot="arm.urdf")
    assert read_recording(folder / "pause.npz").position == pytest.approx(slow, abs=1e-9)


def test_a_command_that_starts_anew_is_brought_to_the_measured_angle(folder: Path) -> None:
    q, tau = motion()
    near = np.column_stack([np.pi - 0.02 + 0.01 * np.sin(q[:, 1]), q[:, 1]])
    command = within_a_turn(near + np.array([0.02, 0.0]), -np.pi)
    assert np.ptp(command[:, 0]) > 6.0
    found = read_recording(saved(folder / "command.npz", near, tau, q_cmd=command))
    assert found.command_position is not None
    assert found.command_position - found.position == pytest.approx(np.tile([0.02, 0.0], (len(q), 1)), abs=1e-9)


def test_a_fit_does_not_see_the_turns(folder: Path) -> None:
    q, tau = motion()
    robot = load_robot(folder / "arm.urdf")
    free, wrapped = (
        fit_recordings([read_recording(saved(folder / f"{name}.npz", angles, tau))], robot).values
        for name, angles in (("free", q), ("wrapped", within_a_turn(q, -np.pi)))
    )
    assert wrapped == pytest.approx(free, rel=1e-6, abs=1e-9)


def test_rows_missing_behind_even_time_stamps_are_refused_with_the_place(folder: Path) -> None:
    q, tau = motion()
    kept = np.r_[0:1000, 1500:4000]
    with pytest.raises(RecordingError, match=r"joint [12] leaps by [\d.]+ rad at t = 5 s.*where it can 4") as refusal:
        read_recording(saved(folder / "joined.npz", q[kept], tau[kept]))
    assert refusal.value.joint in (1, 2)


def test_what_a_sensor_does_is_no_leap(folder: Path) -> None:
    """A gap that the time stamps show, a coarse encoder that stands still for most rows, late stamps."""
    q, tau = motion()
    kept = np.r_[0:1000, 1500:4000]
    np.savez(folder / "gap.npz", t=TIME[kept], q=q[kept], tau=tau[kept], robot="arm.urdf")
    coarse = np.column_stack([q[:, 0], np.cumsum(0.1 * (np.arange(len(q)) % 400 == 0))])
    np.savez(folder / "coarse.npz", t=TIME, q=coarse, tau=tau, robot="arm.urdf")
    # A log five times as fast as its sensor, of an arm that rests for most of the file.
    updated = np.arange(len(q)) // 5
    turning = 1e-4 * (updated % 2) + 3.5 * np.maximum(0.025 * updated - 18.0, 0.0)
    np.savez(folder / "held.npz", t=TIME, q=np.column_stack([turning, q[:, 1]]), tau=tau, robot="arm.urdf")
    late = TIME.copy()
    late[1::2] += 0.00499
    np.savez(folder / "late.npz", t=late, q=q, tau=tau, robot="arm.urdf")
    for name in ("gap", "coarse", "held", "late"):
        read_recording(folder / f"{name}.npz")


@pytest.mark.parametrize("joints", [1, 3, 7])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.1, 0.25])
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3, 3e-3])
def test_rows_that_even_stamps_hide_are_found_where_noise_leaves_steps_to_be_seen(
    joints: int, share: float, noise: float
) -> None:
    """Truth: which rows were taken out. A tenth of the rows lost made inertias 65 % wrong, in silence."""
    random = np.random.default_rng(1)
    position = fourier_motion(joints, period_s=20.0, samples=5000, seed=2)[0]
    position = position + noise * random.normal(size=position.shape)
    kept = np.flatnonzero(random.random(len(position)) >= share)
    rows = rows_behind_hidden_gaps(0.004 * np.arange(len(kept)), position[kept])
    assert not rows_behind_hidden_gaps(0.004 * kept, position[kept]).size
    if share == 0.0:
        assert not rows.size
    elif noise <= 1e-4:
        assert rows.size >= 10
        assert np.mean(np.diff(kept, prepend=-1)[rows] == 2) > 0.8


@pytest.mark.parametrize("name", ARM_OF)
def test_no_row_of_a_real_recording_is_hidden(name: str) -> None:
    findings = read_recording(recording_file(f"{name}.npz")).report
    assert not findings.of_kind("hidden_gaps")
