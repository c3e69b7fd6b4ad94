"""Claims about joint names: a recording's joints are the robot's by name, whatever their order, or it is refused.

Truth: every joint has motion and torque of its own here, made from its number; the bags are written by rosbags.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.errors import RecordingError, RobotError
from identification.recordings import Recording, read_recording, write_recording
from identification.recordings.joint_choice import for_robot, match_names
from identification.recordings.reader import read_inputs
from identification.robots import Installation, load_robot
from tests.identification.bags import JointMessage, messages_of, write_mcap

ROWS = 400
TIME = 1_700_000_000.0 + np.arange(ROWS) * 0.005
IIWA = [f"A{joint}" for joint in range(1, 8)]
ORDER = [4, 0, 6, 2, 5, 1, 3]


def own(joint: Any, scale: float = 1.0) -> Any:
    """Motion (scale 1) or torque (scale 10) of the joint with this number, which no other has."""
    return scale * np.sin(2.0 * (TIME - TIME[0])[:, None] + 0.7 * np.asarray(joint, dtype=float))


POSITION, TORQUE = own(range(1, 8)), own(range(1, 8), 10.0)


def arm_messages(names: list[str], **options: Any) -> list[JointMessage]:
    return messages_of(TIME, names, POSITION, TORQUE, **options)


def assert_is_the_arm(recording: Recording) -> None:
    np.testing.assert_array_equal(recording.position, POSITION)
    np.testing.assert_array_equal(recording.torque, TORQUE)


def refusal(*arguments: Any, **options: Any) -> str:
    with pytest.raises(RecordingError) as caught:
        read_recording(*arguments, **options)
    assert caught.value.exit_code == 65
    return str(caught.value)


# --- names alone -------------------------------------------------------------------------------------------------

UR = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]


@pytest.mark.parametrize(
    ("recorded", "robot", "expected"),
    [
        (sorted(UR), UR, [sorted(UR).index(name) for name in UR]),
        ([f"arm/{name}" for name in sorted(UR)], UR, [sorted(UR).index(name) for name in UR]),
        (sorted(UR), [f"ur10_{name}" for name in UR], [sorted(UR).index(name) for name in UR]),
        (["lbr_joint_2", "lbr_joint_0", "lbr_joint_1"], ["A1", "A2", "A3"], [1, 2, 0]),
        (["j10", "j9", "j8", "j7", "j6", "j5", "j4", "j3", "j2", "j1"], [f"A{i}" for i in range(1, 11)],
         [9, 8, 7, 6, 5, 4, 3, 2, 1, 0]),
        (["j2", "j1", "j3"], ["A3", "A1", "A2"], [2, 1, 0]),
        (["left_j1", "left_j2", "right_j1", "right_j2"], ["A1", "A2"], None),
        (["left_j1", "left_j2", "right_j1", "right_j2"], ["j1", "j2"], None),
        (["left_j2", "left_j1", "right_j1", "right_j2"], ["left_j1", "left_j2"], [1, 0]),
        (["A1", "A2", "E1", "A3", "A4", "A5", "A6"], [f"joint{i}" for i in range(1, 8)], None),
        (["A1", "A2", "A3"], ["A1", "A2", "A3", "A4"], None),
        (["elbow", "shoulder"], ["A1", "A2"], None),
        (["j1", "j01", "j2"], ["A1", "A2"], None),
        (["j1", "j3"], ["A1", "A2"], None),
        (["xj1", "yj2"], ["j1", "j2"], None),
    ],
)  # fmt: skip
def test_names_are_matched_or_not_at_all(recorded: list[str], robot: list[str], expected: list[int] | None) -> None:
    found = match_names(recorded, robot, serial=True)
    assert (None if found is None else list(found)) == expected


def test_the_order_of_a_tree_is_no_order() -> None:
    assert match_names(["j1", "j2"], ["left", "right"], serial=False) is None
    assert match_names(["j1", "j2"], ["left", "right"], serial=True) == (0, 1)


# --- bags --------------------------------------------------------------------------------------------------------


def test_a_bag_in_another_order_is_the_same_recording(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / "bag.mcap", arm_messages(IIWA, order=lambda _: ORDER))
    recording = read_recording(bag, robot="iiwa14")
    assert_is_the_arm(recording)
    assert "another order" in recording.report.of_kind("joints_chosen")[0].sentence
    again = read_recording(write_recording(recording, tmp_path / "import.mcap"))
    assert_is_the_arm(again)
    assert again.joint_names == tuple(IIWA)


def test_an_order_that_changes_from_message_to_message_is_followed(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / "bag.mcap", arm_messages(IIWA, order=lambda row: np.roll(ORDER, row)))
    assert_is_the_arm(read_recording(bag, robot="iiwa14"))


def test_numbered_names_of_another_driver_are_sorted(tmp_path: Path) -> None:
    names = [f"lbr_iiwa_joint_{joint}" for joint in range(1, 8)]
    bag = write_mcap(tmp_path / "bag.mcap", arm_messages(names, order=lambda _: ORDER))
    assert_is_the_arm(read_recording(bag, robot="iiwa14"))


def test_a_gripper_is_left_out_and_said(tmp_path: Path) -> None:
    fingers = ["finger_left", "finger_right"]
    messages = [
        replace(
            item,
            position={"finger_left": 0.01, **item.position, "finger_right": 0.02},
            effort={"finger_left": 5.0, **item.effort, "finger_right": 6.0},
        )
        for item in arm_messages(IIWA)
    ]
    recording = read_recording(write_mcap(tmp_path / "bag.mcap", messages), robot="iiwa14")
    assert_is_the_arm(recording)
    sentence = recording.report.of_kind("joints_chosen")[0].sentence
    assert all(name in sentence for name in fingers)
    assert "left out" in sentence


@pytest.mark.parametrize("robot", ["iiwa14", None])
def test_a_gripper_that_publishes_by_itself_costs_no_row(tmp_path: Path, robot: str | None) -> None:
    messages = []
    for row, item in enumerate(arm_messages(IIWA)):
        if row % 2 == 0:
            finger = {"finger": 0.01}
            messages.append(replace(item, position=finger, effort=finger, time_s=item.time_s - 1e-3))
        messages.append(item)
    recording = read_recording(write_mcap(tmp_path / "bag.mcap", messages), robot=robot)
    np.testing.assert_allclose(np.diff(recording.time), 0.005, atol=1e-6)
    assert_is_the_arm(recording)
    assert recording.report.of_kind("other_joints")[0].count == ROWS // 2


def test_without_a_robot_all_named_joints_are_kept_for_later(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / "bag.mcap", arm_messages(IIWA, order=lambda _: ORDER))
    recording = read_recording(bag)
    assert recording.joint_names == tuple(IIWA[place] for place in ORDER)
    assert_is_the_arm(for_robot(recording, load_robot("iiwa14")))
    log = write_recording(recording, tmp_path / "import.mcap")
    assert_is_the_arm(read_inputs([log], robot="iiwa14").recordings[0])


def test_names_that_mean_nothing_are_refused_with_both_lists(tmp_path: Path) -> None:
    names = ["shoulder", "upper_arm", "elbow", "forearm", "wrist", "palm", "flange"]
    bag = write_mcap(tmp_path / "bag.mcap", arm_messages(names, order=lambda _: ORDER))
    text = refusal(bag, robot="iiwa14")
    assert all(name in text for name in (*names, *IIWA, "--joints"))
    assert_is_the_arm(read_recording(bag, robot="iiwa14", joints=names))


def test_six_joints_for_a_seven_joint_arm_are_refused(tmp_path: Path) -> None:
    messages = messages_of(TIME, IIWA[:6], POSITION, TORQUE)
    text = refusal(write_mcap(tmp_path / "bag.mcap", messages), robot="iiwa14")
    assert "not A7" in text
    np.savez(tmp_path / "six.npz", t=TIME, q=POSITION[:, :6], tau=TORQUE[:, :6], robot="iiwa14")
    text = refusal(tmp_path / "six.npz")
    assert "6 joints" in text
    assert "has 7" in text


def test_rows_that_name_half_of_the_joints_are_no_rows(tmp_path: Path) -> None:
    messages = arm_messages(IIWA)
    few = [replace(item, position={"A1": 0.0}, effort={"A1": 0.0}) for item in messages]
    mixed = [few[row] if row % 10 == 0 else item for row, item in enumerate(messages)]
    recording = read_recording(write_mcap(tmp_path / "few.mcap", mixed), robot="iiwa14")
    np.testing.assert_array_equal(recording.position, np.delete(POSITION, np.arange(0, ROWS, 10), axis=0))
    mixed = [few[row] if row % 2 == 0 else item for row, item in enumerate(messages)]
    assert "name only some" in refusal(write_mcap(tmp_path / "half.mcap", mixed), robot="iiwa14")


def test_messages_without_names_among_named_ones_are_not_guessed(tmp_path: Path) -> None:
    messages = arm_messages(IIWA, order=lambda _: ORDER)
    mixed = [replace(item, named=row % 2 == 0) for row, item in enumerate(messages)]
    assert "of 400 rows" in refusal(write_mcap(tmp_path / "half.mcap", mixed), robot="iiwa14")
    mixed = [replace(item, named=row % 20 != 0) for row, item in enumerate(messages)]
    recording = read_recording(write_mcap(tmp_path / "few.mcap", mixed), robot="iiwa14")
    np.testing.assert_array_equal(recording.position, np.delete(POSITION, np.arange(0, ROWS, 20), axis=0))


def test_a_bag_without_any_name_is_taken_in_its_order(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / "bag.mcap", [replace(item, named=False) for item in arm_messages(IIWA)])
    assert_is_the_arm(read_recording(bag, robot="iiwa14"))


def test_names_that_change_on_the_way_are_not_two_halves_of_one_recording(tmp_path: Path) -> None:
    first, second = arm_messages([f"left_{n}" for n in IIWA]), arm_messages([f"right_{n}" for n in IIWA])
    bag = write_mcap(tmp_path / "bag.mcap", [*first[:200], *second[200:]])
    text = refusal(bag, robot="iiwa14")
    assert "left_A1" in text
    assert "right_A1" in text
    chosen = read_recording(bag, robot="iiwa14", joints=[f"left_{name}" for name in IIWA])
    np.testing.assert_array_equal(chosen.position, POSITION[:200])
    assert chosen.report.of_kind("other_joints")[0].count == 200


def test_a_joint_named_twice_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=TIME, q=POSITION, tau=TORQUE, joint_names=["A1"] * 7, robot="iiwa14")
    assert "'A1' twice" in refusal(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", t=TIME, q=POSITION, tau=TORQUE, joint_names=IIWA[:6], robot="iiwa14")
    assert "6 joints for 7 columns" in refusal(tmp_path / "b.npz")


def test_empty_values_under_names_are_no_rows(tmp_path: Path) -> None:
    messages = [replace(item, effort={}) if row % 2 else item for row, item in enumerate(arm_messages(IIWA))]
    assert "not finite" in refusal(write_mcap(tmp_path / "bag.mcap", messages), robot="iiwa14")


def test_ever_new_names_cost_no_memory(tmp_path: Path) -> None:
    messages = [JointMessage(moment, {f"j{row}": 0.0}, {f"j{row}": 0.0}) for row, moment in enumerate(TIME)]
    assert "no robot" in refusal(write_mcap(tmp_path / "bag.mcap", messages))


def test_messages_are_ordered_by_when_they_were_measured(tmp_path: Path) -> None:
    messages = arm_messages(IIWA)
    swapped = [messages[row ^ 1] for row in range(ROWS)]
    recording = read_recording(write_mcap(tmp_path / "bag.mcap", swapped), robot="iiwa14")
    assert_is_the_arm(recording)
    assert recording.report.of_kind("late_messages")[0].count == ROWS // 2
    half = [replace(item, stamped=row % 2 == 0) for row, item in enumerate(messages)]
    refusal(write_mcap(tmp_path / "half.mcap", half), robot="iiwa14")


# --- topics ------------------------------------------------------------------------------------------------------


def test_what_was_desired_is_not_what_was_measured(tmp_path: Path) -> None:
    wanted = messages_of(TIME, IIWA, POSITION + 0.1, 0.0 * TORQUE, topic="/joint_states_desired")
    measured = arm_messages(IIWA, topic="/franka/joint_states")
    bag = write_mcap(tmp_path / "bag.mcap", [item for pair in zip(wanted, measured, strict=True) for item in pair])
    recording = read_recording(bag, robot="iiwa14")
    assert_is_the_arm(recording)
    assert "/joint_states_desired" in recording.report.of_kind("note")[0].sentence


def test_the_topic_that_has_the_robots_joints_is_read(tmp_path: Path) -> None:
    head = messages_of(np.repeat(TIME, 2), ["pan", "tilt"], np.zeros((2 * ROWS, 2)), np.zeros((2 * ROWS, 2)))
    bag = write_mcap(tmp_path / "bag.mcap", [*head, *arm_messages(IIWA, topic="/arm/joint_states")])
    assert_is_the_arm(read_recording(bag, robot="iiwa14"))


def test_two_topics_that_may_be_meant_are_asked_about(tmp_path: Path) -> None:
    left, right = arm_messages(IIWA, topic="/left/joint_states"), arm_messages(IIWA, topic="/right/joint_states")
    bag = write_mcap(tmp_path / "bag.mcap", [item for pair in zip(left, right, strict=True) for item in pair])
    text = refusal(bag, robot="iiwa14")
    assert "/left/joint_states" in text
    assert "--topic" in text
    assert_is_the_arm(read_recording(bag, robot="iiwa14", topic="/right/joint_states"))
    assert "/left/joint_states" in refusal(bag, robot="iiwa14", topic="/middle")


# --- tables without messages -------------------------------------------------------------------------------------


def test_npz_and_csv_name_their_joints_too(tmp_path: Path) -> None:
    names = [IIWA[place] for place in ORDER]
    np.savez(
        tmp_path / "a.npz", t=TIME, q=POSITION[:, ORDER], tau=TORQUE[:, ORDER], dq=POSITION[:, ORDER],
        joint_names=names, robot="iiwa14",
    )  # fmt: skip
    recording = read_recording(tmp_path / "a.npz")
    assert_is_the_arm(recording)
    np.testing.assert_array_equal(recording.velocity, POSITION)
    columns = ["t", *(f"q{j}" for j in range(1, 8)), *(f"tau{j}" for j in range(1, 8))]
    rows = np.column_stack([TIME, POSITION[:, ORDER], TORQUE[:, ORDER]])
    np.savez(
        tmp_path / "b.npz", t=TIME, q=POSITION[:, ORDER], tau=TORQUE[:, ORDER], joint_names=np.array(names, dtype="S"),
        robot="iiwa14",
    )  # fmt: skip
    assert_is_the_arm(read_recording(tmp_path / "b.npz"))
    text = "\n".join(",".join(map(repr, map(float, row))) for row in rows)
    file = tmp_path / "a.csv"
    file.write_text(f"# robot: iiwa14\n# joint_names={','.join(names)}\n{','.join(columns)}\n{text}\n")
    assert_is_the_arm(read_recording(file))


def test_columns_without_names_are_chosen_by_number(tmp_path: Path) -> None:
    extra = np.zeros((ROWS, 1))
    np.savez(tmp_path / "a.npz", t=TIME, q=np.hstack([extra, POSITION]), tau=np.hstack([extra, TORQUE]), robot="iiwa14")
    assert "--joints" in refusal(tmp_path / "a.npz")
    assert_is_the_arm(read_recording(tmp_path / "a.npz", joints=[str(column) for column in range(2, 9)]))
    for wrong in (["2", "3"], ["1", "1", "2", "3", "4", "5", "6"], ["A1"]):
        refusal(tmp_path / "a.npz", joints=wrong)


# --- joints of the robot that were not recorded ------------------------------------------------------------------

HAND = """<robot name="arm_with_hand">
<link name="base"/><link name="upper"/><link name="lower"/><link name="left"/><link name="right"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
 <limit lower="-3" upper="3" velocity="2" effort="100"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
 <origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>
 <limit lower="-3" upper="3" velocity="2" effort="100"/></joint>
<joint name="finger_1" type="prismatic"><parent link="lower"/><child link="left"/><axis xyz="0 1 0"/>
 <limit lower="0" upper="0.04" velocity="1" effort="20"/></joint>
<joint name="finger_2" type="prismatic"><parent link="lower"/><child link="right"/><axis xyz="0 -1 0"/>
 <limit lower="0" upper="0.04" velocity="1" effort="20"/>{mimic}</joint></robot>"""


def test_joints_that_stood_still_are_locked_and_stay_so_in_the_log(tmp_path: Path) -> None:
    urdf = tmp_path / "hand.urdf"
    urdf.write_text(HAND.format(mimic=""))
    bag = write_mcap(tmp_path / "bag.mcap", messages_of(TIME, ["elbow", "shoulder"], POSITION, TORQUE))
    text = refusal(bag, robot=urdf)
    assert "--lock finger_1=0 --lock finger_2=0" in text
    locked = Installation(locked_joints=(("finger_1", 0.04), ("finger_2", 0.0)))
    recording = read_recording(bag, robot=urdf, installation=locked)
    np.testing.assert_array_equal(recording.position, POSITION[:, [1, 0]])
    log = write_recording(recording, tmp_path / "import.mcap")
    inputs = read_inputs([log])
    assert inputs.robot.joint_names == ("shoulder", "elbow")
    assert inputs.robot.installation == locked
    np.testing.assert_array_equal(inputs.recordings[0].position, POSITION[:, [1, 0]])


def test_a_recorded_joint_has_to_stand_where_it_is_locked(tmp_path: Path) -> None:
    """It was left out without a look, and the fit went on with an arm of another shape."""
    urdf, held = tmp_path / "hand.urdf", POSITION[:, :3].copy()
    urdf.write_text(HAND.format(mimic='<mimic joint="finger_1"/>'))
    held[:, 2] = 0.3
    file = tmp_path / "a.npz"
    arrays = {"t": TIME, "q": held, "tau": TORQUE[:, :3], "joint_names": np.array(["shoulder", "elbow", "finger_1"])}
    np.savez(file, **arrays)

    def read(at: float, **options: Any) -> Recording:
        return read_recording(file, robot=urdf, installation=Installation(locked_joints=(("finger_1", at),)), **options)

    assert read(0.29).n == 2
    with pytest.raises(RecordingError, match=r"finger_1 stood at 0\.3 rad \(m\), not at 0; give --lock finger_1=0\.3"):
        read(0.0)
    log = write_recording(read_recording(file), tmp_path / "all.mcap")
    with pytest.raises(RecordingError, match=r"stood at 0\.3"):
        read_recording(log, robot=urdf, installation=Installation(locked_joints=(("finger_1", 0.0),)))
    assert read(0.0, units={"q": "deg"}).n == 2  # in other units, the two numbers are not compared
    held[:, 2] = np.linspace(0.0, 0.08, ROWS)
    np.savez(file, **arrays)
    (moved,) = read(0.0).report.of_kind("held_joint_moves")
    assert moved.sentence.startswith(
        "WARNING, joint finger_1 is taken as held at 0 rad (m), but it was recorded from 0"
    )


def test_columns_without_names_have_to_stand_where_their_joints_are_locked(tmp_path: Path) -> None:
    """The advice of a fit is --lock with --joints 1,2: the third column was left out without a look."""
    urdf, held = tmp_path / "hand.urdf", POSITION[:, :3].copy()
    urdf.write_text(HAND.format(mimic='<mimic joint="finger_1"/>'))
    held[:, 2] = 0.3
    file = tmp_path / "a.npz"

    def read(joints: str, **locked: float) -> Recording:
        np.savez(file, t=TIME, q=held, tau=TORQUE[:, :3])
        return read_recording(
            file, robot=urdf, installation=Installation(locked_joints=tuple(locked.items())), joints=joints.split(",")
        )

    assert read("1,2", finger_1=0.29).n == 2
    with pytest.raises(RecordingError, match=r"finger_1 stood at 0\.3 rad \(m\), not at 0; give --lock finger_1=0\.3"):
        read("1,2", finger_1=0.0)
    held[:, 1] = -0.2
    assert read("1", finger_1=0.3, elbow=-0.2).n == 1
    with pytest.raises(RecordingError, match=r"column 3, which is left out, stood at 0\.3 rad \(m\), not at 0"):
        read("1", finger_1=0.0, elbow=-0.2)
    held[:, 2] = POSITION[:, 2]
    (moved,) = read("1,2", finger_1=0.0).report.of_kind("held_joint_moves")
    assert moved.sentence.startswith("WARNING, joint finger_1 is taken as held at 0 rad (m), but it was recorded from")


def test_a_joint_that_follows_a_locked_one_is_locked_with_it(tmp_path: Path) -> None:
    urdf = tmp_path / "hand.urdf"
    urdf.write_text(HAND.format(mimic='<mimic joint="finger_1"/>'))
    assert load_robot(urdf).driven_names == ("shoulder", "elbow", "finger_1")
    with pytest.raises(RobotError, match="follows 'finger_1'"):
        load_robot(urdf, Installation(locked_joints=(("finger_2", 0.0),)))
    assert load_robot(urdf, Installation(locked_joints=(("finger_1", 0.02),))).joint_names == ("shoulder", "elbow")
