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


def test_what_an_audit_sees_of_coulomb_friction_is_what_the_fit_does(tmp_path: Path) -> None:
    """With friction that turns over within 0.02 rad/s, a third of this joint's speed, 3 Nm more of it were 3.4."""
    first, second = recorded(tmp_path, 1, 1.0), recorded(tmp_path, 2, 4.0)
    robot = load_robot(tmp_path / "wheel.urdf")
    change = changes_between(model_of(first, robot), second, robot)
    (friction,) = (item for item in change.parameters if item.name == "FS_1")
    assert friction.after - friction.before == pytest.approx(3.0, rel=0.01)
    assert change.audit.rms_before[0] == pytest.approx(3.0, rel=0.03)


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
