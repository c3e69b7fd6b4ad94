"""Claims about the cabinet's load data in `doctor` and at the end of a run. Truth: Pinocchio's gravity and dynamics."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from daemon.doctor.load_check import check_load_at_rest, load_before_motion, load_remark
from daemon.log.cdr import SampleLabels
from daemon.log.writer import LogWriter
from daemon.motion.tool import read_tool
from daemon.motion.torque_foresight import torque_foresight
from fri_client.messages import ConnectionInfo, MessageHeader, MonitorData, MonitoringMessage
from identification.excitation import default_trajectory
from identification.robots import load_robot

from .producer import make_request

BENT = (0.1, 0.6, -0.1, -1.2, 0.1, 0.9, 0.1)
UPRIGHT = (0.0,) * 7


def load_torque(mass: float, height_m: float, *states: np.ndarray) -> np.ndarray:
    """(S, 7) Nm that a point on the flange's axis needs, by Pinocchio on an arm that weighs nothing else."""
    model = load_robot("iiwa14").pinocchio_model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pinocchio.Inertia.Zero()
    place = np.array([0.0, 0.0, 0.126 + height_m])
    model.appendBodyToJoint(7, pinocchio.Inertia(mass, place, np.zeros((3, 3))), pinocchio.SE3.Identity())
    data = model.createData()
    return np.array([pinocchio.rnea(model, data, *state) for state in zip(*states, strict=True)])


def message(counter: int, position: np.ndarray, external: np.ndarray) -> MonitoringMessage:
    monitor = MonitorData(
        measured_joint_position=tuple(position.tolist()),
        measured_torque=(0.0,) * 7,
        external_torque=tuple(external.tolist()),
    )
    return MonitoringMessage(
        MessageHeader(0x245142, counter, 0), monitor_data=monitor, connection_info=ConnectionInfo(4, 3, 1, 1)
    )


def at_rest(posture: tuple[float, ...], external: np.ndarray) -> list[MonitoringMessage]:
    generator = np.random.default_rng(2)
    return [message(n, np.array(posture), external + 0.05 * generator.standard_normal(7)) for n in range(100)]


@pytest.mark.parametrize(("mass", "words"), [(1.5, "does not know of"), (-1.5, "believes in")])
def test_a_weight_on_the_flange_is_said_with_its_size(mass: float, words: str) -> None:
    rest, still = np.array([BENT]), np.zeros((1, 7))
    check = check_load_at_rest(at_rest(BENT, -load_torque(1.0, 0.0, rest, still, still)[0] * mass))
    assert check is not None
    assert check.status == "warning"
    assert "about 1.5 kg" in check.sentence
    assert words in check.sentence
    assert "load data on the cabinet" in check.remedy


def test_a_load_with_a_wrong_centre_is_said_of_an_arm_at_rest() -> None:
    """3 kg at z 0.1 m, and load data that say at 0.3 m: no weight, and 4.4 Nm in this posture (Pinocchio)."""
    rest, still = np.array([BENT]), np.zeros((1, 7))
    wrong = (load_torque(3.0, 0.1, rest, still, still) - load_torque(3.0, 0.3, rest, still, still))[0]
    check = check_load_at_rest(at_rest(BENT, -wrong))
    assert check is not None
    assert check.status == "warning", check.sentence
    assert "centre is not where" in check.sentence


def test_friction_of_standing_joints_and_a_push_elsewhere_are_no_load() -> None:
    for external in ([0.8, -0.9, 0.5, 0.6, -0.4, 0.3, 0.2], [0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 0.0]):
        check = check_load_at_rest(at_rest(BENT, np.array(external)))
        assert check is not None
        assert check.status == "ok", check.sentence


def test_an_upright_arm_cannot_tell() -> None:
    check = check_load_at_rest(at_rest(UPRIGHT, np.zeros(7)))
    assert check is not None
    assert "hardly shows" in check.sentence


def test_nothing_is_said_of_an_arm_that_moves_or_of_a_robot_without_external_torque() -> None:
    moving = [message(n, np.array(BENT) + 0.001 * n, np.zeros(7)) for n in range(50)]
    assert check_load_at_rest(moving) is None
    assert check_load_at_rest([]) is None


def remark_on(folder: Path, table: np.ndarray, external: np.ndarray) -> str:
    """What the end of a run says of one period at 1 kHz."""
    writer = LogWriter(folder / "recording.mcap", metadata={}, attachments=[], robot_description="")
    for row, (position, torque) in enumerate(zip(table, external, strict=True)):
        now = 1_000_000 * row
        labels = SampleLabels(now, now, row, 3, 0, row, True, False, False, False)
        writer.write_sample(message(row, position, torque), None, labels)
    writer.finish({})
    return load_remark(folder / "recording.mcap", make_request(folder), 0.001)


def motion_with_friction() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A period of the shipped motion, its two derivatives, and the external torque of a cabinet that knows its load."""
    table, spacing = default_trajectory().table(1000.0), 0.001
    dq = (np.roll(table, -1, axis=0) - np.roll(table, 1, axis=0)) / (2 * spacing)
    ddq = (np.roll(table, -1, axis=0) - 2 * table + np.roll(table, 1, axis=0)) / spacing**2
    noise = 0.1 * np.random.default_rng(6).standard_normal(table.shape)
    return table, dq, ddq, noise - 0.3 * np.tanh(dq / 0.01)


@pytest.mark.parametrize("mass", [0.0, 0.8])
def test_the_end_of_a_run_names_the_load_that_the_cabinet_does_not_know(tmp_path: Path, mass: float) -> None:
    *states, external = motion_with_friction()
    said = remark_on(tmp_path, states[0], external - load_torque(1.0, 0.05, *states) * mass)
    if mass:
        found = re.search(r"that of (\S+) kg at \((\S+), (\S+), (\S+)\) m .* that the cabinet does not know of", said)
        assert found is not None, said
        assert float(found[1]) == pytest.approx(0.8, abs=0.05)
        assert [float(found[axis]) for axis in (2, 3, 4)] == pytest.approx([0.0, 0.0, 0.05], abs=0.03)
    else:
        assert said == ""


def test_the_end_of_a_run_names_the_moment_where_the_load_data_have_the_mass_but_not_the_centre(tmp_path: Path) -> None:
    """3 kg at z 0.1 m, and load data that say at 0.2 m: a moment of -0.3 kg m on the flange's axis, and no weight."""
    *states, external = motion_with_friction()
    wrong = load_torque(3.0, 0.1, *states) - load_torque(3.0, 0.2, *states)
    said = remark_on(tmp_path, states[0], external - wrong)
    found = re.search(r"mass differs by (\S+) ± (\S+) kg .* by \((\S+) ± \S+, (\S+) ± \S+, (\S+) ± (\S+)\) kg m", said)
    assert found is not None, said
    assert float(found[1]) == pytest.approx(0.0, abs=0.02)
    assert [float(found[place]) for place in (3, 4, 5)] == pytest.approx([0.0, 0.0, -0.3], abs=0.02)
    assert 0.0 < float(found[6]) < 0.02


def test_a_recording_that_cannot_be_read_costs_nothing(tmp_path: Path) -> None:
    (tmp_path / "recording.mcap").write_bytes(b"no recording")
    assert load_remark(tmp_path / "recording.mcap", make_request(tmp_path), 0.001) == ""
    assert load_remark(tmp_path / "absent.mcap", make_request(tmp_path), 0.001) == ""


@pytest.mark.parametrize(
    ("declared", "carried", "words"),
    [("none", 1.5, "more"), ("1.5@0,0,0.05", 0.0, "less"), ("1.5@0,0,0.05", 1.5, ""), ("none", 0.3, "")],
)
def test_a_tool_that_nobody_declared_is_said_before_the_motion(
    tmp_path: Path, declared: str, carried: float, words: str
) -> None:
    tool = read_tool(declared)
    bare, foresight = torque_foresight("iiwa14"), torque_foresight("iiwa14", None, tool)
    assert bare is not None
    assert foresight is not None
    rest, still = np.array([BENT]), np.zeros((1, 7))
    held = bare.at_rest(rest[0]) + carried * load_torque(1.0, 0.05, rest, still, still)[0]
    noise = 0.05 * np.random.default_rng(3).standard_normal((50, 7))
    positions = np.repeat(rest, 50, axis=0)
    said = load_before_motion(positions, noise - held, make_request(tmp_path, tool=declared), foresight)
    if words:
        # Weighed on the flange, 5 cm nearer than it is: some 0.7 m from joint 2 and 0.4 m from joint 4.
        found = re.search(rf"about (\S+) kg {words} on its flange", said)
        assert found is not None, said
        assert float(found[1]) == pytest.approx(1.5, rel=0.15)
        # A tool that is declared and not there is not to be declared once more.
        assert ("give it with --tool" in said) == (words == "more")
        assert ("mount it" in said) == (words == "less")
    else:
        assert said == ""
    moving = positions + np.linspace(0.0, 0.1, 50)[:, None]
    assert load_before_motion(moving, noise - held, make_request(tmp_path), foresight) == ""
