"""Claims about units: what cannot be s, rad, m, Nm, N is refused with the unit it looks like, and nothing else is.

Truth: a motion of an arm within its limits, written here in SI and in other units.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.errors import RecordingError
from identification.recordings import Recording, read_recording, write_recording
from identification.recordings.reader import read_inputs
from identification.robots import load_robot

ROWS = 2000
TIME = np.arange(ROWS) * 0.005
RATE, PHASE = 2.0 * np.arange(1, 8) / 7.0, np.arange(7)
POSITION = 0.8 * np.sin(RATE * TIME[:, None] + PHASE)
VELOCITY = 0.8 * RATE * np.cos(RATE * TIME[:, None] + PHASE)
TORQUE = 20.0 * np.cos(RATE * TIME[:, None])
DEGREE = np.pi / 180.0

AXIS = """<robot name="gantry"><link name="base"/><link name="x"/><link name="arm"/>
<joint name="rail" type="prismatic"><parent link="base"/><child link="x"/><axis xyz="1 0 0"/>
 <limit lower="-1" upper="1" velocity="2" effort="400"/></joint>
<joint name="hinge" type="revolute"><parent link="x"/><child link="arm"/><origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>
 <limit lower="-3" upper="3" velocity="2" effort="100"/></joint></robot>"""

ARM = """<robot name="arm"><link name="base"/><link name="upper"/><link name="lower"/>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0.5 0 0"/>
 <axis xyz="0 1 0"/></joint></robot>"""


def read(folder: Path, *, robot: Any = "iiwa14", **changes: Any) -> Recording:
    np.savez(folder / "a.npz", **{"t": TIME, "q": POSITION, "tau": TORQUE, **changes})
    return read_recording(folder / "a.npz", robot=robot)


def refusal(folder: Path, **changes: Any) -> str:
    with pytest.raises(RecordingError) as caught:
        read(folder, **changes)
    assert caught.value.exit_code == 65
    return str(caught.value)


@pytest.mark.parametrize("robot", ["iiwa14", "iiwa7", None])
def test_si_passes_without_a_word(tmp_path: Path, robot: str | None) -> None:
    for start in (0.0, -3.0, 1.7e9):
        assert read(tmp_path, robot=robot, t=TIME + start, dq=VELOCITY).report.findings == ()


def test_slow_and_sparse_recordings_pass(tmp_path: Path) -> None:
    for step, pace in ((0.05, 1.0), (0.1, 0.3), (0.2, 0.5), (0.005, 0.02)):
        time = np.arange(ROWS) * step
        motion = 0.8 * np.sin(pace * RATE * time[:, None] + PHASE)
        assert read(tmp_path, t=time, q=motion, tau=10.0 * motion).samples > 0.9 * ROWS


@pytest.mark.parametrize("robot", ["iiwa14", None])
def test_degrees_are_refused(tmp_path: Path, robot: str | None) -> None:
    assert "--unit q=deg" in refusal(tmp_path, robot=robot, q=POSITION / DEGREE)
    assert "--unit q=deg" in refusal(tmp_path, robot=robot, q=POSITION / DEGREE, dq=VELOCITY / DEGREE)


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("robot", ["iiwa14", None])
@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_other_units_of_time_are_refused(
    tmp_path: Path, unit: str, factor: float, robot: str | None, start: float
) -> None:
    assert f"--unit t={unit}" in refusal(tmp_path, robot=robot, t=factor * (TIME + start))
    stamps = np.rint(factor * (TIME + start)).astype(np.int64)
    assert f"--unit t={unit}" in refusal(tmp_path, robot=robot, t=stamps)


def test_fast_sampling_in_milliseconds_is_refused(tmp_path: Path) -> None:
    time = np.arange(ROWS) * 0.0002
    motion = 0.3 * np.sin(20.0 * time[:, None] + PHASE)
    assert "--unit t=ms" in refusal(tmp_path, t=1e3 * time, q=motion)


def test_degrees_and_milliseconds_together_are_both_named(tmp_path: Path) -> None:
    text = refusal(tmp_path, q=POSITION / DEGREE, t=1e3 * TIME)
    assert "--unit q=deg --unit t=ms" in text


@pytest.mark.parametrize("robot", ["iiwa14", None])
def test_a_small_motion_in_degrees_shows_beside_its_velocity(tmp_path: Path, robot: str | None) -> None:
    small = {"robot": robot, "q": POSITION, "dq": VELOCITY * DEGREE}
    assert "--unit q=deg" in refusal(tmp_path, **small)
    assert "--unit dq=deg/s" in refusal(tmp_path, robot=robot, q=0.02 * POSITION, dq=0.02 * VELOCITY / DEGREE)


def test_a_velocity_that_is_no_derivative_is_said(tmp_path: Path) -> None:
    for factor, word in ((2.0, "2 times"), (-1.0, "-1 times")):
        findings = read(tmp_path, dq=factor * VELOCITY).report.findings
        assert [word in finding.sentence for finding in findings] == [True] * 7
    (finding,) = read(tmp_path, dq=VELOCITY * np.where(np.arange(7) == 6, 1.0 / DEGREE, 1.0)).report.findings
    assert finding.sentence.startswith("joint 7: the recorded velocity is 57.3 times")


def test_zeros_are_no_velocity(tmp_path: Path) -> None:
    recording = read(tmp_path, dq=VELOCITY * (np.arange(7) != 2))
    assert recording.velocity is not None
    assert np.isnan(recording.velocity).any(axis=0).tolist() == [joint == 2 for joint in range(7)]
    assert recording.report.of_kind("no_velocity")[0].joint == 3


def test_a_torque_that_was_not_measured_is_not_fitted(tmp_path: Path) -> None:
    assert "was not measured" in refusal(tmp_path, tau=0.0 * TORQUE)
    recording = read(tmp_path, tau=TORQUE * (np.arange(7) != 4))
    assert recording.report.of_kind("dead_torque")[0].joint == 5


def test_millinewtonmetres_are_refused(tmp_path: Path) -> None:
    assert "--unit tau=mNm" in refusal(tmp_path, tau=1e3 * TORQUE)


@pytest.mark.parametrize("rows", [slice(None), slice(900, 940)])
def test_torques_that_no_unit_explains_are_refused(tmp_path: Path, rows: slice) -> None:
    """`diagnose` said "no mismatch above 3.1e+08 Nm", exit code 0, of 40 rows at 1e10; a row alone is left out."""
    absurd = TORQUE.copy()
    absurd[rows, 1] *= 1e9
    assert "the torque of joint 2 is" in (said := refusal(tmp_path, tau=absurd))
    assert "the joint can bear 320 Nm" in said
    (tmp_path / "arm.urdf").write_text(ARM)
    planar = {"robot": tmp_path / "arm.urdf", "q": POSITION[:, :2]}
    assert "no arm of that size bears a thousandth" in refusal(tmp_path, **planar, tau=absurd[:, :2])
    assert read(tmp_path, tau=absurd, tau_unit="Nm").samples == ROWS
    lone = TORQUE.copy()
    lone[900, 1] = 1e10
    assert read(tmp_path, tau=lone).samples == ROWS - 1


def test_stated_units_are_turned_to_si(tmp_path: Path) -> None:
    recording = read(
        tmp_path, t=1e3 * TIME, q=POSITION / DEGREE, dq=VELOCITY / DEGREE, tau=1e3 * TORQUE, q_cmd=POSITION / DEGREE,
        t_unit="ms", q_unit="deg", tau_unit="mNm",
    )  # fmt: skip
    for name, truth in (("position", POSITION), ("velocity", VELOCITY), ("torque", TORQUE), ("time", TIME)):
        np.testing.assert_allclose(getattr(recording, name), truth, rtol=1e-12, atol=1e-12)
    assert recording.command_position is not None
    np.testing.assert_allclose(recording.command_position, POSITION, rtol=1e-12)
    assert recording.torque_unit == "Nm"
    mixed = read(tmp_path, q=POSITION / DEGREE, dq=VELOCITY, q_unit="deg", dq_unit="rad/s")
    assert mixed.velocity is not None
    np.testing.assert_allclose(mixed.velocity, VELOCITY)


def test_a_stated_unit_is_believed_also_after_the_import(tmp_path: Path) -> None:
    turning = 3.0 * POSITION / DEGREE
    assert "degrees" in refusal(tmp_path, robot=None, q=turning)
    recording = read(tmp_path, robot=None, q=turning, q_unit="rad")
    log = write_recording(recording, tmp_path / "import.mcap")
    np.testing.assert_array_equal(read_inputs([log], robot="iiwa14").recordings[0].position, turning)


def test_a_prismatic_joint_has_no_degrees(tmp_path: Path) -> None:
    (tmp_path / "gantry.urdf").write_text(AXIS)
    both = np.column_stack([0.5 * POSITION[:, 0], POSITION[:, 1]])
    in_mm = np.column_stack([500.0 * POSITION[:, 0], POSITION[:, 1]])
    in_degrees = np.column_stack([0.5 * POSITION[:, 0], POSITION[:, 1] / DEGREE])
    kept = {"robot": tmp_path / "gantry.urdf", "tau": TORQUE[:, :2]}
    assert "--unit q=mm" in refusal(tmp_path, q=in_mm, **kept)
    assert "--unit q=deg" in refusal(tmp_path, q=in_degrees, **kept)
    for values, unit in ((in_mm, "mm"), (in_degrees, "deg")):
        np.testing.assert_allclose(read(tmp_path, q=values, q_unit=unit, **kept).position, both, rtol=1e-12)
    assert load_robot(tmp_path / "gantry.urdf").units == ("N", "Nm")


def test_an_arm_with_both_kinds_of_joints_may_be_in_degrees_and_millimetres(tmp_path: Path) -> None:
    """As most controllers of SCARA arms have it: only one of the two could be stated, the last one silently."""
    (tmp_path / "gantry.urdf").write_text(AXIS)
    factor = np.array([1000.0, 1.0 / DEGREE])
    both, speed = POSITION[:, :2] * [0.5, 1.0], VELOCITY[:, :2] * [0.5, 1.0]
    kept = {"robot": tmp_path / "gantry.urdf", "tau": TORQUE[:, :2], "q": factor * both, "dq": factor * speed}
    assert "Import it with --unit q=deg,mm, or with --unit q=rad,m if that is right" in refusal(tmp_path, **kept)
    for units in ({"q_unit": "deg,mm"}, {"q_unit": "mm,deg", "dq_unit": "deg/s,mm/s"}):
        recording = read(tmp_path, **kept, **units)
        np.testing.assert_allclose(recording.position, both, rtol=1e-12)
        np.testing.assert_allclose(recording.velocity, speed, rtol=1e-12)
    for wrong in ("deg,rad", "mm,m", "deg,mm,m", "deg,"):
        assert f"the unit of q is '{wrong}'" in refusal(tmp_path, **kept, q_unit=wrong)


@pytest.mark.parametrize(("quantity", "unit"), [("q", "deg"), ("q", "mm"), ("dq", "deg/s"), ("dq", "mm/s")])
def test_units_of_one_kind_of_joint_need_the_robot(tmp_path: Path, quantity: str, unit: str) -> None:
    """The slide of a gantry was divided by 57.3, millimetres stayed as they were, and both were believed later."""
    text = refusal(tmp_path, robot=None, dq=VELOCITY, **{f"{quantity}_unit": unit})
    assert f"{quantity} is in {unit}, and which of its joints turn is not known: say so with --robot" in text


def test_an_import_takes_no_other_units(tmp_path: Path) -> None:
    """They were not put to use, and yet believed from there on."""
    log = write_recording(read(tmp_path, q=0.1 * POSITION), tmp_path / "import.mcap")
    with pytest.raises(RecordingError, match=r"state other units where .* is imported"):
        read_recording(log, units={"q": "deg"})


def test_a_joint_beyond_its_limits_is_said(tmp_path: Path) -> None:
    motion = POSITION.copy()
    motion[:, 1] += 1.5
    (finding,) = read(tmp_path, q=motion).report.findings
    assert "joint 2" in finding.sentence
    assert "2.094" in finding.sentence


def test_a_recording_of_another_arm_is_refused_or_said(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=TIME, q=POSITION, tau=TORQUE, robot="iiwa14")
    with pytest.raises(RecordingError, match="800 mm") as caught:
        read_inputs([tmp_path / "a.npz"], model_robot=load_robot("iiwa7"))
    assert caught.value.exit_code == 65
    assert "--robot iiwa7" in str(caught.value)
    with pytest.raises(RecordingError, match="iiwa7"):
        read_inputs([tmp_path / "a.npz"], robot="iiwa14", model_robot=load_robot("iiwa7"))
    forced = read_inputs([tmp_path / "a.npz"], robot="iiwa7", model_robot=load_robot("iiwa7")).recordings[0]
    assert "of iiwa14" in forced.report.of_kind("note")[0].sentence
    assert read_inputs([tmp_path / "a.npz"], model_robot=load_robot("iiwa14")).robot.name == "iiwa14"


def test_a_recording_that_names_no_robot_is_of_the_models(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=TIME, q=POSITION, tau=TORQUE)
    assert read_inputs([tmp_path / "a.npz"], model_robot=load_robot("iiwa7")).recordings[0].robot == "iiwa7"
