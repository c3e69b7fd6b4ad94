"""A header that leaves no doubt is read as it says, units included; others are refused. Truth: the numbers written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.errors import RecordingError
from identification.recordings import Recording, read_recording
from tests.identification.synthetic import fourier_motion

JOINTS = 7
DEGREE = np.pi / 180.0
TIME = 0.01 * np.arange(500)
Q, DQ, _ = fourier_motion(JOINTS, period_s=5.0, samples=500, seed=1)
TAU = 20.0 * np.cos(Q) + DQ


def read(path: Path, names: list[str], columns: list[np.ndarray], first: str = "") -> Recording:
    header = first + ",".join(names)
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", encoding="utf-8")
    return read_recording(path, robot="iiwa14")


@pytest.mark.parametrize(
    ("time", "q", "tau", "dq", "factors"),
    [
        ("t", "q{}", "tau{}", "dq{}", (1.0, 1.0, 1.0, 1.0)),
        ("t [s]", "q{} [rad]", "tau_{} (Nm)", "dq{} [rad/s]", (1.0, 1.0, 1.0, 1.0)),
        ("Time [ms]", "Q{} [deg]", "Torque {} (N m)", "velocity {} (deg/s)", (1e-3, DEGREE, 1.0, DEGREE)),
        ("time_ms", "q_deg_{}", "tau_{}_mNm", "dq_{}_deg_s", (1e-3, DEGREE, 1e-3, DEGREE)),
        ("timestamp_ns", "pos[{}]", "effort[{}]", "vel[{}]", (1e-9, 1.0, 1.0, 1.0)),
        ("t (µs)", "position_{} [°]", "tau{} [mNm]", "dq{} [rad/sec]", (1e-6, DEGREE, 1e-3, 1.0)),
        ("t", "joint_position_{}_rad", "joint_torque_{}_nm", "joint_velocity_{}_rad_per_s", (1.0, 1.0, 1.0, 1.0)),
    ],
)
@pytest.mark.parametrize("first", [0, 1])
def test_units_stand_in_the_header(
    tmp_path: Path, time: str, q: str, tau: str, dq: str, factors: tuple[float, ...], first: int
) -> None:
    joints = range(first, first + JOINTS)
    names = [time, "row", *(style.format(joint) for style in (q, dq, tau) for joint in joints), "q_des_1"]
    seconds, angle, torque, speed = factors
    columns = [TIME / seconds, TIME, *(Q / angle).T, *(DQ / speed).T, *(TAU / torque).T, TIME]
    recording = read(tmp_path / "table.csv", names, columns)
    assert recording.velocity is not None
    np.testing.assert_allclose(recording.time - recording.time[0], TIME, atol=1e-9)
    pairs = ((recording.position, Q), (recording.velocity, DQ), (recording.torque, TAU))
    for found, truth in pairs:
        np.testing.assert_allclose(found, truth, atol=1e-9)
    said = [finding.sentence for finding in recording.report.of_kind("units_of_header")]
    assert bool(said) == (factors != (1.0, 1.0, 1.0, 1.0))
    assert all("q in deg" in sentence for sentence in said if angle != 1.0)


def test_velocities_of_something_else_are_passed_over(tmp_path: Path) -> None:
    """Three, of the tool."""
    names = ["t", *(f"{name}{joint}" for name in ("q", "tau") for joint in range(1, JOINTS + 1))]
    columns = [TIME, *Q.T, *TAU.T]
    recording = read(tmp_path / "a.csv", [*names, "velocity_1", "velocity_2", "velocity_3"], [*columns, *DQ.T[:3]])
    assert recording.velocity is None


def test_columns_of_one_quantity_may_be_in_several_units(tmp_path: Path) -> None:
    factors = np.where(np.arange(JOINTS) < 3, DEGREE, 1.0)
    names = ["t", *(f"q{j + 1} [{'deg' if j < 3 else 'rad'}]" for j in range(JOINTS))]
    names += [f"tau{j + 1}" for j in range(JOINTS)]
    recording = read(tmp_path / "table.csv", names, [TIME, *(Q / factors).T, *TAU.T])
    np.testing.assert_allclose(recording.position, Q, atol=1e-9)
    (finding,) = recording.report.of_kind("units_of_header")
    assert "column 'q3 [deg]' in another unit" in finding.sentence


@pytest.mark.parametrize(
    ("q", "tau", "first", "said"),
    [
        ("q{} [turns]", "tau{}", "", "the unit of q is 'turns'; known are rad"),
        ("q{}", "tau{} [MNm]", "", "the unit of tau is 'MNm'"),
        ("q{}", "tau{} [%]", "", "the unit of tau is '%'"),
        ("q{} [Nm]", "tau{}", "", "the unit of q is 'Nm'"),
        ("q_m_{}", "tau{}", "", "columns q1, q2, … are missing"),
        ("q{} [deg]", "tau{}", "# q_unit=rad\n", "q_unit=rad, and in its header deg"),
    ],
)
def test_a_header_in_doubt_is_refused_with_a_sentence(tmp_path: Path, q: str, tau: str, first: str, said: str) -> None:
    names = ["t", *(style.format(joint) for style in (q, tau) for joint in range(1, JOINTS + 1))]
    with pytest.raises(RecordingError) as refusal:
        read(tmp_path / "table.csv", names, [TIME, *Q.T, *TAU.T], first)
    assert said in str(refusal.value)


def test_half_stated_units_currents_among_torques_and_two_of_one_are_refused(tmp_path: Path) -> None:
    plain = [f"tau{j}" for j in range(1, JOINTS + 1)]
    for some, said in (
        ([f"pos{j}{' [deg]' * (j < 3)}" for j in range(1, JOINTS + 1)], "others none"),
        ([f"{'pos' if j == 1 else 'q'}{max(j, 2)} [rad]" for j in range(1, JOINTS + 1)], "leave one out"),
    ):
        with pytest.raises(RecordingError, match=said):
            read(tmp_path / "table.csv", ["t", *some, *plain], [TIME, *Q.T, *TAU.T])
    mixed = [f"tau{j} [{'A' if j == 2 else 'Nm'}]" for j in range(1, JOINTS + 1)]
    with pytest.raises(RecordingError, match="torques or currents"):
        read(tmp_path / "table.csv", ["t", *(f"q{j}" for j in range(1, JOINTS + 1)), *mixed], [TIME, *Q.T, *TAU.T])
