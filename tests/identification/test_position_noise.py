"""What the noise of the position does to the band that `fit` chooses without periods.

Truth: the level of white noise in closed form, 2 h σ² for a step h; and Pinocchio's inertia matrix, through which noise
of the acceleration makes torque.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pinocchio
import pytest

from identification.base_parameters import BaseRegressor
from identification.fitting.band import band_of_motion, choose_low_pass, position_noise
from identification.fitting.settings import FitSettings
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import RobotModel, load_robot
from tests.identification.synthetic import inverse_dynamics, table_three

FloatArray = npt.NDArray[np.float64]

RATE_HZ, DURATION_S = 1000.0, 60.0
TORQUE_NOISE_NM = np.array([0.03, 0.03, 0.02, 0.02, 0.01, 0.01, 0.01])
"""All of it below 5 Hz."""


def smooth_motion(random: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """q, q̇, q̈ (S, 7) of eight waves a joint below 0.5 Hz: nothing repeats."""
    clock = np.arange(0.0, DURATION_S, 1.0 / RATE_HZ)
    turning = 2.0 * np.pi * random.uniform(0.05, 0.5, (8, 7))
    size, angle = random.normal(size=(8, 7)) / turning, clock[:, None, None] * turning
    waves = size * np.sin(angle), size * turning * np.cos(angle), -size * turning**2 * np.sin(angle)
    q, dq, ddq = (0.25 * wave.sum(axis=1) for wave in waves)
    return q, dq, ddq


def recorded(folder: Path, robot: RobotModel, position_noise_rad: float) -> Recording:
    """Slow noise of the torque, white noise of the position."""
    random = np.random.default_rng(3)
    q, dq, ddq = smooth_motion(random)
    torque = inverse_dynamics(robot, table_three(), q, dq, ddq)
    slow = np.fft.rfft(random.standard_normal(torque.shape), axis=0)
    slow[np.fft.rfftfreq(len(q), 1.0 / RATE_HZ) > 5.0] = 0.0
    noise = np.fft.irfft(slow, n=len(q), axis=0)
    torque = torque + TORQUE_NOISE_NM * noise / noise.std(axis=0)
    file = folder / "smooth.npz"
    np.savez(
        file,
        t=np.arange(len(q)) / RATE_HZ,
        q=q + position_noise_rad * random.standard_normal(q.shape),
        tau=torque,
        robot="iiwa14",
    )
    return read_recording(file)


def plant(robot: RobotModel) -> pinocchio.Model:
    """Pinocchio's model with the plant's bodies."""
    model, links = robot.pinocchio_model.copy(), table_three()
    for link in range(links.n):
        model.inertias[link + 1] = pinocchio.Inertia(
            float(links.mass[link]), links.center_of_mass[link], links.inertia[link]
        )
    return model


def test_the_level_is_that_of_the_noise_whatever_the_motion(tmp_path: Path) -> None:
    recording = recorded(tmp_path, load_robot("iiwa14"), 1e-5)
    # The median of 3600 lines scatters by 1 / (log 2 · 60) of itself: 2.4 %.
    assert position_noise(recording) == pytest.approx(2.0 / RATE_HZ * 1e-10, rel=0.1, abs=0.0)


def test_hours_between_two_stretches_are_no_part_of_the_motion(tmp_path: Path) -> None:
    """A spline went through the gap at the sampling rate: a week of it asked for more memory than there is."""
    recording = recorded(tmp_path, load_robot("iiwa14"), 1e-5)
    apart = replace(recording, time=recording.time + 7200.0 * (np.arange(recording.samples) >= 20_000))
    assert position_noise(apart) == pytest.approx(2.0 / RATE_HZ * 1e-10, rel=0.12, abs=0.0)
    assert band_of_motion(apart) == 10.0


@pytest.mark.parametrize("size", [1e-8, 3e-6, 1e-5])
def test_no_band_is_taken_in_which_the_position_makes_a_quarter_of_what_is_left(tmp_path: Path, size: float) -> None:
    """Mean square of a white position's second derivative up to f: (2 π)⁴ f⁵ / 5 times the level."""
    robot = load_robot("iiwa14")
    recording = recorded(tmp_path, robot, size)
    found = choose_low_pass([recording], BaseRegressor(robot))
    model = plant(robot)
    poses = recording.position[::300]
    squared = np.mean([pinocchio.crba(model, model.createData(), pose) ** 2 for pose in poses], axis=0)
    growth = squared.sum(axis=1) * 2.0 / RATE_HZ * size**2 * (2.0 * np.pi) ** 4 / 5.0
    shares = {
        band: (growth * band**5 / (TORQUE_NOISE_NM**2 + growth * band**5)).max()
        for band in 10.0 * 2.0 ** (0.5 * np.arange(6))
    }
    allowed = [band for band, share in shares.items() if band == 10.0 or share < 0.25]
    assert max(found.deviations) == pytest.approx(max(allowed))
    refused = [band for band in shares if band > max(allowed)]
    assert found.noisy_hz == (pytest.approx(min(refused)) if refused else None)
    assert ("noise of the position" in found.sentence) == bool(refused)


@pytest.mark.parametrize("size", [1e-4, 1e-3])
def test_noise_and_steps_of_the_position_are_no_motion(tmp_path: Path, size: float) -> None:
    """In velocity they grow with the frequency: a twentieth of its square was theirs, and all 60 Hz were compared.

    Truth: ten times 0.5 Hz, above which nothing moves here, are less than the 10 Hz that every band holds.
    """
    robot = load_robot("iiwa14")
    noisy = recorded(tmp_path, robot, size)
    smooth = recorded(tmp_path, robot, 0.0)
    coarse = replace(smooth, position=np.round(smooth.position / size) * size)
    assert [band_of_motion(each) for each in (smooth, noisy, coarse)] == [10.0] * 3
    assert choose_low_pass([noisy], BaseRegressor(robot)).low_pass_hz < 20.0


ASKEW = """<robot name="askew"><link name="l0"/><link name="l1"/><link name="l2"/><link name="l3"/>
<joint name="j1" type="revolute"><parent link="l0"/><child link="l1"/><origin xyz="-0.27 -0.11 -0.17"
 rpy="0.83 0.89 -0.98"/><axis xyz="0.03 0.92 0.39"/><limit lower="-9" upper="9" velocity="9" effort="900"/></joint>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="-0.16 -0.12 0.12"
 rpy="-1.07 0.36 0"/><axis xyz="0.54 -0.18 0.82"/><limit lower="-9" upper="9" velocity="9" effort="900"/></joint>
<joint name="j3" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0.04 0.06 -0.13"
 rpy="0.2 0.48 0.76"/><axis xyz="-0.63 0.07 -0.78"/><limit lower="-9" upper="9" velocity="9" effort="900"/></joint>
</robot>"""


def swinging(clock: FloatArray, size: FloatArray, turning: FloatArray, phase: FloatArray) -> list[FloatArray]:
    """(S, n) each: position, velocity and acceleration of sines; size, turning, phase: (k, n) rad, rad/s, rad."""
    angle = clock[:, None, None] * turning + phase
    waves = size * np.sin(angle), size * turning * np.cos(angle), -size * turning**2 * np.sin(angle)
    return [wave.sum(axis=1) for wave in waves]


def test_inertias_that_the_noise_has_shrunk_do_not_say_how_much_torque_it_makes(tmp_path: Path) -> None:
    """Of an arm whose inertias a motion tells badly, a wider band left ever less inertia, and the wider ones passed."""
    (tmp_path / "askew.urdf").write_text(ASKEW, encoding="utf-8")
    robot, random = load_robot(tmp_path / "askew.urdf"), np.random.default_rng(0)
    clock = np.arange(0.0, 20.0, 0.004)
    turning = 2.0 * np.pi * random.uniform(0.05, 0.25, (5, 3))
    size, phase = 0.35 * random.normal(size=(5, 3)), random.uniform(0.0, 6.0, (5, 3))
    q, dq, ddq = swinging(clock, size, turning, phase)
    bodies = PhysicalParameters(
        mass=np.full(3, 3.0),
        center_of_mass=np.full((3, 3), 0.05),
        inertia=np.tile(0.03 * np.eye(3), (3, 1, 1)),
        viscous=np.ones(3),
        coulomb=np.ones(3),
    )
    torque = inverse_dynamics(robot, bodies, q, dq, ddq) + 0.2 * random.normal(size=q.shape)
    np.savez(tmp_path / "coarse.npz", t=clock, q=np.round(q, 3), tau=torque, robot="askew.urdf")
    found = choose_low_pass([read_recording(tmp_path / "coarse.npz")], BaseRegressor(robot))
    assert found.noisy_hz == pytest.approx(20.0)
    assert found.low_pass_hz < 20.0


def test_slow_joints_whose_sign_the_noise_turns_are_compared_in_a_narrow_band(tmp_path: Path) -> None:
    """σ of every band came from velocities of the widest, whose sign the noise turned: narrow bands looked dearer.

    60 Hz were compared, and a viscous friction of 5 Nm s/rad came out as 3.2 to 3.4.
    """
    (tmp_path / "askew.urdf").write_text(ASKEW, encoding="utf-8")
    robot, random = load_robot(tmp_path / "askew.urdf"), np.random.default_rng(5)
    clock = np.arange(0.0, 40.0, 0.002)
    turning = 2.0 * np.pi * random.uniform(0.05, 0.5, (5, 3))
    q, dq, ddq = swinging(clock, 0.05 * random.normal(size=(5, 3)) / turning, turning, np.zeros((5, 3)))
    bodies = PhysicalParameters(
        mass=np.full(3, 5.0),
        center_of_mass=np.full((3, 3), 0.1),
        inertia=np.tile(0.3 * np.eye(3), (3, 1, 1)),
        viscous=np.full(3, 5.0),
        coulomb=np.full(3, 8.0),
    )
    torque = inverse_dynamics(robot, bodies, q, dq, ddq) + 0.3 * random.normal(size=q.shape)
    np.savez(tmp_path / "slow.npz", t=clock, q=q + 2e-5 * random.normal(size=q.shape), tau=torque, robot="askew.urdf")
    settings = FitSettings(rotor_inertia="no", offset="no", physical=False)
    result = fit_recordings([read_recording(tmp_path / "slow.npz")], robot, settings)
    truth = result.regressor.base_from_physical(bodies)
    assert (np.abs(result.values - truth) < 4.0 * result.std).all()
    friction = [result.names.index(f"FV_{joint}") for joint in (1, 2, 3)]
    assert result.values[friction] == pytest.approx(5.0, rel=0.02)
