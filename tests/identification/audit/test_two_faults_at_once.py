"""Claims about an audit where two things are wrong, or one that the model cannot tell: the recording tells by itself.

Truth: Pinocchio's torque of an arm of six joints from its own URDF, with friction, offsets and noise; faults put into
the columns of the recording, a tool into Pinocchio's last body.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from identification.audit import Audit, audit
from identification.model_file import Model, read_model, write_model
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import load_robot
from tests.identification.synthetic import fourier_motion

FloatArray = np.ndarray
# Mass, centre, moments of inertia; then the joint's place and angles in the link before.
LINKS = (
    ("7", "0 -0.03 0.02", (0.03, 0.03, 0.02), "0 0 0.15", "0 0 0"),
    ("12", "0.28 0 0.14", (0.04, 0.34, 0.35), "0 0 0", "1.5708 0 0"),
    ("4", "0.25 0 0.02", (0.01, 0.10, 0.10), "0.61 0 0", "0 0 0.3"),
    ("2", "0 -0.01 0.02", (0.004, 0.004, 0.004), "0.57 0 0.13", "0 0 0.2"),
    ("1.9", "0 0.01 0.01", (0.004, 0.004, 0.003), "0 -0.11 0", "1.5708 0 0"),
    ("0.9", "0.005 0 0.04", (0.002, 0.002, 0.001), "0 0.11 0", "-1.5708 0 0"),
)
VISCOUS, COULOMB, OFFSET, NOISE = (
    np.array(values)
    for values in (
        (12.0, 14.0, 8.0, 2.5, 2.2, 1.8), (9.0, 10.0, 6.0, 2.2, 2.0, 1.6),
        (0.5, -1.0, 0.4, 0.1, -0.2, 0.05), (0.6, 0.6, 0.4, 0.1, 0.1, 0.08),
    )
)  # fmt: skip
TOOL = pinocchio.Inertia(2.5, np.array([0.02, -0.03, 0.17]), np.diag([0.01, 0.01, 0.005]))


def arm(turned: int | None = None, heavier: float = 1.0) -> str:
    """The URDF; one axis (from 1) turned, all bodies so much heavier."""
    parts, parent = ['<robot name="arm"><link name="base"/>'], "base"
    for number, (mass, center, moments, xyz, rpy) in enumerate(LINKS, start=1):
        ixx, iyy, izz = (heavier * value for value in moments)
        parts.append(
            f'<link name="l{number}"><inertial><origin xyz="{center}"/><mass value="{heavier * float(mass)}"/>'
            f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{number}" type="revolute"><parent link="{parent}"/><child link="l{number}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 {-1 if number == turned else 1}"/>'
            '<limit lower="-3.1" upper="3.1" effort="400" velocity="4"/></joint>'
        )
        parent = f"l{number}"
    return "".join([*parts, "</robot>"])


def slow_motion(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity, acceleration (R, 6) of six sines a joint, the largest deflection 0.9 rad."""
    generator, time, states = np.random.default_rng(seed), 0.01 * np.arange(2000), np.zeros((3, 2000, 6))
    rate = 0.1 * np.pi * np.arange(1, 7)
    for joint in range(6):
        phase = np.outer(time, rate)
        sine, cosine = (generator.normal(size=6) / np.arange(1, 7) ** 0.7 for _ in range(2))
        place = np.sin(phase) @ sine + np.cos(phase) @ cosine
        scale = 0.9 / np.abs(place - place.mean()).max()
        states[0, :, joint] = scale * (place - place.mean()) + generator.uniform(-0.3, 0.3)
        states[1, :, joint] = scale * (np.cos(phase) @ (rate * sine) - np.sin(phase) @ (rate * cosine))
        states[2, :, joint] = -scale * (np.sin(phase) @ (rate**2 * sine) + np.cos(phase) @ (rate**2 * cosine))
    return states[0], states[1], states[2]


@cache
def simulated(seed: int, *, tool: bool = False, slow: bool = False) -> tuple[FloatArray, FloatArray]:
    """(R, 6) positions and torques of 20 s at 100 Hz."""
    model = pinocchio.buildModelFromXML(arm())
    if tool:
        model.inertias[6] += TOOL
    states = slow_motion(seed) if slow else fourier_motion(6, period_s=20.0, samples=2000, seed=seed)
    data = model.createData()
    rigid = np.array([pinocchio.rnea(model, data, *state) for state in zip(*states, strict=True)])
    friction = VISCOUS * states[1] + COULOMB * np.tanh(states[1] / 0.005) + OFFSET
    noise = NOISE * np.random.default_rng(seed).standard_normal(rigid.shape)
    return states[0], rigid + friction + noise


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("arm")
    (found / "arm.urdf").write_text(arm())
    return found


def recorded(
    folder: Path, seed: int = 5, *, tool: bool = False, slow: bool = False,
    change: Callable[[FloatArray], FloatArray] = np.asarray,
) -> Recording:  # fmt: skip
    position, torque = simulated(seed, tool=tool, slow=slow)
    np.savez(folder / f"{seed}.npz", t=0.01 * np.arange(2000), q=position, tau=change(torque), robot="arm.urdf")
    return read_recording(folder / f"{seed}.npz")


@pytest.fixture(scope="module")
def fitted(folder: Path) -> Model:
    robot = load_robot(folder / "arm.urdf")
    result = fit_recordings([recorded(folder, 4)], robot, FitSettings(physical=False))
    return read_model(write_model(result.to_model_json(notes=False), folder / "model.json"))


def asked(folder: Path, recording: Recording, model: Model | str = "arm.urdf", robot: str = "arm.urdf") -> Audit:
    return audit([recording], load_robot(folder / robot), folder / model if isinstance(model, str) else model)


def named(found: Audit) -> list[tuple[str, tuple[int | None, ...]]]:
    return [(item.effect, item.joints or (item.joint or item.link,)) for item in found.differences]


def times(joint: int, factor: float) -> Callable[[FloatArray], FloatArray]:
    return lambda torque: torque * np.where(np.arange(6) == joint - 1, factor, 1.0)


def test_exchanged_torques_are_named_against_a_file_that_knows_no_friction(folder: Path) -> None:
    """Friction is half of the torque of the wrist: it hid the order, and the file was said to hold."""
    found = asked(folder, recorded(folder, change=lambda torque: torque[:, [0, 1, 2, 4, 3, 5]]))
    assert named(found) == [("wrong_joint_order", (4, 5))]


def test_exchanged_torques_are_named_beside_a_tool_that_nobody_knows(folder: Path, fitted: Model) -> None:
    """A sign of joint 5 and a load in the wrong place were named."""
    found = asked(folder, recorded(folder, tool=True, change=lambda torque: torque[:, [0, 1, 2, 3, 5, 4]]), fitted)
    assert named(found) == [("wrong_joint_order", (5, 6)), ("payload", (6,))]
    low, high = found.differences[1].numbers[0].interval
    assert low < TOOL.mass < high


def test_a_sign_is_named_beside_exchanged_torques(folder: Path) -> None:
    change = times(2, -1.0)  # the place of joint 2, where the torque of joint 3 stands
    found = asked(folder, recorded(folder, change=lambda torque: change(torque[:, [0, 2, 1, 3, 4, 5]])))
    assert named(found) == [("wrong_joint_order", (2, 3)), ("inverted_torque_sign", (3,))]


def test_a_sensor_that_measures_next_to_nothing_is_no_wrong_order(folder: Path) -> None:
    found = asked(folder, recorded(folder, change=times(4, 0.01)))
    assert named(found) == [("torque_sensor_gain", (4,))]


def test_a_joint_that_counts_the_other_way_is_seen_against_a_file(folder: Path) -> None:
    """The file was said to hold: what it leaves was compared with what any rigid body leaves."""
    (folder / "turned.urdf").write_text(arm(turned=4))
    found = asked(folder, recorded(folder), "turned.urdf", robot="turned.urdf")
    assert named(found) == [("wrong_joint_order", (4,))]
    assert "counts the other way" in found.sentence


def test_bodies_that_are_all_too_heavy_are_no_position_with_the_wrong_sign(folder: Path) -> None:
    """A joint turned made the file's torque a little smaller, and was named, though nearly all of the misfit stayed."""
    (folder / "heavy.urdf").write_text(arm(heavier=1.3))
    assert {effect for effect, _ in named(asked(folder, recorded(folder, 21, slow=True), "heavy.urdf"))} <= {
        "torque_sensor_gain"
    }


def test_a_torque_of_the_motors_is_a_scale_and_no_model_that_shows_too_little(folder: Path, fitted: Model) -> None:
    found = asked(folder, recorded(folder, change=lambda torque: 0.01 * torque), fitted)
    assert named(found) == [("torque_sensor_gain", (None,))]
    assert found.differences[0].numbers[0].value == pytest.approx(0.01, rel=0.05)


def test_a_file_is_not_said_to_hold_alone_where_no_rigid_body_would(folder: Path) -> None:
    """A sensor that is plugged in the other way half-way through: nothing that holds for all rows explains it."""
    half = np.where(np.arange(2000) < 1000, 1.0, -1.0)
    found = asked(folder, recorded(folder, change=lambda torque: torque * np.column_stack([half, *5 * [abs(half)]])))
    assert not found.differences
    assert "as well as any rigid body" in found.sentence
    assert "all parameters fitted anew" in found.sentence
