"""A claim about friction of a joint that is slow: the audit and the fit see nearly the same.

Truth: Coulomb friction by the sign of the velocity, written here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from identification.arrays import FloatArray
from identification.audit.between import changes_between, model_of
from identification.audit.given import HIDDEN, _at_another_speed
from identification.recordings import Recording, read_recording
from identification.robots import load_robot

WHEEL = """<robot name="wheel"><link name="base"/><link name="rim"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="axle" type="continuous"><parent link="base"/><child link="rim"/><axis xyz="0 0 1"/></joint></robot>"""


def turning(folder: Path, seed: int, size: FloatArray, torque_of: Callable[[FloatArray, FloatArray], FloatArray],
            noise_nm: float) -> Recording:  # fmt: skip
    """30 s of three sines of `size` rad/s with phases of their own. torque_of: Nm of velocity and acceleration."""
    random = np.random.default_rng(seed)
    time, pace = np.arange(6000) * 0.005, 2.0 * np.pi * np.array([0.11, 0.23, 0.37])
    turns = time[:, None] * pace + random.uniform(0.0, 6.0, 3)
    velocity, acceleration = (size * np.sin(turns)).sum(axis=1), (size * pace * np.cos(turns)).sum(axis=1)
    torque = torque_of(velocity, acceleration) + noise_nm * random.normal(size=time.size)
    (folder / "wheel.urdf").write_text(WHEEL)
    position = -(size / pace * np.cos(turns)).sum(axis=1)
    np.savez(folder / f"{seed}.npz", t=time, q=position[:, None], tau=torque[:, None], robot="wheel.urdf")
    return read_recording(folder / f"{seed}.npz")


def recorded(folder: Path, seed: int, coulomb_nm: float) -> Recording:
    """Below 0.065 rad/s."""

    def torque(velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        return 20.0 * acceleration + 30.0 * velocity + coulomb_nm * np.sign(velocity)

    return turning(folder, seed, np.array([0.03, 0.02, 0.015]), torque, 0.05)


def lifted(folder: Path, seed: int, speed: float) -> Recording:
    """The fastest term is `speed` rad/s; friction turns over within 0.002 rad/s."""

    def torque(velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        return 3.0 * acceleration + 15.0 * velocity + 8.0 * np.tanh(velocity / 0.002)

    return turning(folder, seed, speed * np.array([1.0, 0.7, 0.5]), torque, 0.02)


def lift(folder: Path) -> Path:
    """Wheels of 1 kg m² on one upright axis; a lift of 3 kg carries the last two."""
    body = WHEEL[WHEEL.index("<inertial>") : WHEEL.index("</inertial>")] + "</inertial>"
    links = "".join(f'<link name="l{number}">{body}</link>' for number in range(1, 5))
    joints = "".join(
        f'<joint name="j{number}" type="{"prismatic" if number == 2 else "revolute"}"><parent link="l{number - 1}"/>'
        f'<child link="l{number}"/><axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="99" velocity="9"/></joint>'
        for number in range(1, 5)
    )
    (folder / "lift.urdf").write_text(f'<robot name="lift"><link name="l0"/>{links}{joints}</robot>')
    return folder / "lift.urdf"


def lifting(folder: Path, seed: int, rate_hz: int, more: float) -> Recording:
    """Four periods of three sines, the lift up to 0.3 m/s. more: times the Coulomb friction of joint 3."""
    random = np.random.default_rng(seed)
    time, pace = np.arange(20 * rate_hz) / rate_hz, 2.0 * np.pi * np.array([0.2, 0.4, 0.8])
    turns = time[:, None, None] * pace + random.uniform(0.0, 6.0, (4, 3))
    size = np.array([[1.0], [0.2], [1.0], [1.0]]) * [0.6, 0.5, 0.4]
    position, velocity, acceleration = (
        each.sum(axis=2) for each in (-size / pace * np.cos(turns), size * np.sin(turns), size * pace * np.cos(turns))
    )
    turning = np.cumsum(acceleration * [1.0, 0.0, 1.0, 1.0], axis=1) * [1.0, 0.0, 1.0, 1.0]
    turning[:, 0] += turning[:, 0]  # the lift turns with the first wheel
    inertia = np.cumsum(turning[:, ::-1], axis=1)[:, ::-1]
    inertia[:, 1] = 3.0 * (acceleration[:, 1] + 9.81)
    coulomb = np.array([2.0, 8.0, 1.5 * more, 0.5])
    torque = inertia + velocity * [3.0, 20.0, 2.0, 0.5] + coulomb * np.sign(velocity)
    torque += random.normal(size=torque.shape) * [0.3, 0.9, 0.2, 0.06]
    np.savez(folder / f"{seed}.npz", t=time, q=position, tau=torque, robot="lift.urdf", period_s=5.0)
    return read_recording(folder / f"{seed}.npz")


def test_what_an_audit_sees_of_coulomb_friction_is_what_the_fit_does(tmp_path: Path) -> None:
    """With friction that turns over within 0.02 rad/s, a third of this joint's speed, 3 Nm more of it were 3.4."""
    first, second = recorded(tmp_path, 1, 1.0), recorded(tmp_path, 2, 4.0)
    robot = load_robot(tmp_path / "wheel.urdf")
    change = changes_between(model_of(first, robot), second, robot)
    (friction,) = (item for item in change.parameters if item.name == "FS_1")
    assert friction.after - friction.before == pytest.approx(3.0, rel=0.01)
    assert change.audit.rms_before[0] == pytest.approx(3.0, rel=0.03)


def test_a_slow_sound_pair_does_not_differ(tmp_path: Path) -> None:
    """Friction by the sign of the velocity, seen as if it turned over gently, leaves 0.66 Nm for a noise of 0.01 Nm."""
    first, second = recorded(tmp_path, 1, 4.0), recorded(tmp_path, 2, 4.0)
    robot = load_robot(tmp_path / "wheel.urdf")
    audit = changes_between(model_of(first, robot), second, robot).audit
    assert (audit.verdict, audit.holds) == ("nothing", True)


def test_a_slide_makes_no_difference_and_bends_none(tmp_path: Path) -> None:
    """Three wheels on one axis, a lift between the first two: its 8 N of friction turn over at once.

    Two rates were two arms, all on the slide; 0.6 Nm more of friction on joint 3 were 0.69 ± 0.11 Nm, and 77 %.
    """
    robot = load_robot(lift(tmp_path))
    model = model_of(lifting(tmp_path, 1, 200, 1.0), robot)
    assert changes_between(model, lifting(tmp_path, 2, 800, 1.0), robot).audit.verdict == "nothing"
    (change,) = changes_between(model, lifting(tmp_path, 2, 200, 1.4), robot).audit.differences
    assert (change.effect, change.joint) == ("friction_change", 3)
    assert change.numbers[0].value == pytest.approx(0.6, rel=0.05)
    assert change.explained > 0.9


def test_friction_at_another_speed_is_no_change(tmp_path: Path) -> None:
    """One arm, fast and then slow: its friction turns over by a curve, and the line of the fit holds at its speed."""
    fast, slow = lifted(tmp_path, 1, 0.1), lifted(tmp_path, 2, 0.008)
    robot = load_robot(tmp_path / "wheel.urdf")
    assert not changes_between(model_of(fast, robot), slow, robot).audit.differences


def test_what_a_fit_leaves_is_as_much_again_at_twice_its_speed() -> None:
    """Closed form: a line that is 1 Nm off at 0.5 rad/s is 1 Nm further off at 1 rad/s, and no further at 0.5 rad/s."""
    left, its_own = np.ones(2), np.array([0.5, 0.5])
    viscous, coulomb = _at_another_speed(left, its_own, np.array([1.0, 0.5]))[:, [10, 11]].T
    assert viscous * [1.0, 0.5] == pytest.approx([np.hypot(1.0, HIDDEN), HIDDEN])
    assert coulomb == pytest.approx([np.hypot(0.5, HIDDEN), HIDDEN])
    assert not _at_another_speed(left, None, its_own).any()
