"""Claims about what the data choose of the nominal model: offsets, the width of friction, the band, and what is said.

Truth: Table 3 through Pinocchio's inverse dynamics plus torque written down here, and published answers of recordings.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pinocchio
import pytest
from scipy.signal import butter, sosfiltfilt

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.estimators.least_squares import LeastSquaresResult
from identification.estimators.observation import ReducedProblem
from identification.fitting.choice import Rival, with_choice
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.recordings import read_recording
from identification.recordings.reader import robot_of
from identification.robots import RobotModel, load_robot
from tests.identification.mismatch.plant import Hidden, on_joint, record
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of
from tests.reference import recording_file

FloatArray = npt.NDArray[np.float64]

BASE_ONLY = FitSettings(physical=False)
OFFSETS_NM = np.array([0.5, -0.4, 0.3, 0.35, -0.25, 0.2, 0.15])
FAINT_OFFSETS_NM = 1e-3 * np.array([1.0, -1.5, 1.0, 1.5, -1.0, 1.0, -1.0])
THREE_OFFSETS_NM = np.array([0.0, 0.02, 0.0, 0.0, -0.03, 0.02, 0.0])
DRAWS = 4
ROTORS = np.array([0.35, 0.35, 0.12, 0.04, 0.04, 0.012])


def _coverage(iiwa14: RobotModel, table3: PhysicalParameters, hidden: Hidden) -> tuple[float, list[FitResult]]:
    """Share of the true parameters of Table 3 within 95 % intervals, over several draws of noise."""
    inside, results = [], []
    for seed in range(DRAWS):
        result = fit_recordings([record(iiwa14, table3, hidden, seed=seed)], iiwa14, BASE_ONLY)
        truth = dict(zip(result.names, result.regressor.base_from_physical(table3), strict=True))
        truth.update({f"OFF_{joint}": value for joint, value in enumerate(OFFSETS_NM, start=1)})
        error = result.values - np.array([truth[name] for name in result.names])
        inside.append(np.abs(error) < 1.959964 * result.std)
        results.append(result)
    return float(np.mean(np.concatenate(inside))), results


def _offsets(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
    return np.tile(OFFSETS_NM, (len(q), 1))


def test_offsets_on_the_whole_arm_are_chosen_and_intervals_hold(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    coverage, results = _coverage(iiwa14, table3, _offsets)
    assert all(result.regressor.options.offset for result in results)
    assert 0.90 < coverage < 0.99
    assert not results[0].misfit.detected.any()
    assert any("offset" in note for note in results[0].notes)


@pytest.mark.parametrize("offsets", [FAINT_OFFSETS_NM, THREE_OFFSETS_NM])
def test_intervals_hold_where_offsets_are_there_and_not_chosen(
    iiwa14: RobotModel, table3: PhysicalParameters, offsets: FloatArray
) -> None:
    """A fit without them is biased by them: the interval is that of a choice, not of a model that was given."""

    def hidden(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
        return np.tile(offsets, (len(q), 1))

    coverage, results = _coverage(iiwa14, table3, hidden)
    assert not any(result.regressor.options.offset for result in results)
    assert 0.92 < coverage < 0.99


def test_intervals_hold_where_a_slow_motion_leaves_rotor_inertias_out() -> None:
    """The motor's torque holds IA q̈; without it other inertias were off, and RMS of z was 1.5.

    Truth: Pinocchio's inverse dynamics of drawn bodies, which no noise is on, solved for the base parameters.
    """
    robot, generator = load_robot(recording_file("tx40.urdf")), np.random.default_rng(3)
    model = robot.pinocchio_model.copy()
    for joint in range(1, model.njoints):
        mass, center = 8.0 / joint + 1.0, generator.uniform(-0.08, 0.08, 3) + np.array([0.0, 0.0, 0.05])
        model.inertias[joint] = pinocchio.Inertia(mass, center, 0.01 * mass * np.diag(generator.uniform(0.8, 1.2, 3)))
    data = model.createData()

    def torque_of(*states: FloatArray) -> FloatArray:
        rigid = np.array([pinocchio.rnea(model, data, *state) for state in zip(*states, strict=True)])
        return rigid + ROTORS * states[2] + 2.0 * states[1] + 3.0 * np.sign(states[1])

    whole, states = BaseRegressor(robot, RegressorOptions(rotor_inertia=True)), generator.normal(size=(3, 100, 6))
    rows = np.zeros((100, 6, len(whole.names)))
    for joint, (columns, used) in enumerate(whole.joint_columns(*states)):
        rows[:, joint, used] = columns.T
    solved = np.linalg.lstsq(rows.reshape(600, -1), torque_of(*states).ravel(), rcond=None)[0]
    truth = dict(zip(whole.names, solved, strict=True))
    position, *rates = fourier_motion(6, period_s=60.0, samples=4000, seed=7)
    torque, squares = torque_of(position, *rates), []
    for _ in range(2):
        noise = generator.normal(0.0, 0.3, (16000, 6))
        recording = recording_of(np.tile(position, (4, 1)), np.tile(torque, (4, 1)) + noise, period_s=60.0, periods=4)
        result = fit_recordings([replace(recording, robot=robot.spec)], robot, BASE_ONLY)
        assert not result.regressor.options.rotor_inertia
        squares.append(((result.values - [truth[name] for name in result.names]) / result.std) ** 2)
    assert 0.8 < float(np.sqrt(np.mean(squares))) < 1.15


def test_the_interval_of_a_choice_is_the_mean_over_the_models_considered() -> None:
    """By hand: weights 1 : 3, variances 1 and 4, estimates 2 apart: (1 + 3 (4 + 2²)) / 4 = 6.25."""
    chosen, larger = (
        LeastSquaresResult(
            names, values, np.ones(0), covariance, 0.0, 1.0, np.ones(0), ReducedProblem(
                covariance, values, 0.0, 1
            ),
        )
        for names, values, covariance in (
            (("FV_1",), np.array([1.0]), np.eye(1)),
            (("OFF_1", "FV_1"), np.array([9.0, 3.0]), np.diag([7.0, 4.0])),
        )
    )  # fmt: skip
    found = with_choice(chosen, [Rival(larger, float(np.log(3.0)))])
    assert found.values.tolist() == [1.0]
    assert found.std == pytest.approx([2.5])
    assert with_choice(chosen, []) is chosen
    assert with_choice(larger, [Rival(chosen, 9.0)]) is larger


@pytest.mark.parametrize("velocity", [5e-3, 2e-2, 8e-2])
def test_a_width_of_friction_on_the_whole_arm_is_chosen_and_intervals_hold(
    iiwa14: RobotModel, table3: PhysicalParameters, velocity: float
) -> None:
    def blunt(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
        return np.asarray(table3.coulomb * (np.tanh(dq / velocity) - np.sign(dq)))

    coverage, results = _coverage(iiwa14, table3, blunt)
    widths = [result.regressor.options.coulomb_velocity for result in results]
    assert widths == pytest.approx([velocity] * DRAWS, rel=0.15)
    assert 0.90 < coverage < 0.99
    assert not results[0].misfit.detected.any()


def test_a_clean_arm_gets_neither_and_nothing_but_noise_is_said(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    result = fit_recordings([record(iiwa14, table3)], iiwa14, BASE_ONLY)
    assert (result.regressor.options.offset, result.regressor.options.coulomb_velocity) == (False, 0.0)
    assert result.misfit.over_noise.max() < 0.5
    assert "Nothing but noise" in result.misfit.sentence


@pytest.mark.parametrize(("cutoff_hz", "kind"), [(3.0, "npz"), (8.0, "npz"), (20.0, "npz"), (8.0, "log")])
def test_a_torque_that_was_filtered_before_gives_the_parameters_of_the_arm(
    iiwa14: RobotModel, table3: PhysicalParameters, cutoff_hz: float, kind: str
) -> None:
    """Zero-phase, fourth order: lines near the cutoff are smaller than the model's, and beyond it no noise is left
    that would keep their weight low. Parameters came out up to 36 σ off. A cabinet may filter what our own log holds.
    """
    clean = record(iiwa14, table3)
    sections = butter(4, cutoff_hz * 2.0 * clean.sampling_period_s, output="sos")
    filtered = replace(
        clean, torque=sosfiltfilt(sections, clean.torque, axis=0), source=replace(clean.source, kind=kind)
    )
    result = fit_recordings([filtered], iiwa14, BASE_ONLY)
    assert (result.regressor.options.offset, result.regressor.options.coulomb_velocity) == (False, 0.0)
    deviations = (result.values - result.regressor.base_from_physical(table3)) / result.std
    assert 0.7 < np.sqrt(np.mean(deviations**2)) < 1.4
    assert any("filtered" in note and "half of that" in note for note in result.notes)


def test_what_three_joints_show_stays_theirs_and_the_diagnosis_is_named(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """1 Nm on a noise of 0.018: a fit that says nothing lets its intervals be believed."""

    def on_three(q: FloatArray, dq: FloatArray, torque: FloatArray) -> FloatArray:
        one = np.ones(len(q))
        return on_joint(2, 1.0 * one) + on_joint(3, 0.5 * np.tanh(dq[:, 2] / 0.05)) + on_joint(5, 0.3 * one)

    result = fit_recordings([record(iiwa14, table3, on_three)], iiwa14, BASE_ONLY)
    assert not result.regressor.options.offset
    assert result.misfit.detected[[1, 4]].all()
    assert "iiwa-ident diagnose" in result.misfit.sentence
    assert result.to_model_json()["misfit"]["detected"] == result.misfit.detected.tolist()


def test_without_a_repeated_motion_the_fit_says_that_misfit_and_noise_are_one(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    result = fit_recordings([record(iiwa14, table3, periods=1)], iiwa14, BASE_ONLY)
    assert not result.misfit.known
    assert not result.misfit.detected.any()
    assert "cannot be told apart" in result.misfit.sentence


def test_emps_at_the_chosen_band_agrees_with_the_published_mass() -> None:
    """Janot, Gautier, Brunot: M = 95.109 ± 0.109 kg, Fv = 203.5 N s/m, Fc = 20.39 N, offset −3.165 N."""
    recording = read_recording(recording_file("emps_a.npz"))
    result = fit_recordings([recording], load_robot(recording_file("emps.urdf")), BASE_ONLY)
    found = {name: (value, std) for name, value, std in zip(result.names, result.values, result.std, strict=True)}
    for name, published in (("M_1", 95.109), ("FV_1", 203.50), ("FS_1", 20.39), ("OFF_1", -3.165)):
        value, std = found[name]
        assert abs(value - published) < 2.0 * std, name
    assert found["M_1"][1] < 0.2
    assert result.settings.low_pass_hz is not None
    assert any(f"Compared up to {result.settings.low_pass_hz:g} Hz" in note for note in result.notes)


def test_resonances_of_the_panda_are_left_outside_the_chosen_band() -> None:
    """From 14 Hz on its joints ring, which no column describes: σ of the parameters grows with the band."""
    recording = read_recording(recording_file("panda_excitation.npz"))
    result = fit_recordings([recording], load_robot(robot_of([recording])), BASE_ONLY)
    assert result.settings.low_pass_hz == 10.0


def test_a_motion_that_goes_on_beyond_20_hz_is_followed(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """As that of a soft controller does after each reversal of friction: its torque was compared up to 60 Hz, its
    acceleration was cut off at 20, and every joint seemed to lack something that follows its torque late.
    """
    period_s, samples, periods, last = 10.0, 2500, 8, 350
    random, line = np.random.default_rng(3), np.arange(1, last + 1)
    size = np.where(line <= 5, 0.05 / line, 2e-3 / line**1.5)[:, None] * random.normal(size=(2, last, 7))
    rate = (2.0 * np.pi / period_s * line)[:, None, None]
    angle = rate * (np.arange(samples) * period_s / samples)[None, :, None]
    parts = [
        (factor * (size[0][:, None] * one + size[1][:, None] * other)).sum(axis=0)
        for factor, one, other in (
            (1.0, np.sin(angle), np.cos(angle)),
            (rate, np.cos(angle), -np.sin(angle)),
            (-(rate**2), np.sin(angle), np.cos(angle)),
        )
    ]
    torque = inverse_dynamics(iiwa14, table3, *parts)
    noise = 0.01 * random.normal(size=(periods * samples, 7))
    recording = recording_of(
        np.tile(parts[0], (periods, 1)), np.tile(torque, (periods, 1)) + noise, period_s=period_s, periods=periods
    )
    found = fit_recordings([recording], iiwa14, BASE_ONLY)
    assert not found.misfit.detected.any()
