"""Claims about the parameters of two recordings. Truth: Table 3 of the paper with drives that are known here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from identification.audit.between import changes_between, fitted_to, model_of, model_of_fit
from identification.audit.trend import trend_of
from identification.fitting.settings import FitSettings
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import fit_recordings
from identification.recordings import Recording
from identification.robots import RobotModel
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

WIDTH = 0.15
ROTOR = np.array([4.0, 4.0, 2.0, 2.0, 1.0, 0.5, 0.5])


def record(robot: RobotModel, plant: PhysicalParameters, seed: int, *, rotor: float = 0.0, gentle: bool = False,
           periods: int = 1) -> Recording:  # fmt: skip
    """A motion of its own for each seed, with white noise. rotor: times ROTOR. gentle: friction turns over by WIDTH."""
    q, dq, ddq = fourier_motion(7, period_s=8.0, samples=1600, seed=seed, speed=0.4)
    torque = inverse_dynamics(robot, plant, q, dq, ddq) + rotor * ROTOR * ddq
    if gentle:
        torque += plant.coulomb * (np.tanh(dq / WIDTH) - np.sign(dq))
    torque = np.tile(torque, (periods, 1))
    torque += np.random.default_rng(seed).normal(scale=0.02, size=torque.shape)
    return recording_of(np.tile(q, (periods, 1)), torque, period_s=8.0, periods=periods)


def test_parameters_are_compared_beside_the_same_drives(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """A fit of the second recording alone takes no rotor inertias for this arm: its links had them, by dozens of σ."""
    first, second = (record(iiwa14, table3, seed, rotor=1.0) for seed in (1, 2))
    settings = FitSettings(rotor_inertia="yes", physical=False)
    model = model_of_fit(fit_recordings([first], iiwa14, settings), "first")
    change = changes_between(model, second, iiwa14)
    assert {"IA_3", "IA_7"} <= {item.name for item in change.parameters}
    assert max(abs(item.sigmas) for item in change.parameters) < 5.0


def test_parameters_are_those_of_the_recording_as_it_has_to_be_read(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """Beside "the torque of joint 2 stands under joint 4" their links had parameters off by dozens of σ."""
    first, second = (record(iiwa14, table3, seed) for seed in (1, 2))
    exchanged = replace(second, torque=second.torque[:, [0, 3, 2, 1, 4, 5, 6]])
    change = changes_between(model_of_fit(fitted_to(first, iiwa14), "first"), exchanged, iiwa14)
    assert [item.joints for item in change.audit.differences] == [(2, 4)]
    assert max(abs(item.sigmas) for item in change.parameters) < 5.0


def test_friction_that_changed_on_two_joints_at_once_is_named_on_both(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """Beside the other one each was as likely a day on which all friction differs, so none was named."""
    more = np.array([0.0, 1.0, 0.0, 1.2, 0.0, 0.0, 0.0])
    first, later = (
        record(iiwa14, replace(table3, coulomb=(1.0 + share) * table3.coulomb), seed)
        for seed, share in ((1, 0.0 * more), (2, more))
    )
    found = changes_between(model_of(first, iiwa14), later, iiwa14).audit.differences
    assert {(item.effect, item.joint) for item in found} == {("friction_change", 2), ("friction_change", 4)}
    for item in found:
        (number,) = item.numbers
        assert item.joint is not None
        low, high = number.interval
        assert low < more[item.joint - 1] * table3.coulomb[item.joint - 1] < high
        assert high - low < 0.3 * number.value


def test_friction_that_is_larger_on_all_joints_is_a_day_on_which_the_arm_ran_cold(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    first, cold = (
        record(iiwa14, replace(table3, coulomb=more * table3.coulomb), seed) for seed, more in ((1, 1.0), (2, 1.3))
    )
    assert not changes_between(model_of(first, iiwa14), cold, iiwa14).audit.differences


def test_friction_at_a_speed_is_what_has_turned_over_by_then(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    series = [record(iiwa14, table3, seed, gentle=True, periods=4) for seed in (1, 2, 3, 4)]
    assert fitted_to(series[0], iiwa14).regressor.options.coulomb_velocity == pytest.approx(WIDTH, rel=0.2)
    for joint in trend_of(series, iiwa14).joints:
        own = joint.joint - 1
        truth = table3.viscous[own] * joint.speed + table3.coulomb[own] * np.tanh(joint.speed / WIDTH)
        assert joint.friction == pytest.approx(truth, abs=4.0 * joint.std.max())


def test_a_recording_that_is_not_what_it_states_is_said_beside_its_changes(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """A filter of `scipy` on its torques was the body of another link, or a load, in silence."""
    first, second = (record(iiwa14, table3, seed) for seed in (1, 2))
    model = model_of_fit(fitted_to(first, iiwa14), "first")
    assert not changes_between(model, second, iiwa14).warnings
    smooth = sosfiltfilt(butter(2, 1.0, fs=200.0, output="sos"), second.torque, axis=0)
    (said,) = changes_between(model, replace(second, torque=smooth), iiwa14).warnings
    assert "low-passed before they were recorded, at 1 Hz" in said
