"""Evidence: rows, noise and nominal torque of a plant computed by Pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.evidence import (
    Evidence,
    fit_parameters,
    rows_to_time,
    with_parameters,
)
from identification.mismatch.problem import build_problem
from identification.mismatch.reduction import build_evidence
from identification.mismatch.search.extension import extend
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel
from identification.signals.periodic import to_lines
from identification.signals.standstill import STANDSTILL_VELOCITY
from tests.identification.mismatch.plant import NOISE_NM, record
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of


def test_rows_and_noise_are_those_of_the_mean(clean_evidence: Evidence) -> None:
    assert clean_evidence.noise_is_measured
    assert clean_evidence.periods == 8
    assert np.sqrt(np.mean(clean_evidence.noise**2)) == pytest.approx(NOISE_NM / np.sqrt(8), rel=0.05)
    assert clean_evidence.frequency[-1] == pytest.approx(60.0)


def test_nominal_torque_is_the_plants(clean_evidence: Evidence, iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=2000, seed=3)
    truth = inverse_dynamics(iiwa14, table3, q, dq, ddq)
    assert np.sqrt(np.mean((clean_evidence.motion.torque - truth) ** 2)) < 0.3 * NOISE_NM


def test_residual_without_effect_is_noise(clean_evidence: Evidence) -> None:
    problem = build_problem([clean_evidence])
    freedom = problem.residual.size - problem.basis.shape[1]
    assert problem.residual @ problem.residual / freedom == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / freedom))


def test_feedback_noise_does_not_enter_the_acceleration(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    (noisy,) = build_evidence(record(iiwa14, table3, position_noise=1e-5), iiwa14, iiwa14_base)
    _, _, exact = fourier_motion(7, period_s=10.0, samples=2000, seed=3)
    assert np.abs(noisy.motion.acceleration - exact).max() < 1e-4


def test_rows_go_back_to_time(clean_evidence: Evidence) -> None:
    random = np.random.default_rng(1)
    rows = random.normal(size=clean_evidence.torque.shape)
    lines = (rows.shape[0] - 1) // 2
    assert np.allclose(to_lines(rows_to_time(clean_evidence, rows), lines), rows)


def test_torque_while_a_joint_turns_round_does_not_count(
    clean_evidence: Evidence, iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """Dry friction holds a joint with any torque within it, there and then."""
    recording = record(iiwa14, table3)
    _, dq, _ = fourier_motion(7, period_s=10.0, samples=2000, seed=3)
    turning = np.tile((np.abs(dq) < 9e-4).any(axis=1), 8)
    assert turning.any()
    stuck = replace(recording, torque=recording.torque + 0.5 * turning[:, None])
    (evidence,) = build_evidence(stuck, iiwa14, iiwa14_base)
    assert np.allclose(evidence.torque, clean_evidence.torque)


@pytest.mark.parametrize(("slowed", "counts"), [(1.0, True), (0.03, False)])
def test_a_joint_that_turns_round_at_once_is_not_held(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, slowed: float, counts: bool
) -> None:
    """At 1 kHz a fast reversal lasts a sample or two: there a short delay of the torque shows."""
    q, dq, _ = fourier_motion(7, period_s=10.0, samples=10_000, seed=3)
    q[:, 4] *= slowed
    turning = np.abs(slowed * dq[:, 4]) < 9e-4
    torque = np.zeros((10_000, 7))
    torque[:, 4] = turning
    recording = recording_of(np.tile(q, (3, 1)), np.tile(torque, (3, 1)), period_s=10.0, periods=3)
    (evidence,) = build_evidence(recording, iiwa14, iiwa14_base)
    assert turning.any()
    assert evidence.torque.any() == counts


def test_slow_torque_stays_on_its_own_lines_though_samples_are_left_out(clean_evidence: Evidence) -> None:
    """Slow noise chopped at every turn would stand on all high lines at once, and count there as many findings."""
    time = clean_evidence.motion.time
    slow = np.stack([np.cos(2.0 * np.pi * line * time / 10.0 + line) for line in (0, 1, 4, 9)], axis=1)
    rows = clean_evidence.project(slow)
    above = clean_evidence.frequency > 1.5
    assert (rows[above] ** 2).sum(axis=0) == pytest.approx(np.zeros(4), abs=1e-4 * (rows**2).sum(axis=0).min())


def test_of_a_wave_no_more_than_twice_the_share_of_time_bridged_moves_to_other_lines(clean_evidence: Evidence) -> None:
    """A line through means of samples errs by a wave and its mean, which are no larger than the wave, at any phase."""
    time = clean_evidence.motion.time
    constant = np.zeros((time.size, 1))
    slow = (np.abs(clean_evidence.motion.velocity) < STANDSTILL_VELOCITY).any(axis=1)
    bridged = np.any([np.roll(slow, shift) for shift in (-1, 0, 1)], axis=0)
    constant[bridged] = 1.0
    assert not clean_evidence.project(constant).any()
    moved = []
    for frequency_hz in range(1, 61):
        phase = 2.0 * np.pi * frequency_hz * time
        rows = clean_evidence.project(np.stack([np.sin(phase), np.cos(phase)], axis=1))
        elsewhere = np.abs(clean_evidence.frequency - frequency_hz) > 0.05
        moved.append(np.sum(rows[elsewhere] ** 2) / time.size)
    assert 0.0 < bridged.mean() < 0.1
    assert np.mean(moved) < 2.0 * bridged.mean()


def test_a_joint_that_stands_still_leaves_the_others_their_samples(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    recording = record(iiwa14, table3)
    position = recording.position.copy()
    position[:, 4] = 0.3
    (evidence,) = build_evidence(replace(recording, position=position), iiwa14, iiwa14_base)
    compared = rows_to_time(evidence, evidence.project(np.ones((2000, 1))))
    assert compared.mean() > 0.8


def test_quantisation_that_repeats_every_period_does_not_enter_the_acceleration(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    recording = record(iiwa14, table3)
    step = 2e-5
    coarse = replace(recording, position=np.rint(recording.position / step) * step)
    (evidence,) = build_evidence(coarse, iiwa14, iiwa14_base)
    _, _, exact = fourier_motion(7, period_s=10.0, samples=2000, seed=3)
    assert np.abs(evidence.motion.acceleration - exact).max() < 1e-3


def test_recordings_of_one_robot_are_fitted_together(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    parts = [
        build_evidence(record(iiwa14, table3, periods=4, motion=motion, seed=motion), iiwa14, iiwa14_base)[0]
        for motion in (3, 9)
    ]
    values = fit_parameters(parts)
    truth = iiwa14_base.base_from_physical(table3)
    alone = fit_parameters(parts[:1])
    assert np.linalg.norm(values - truth) < np.linalg.norm(alone - truth)
    again = with_parameters(parts[0], iiwa14_base, truth)
    assert np.abs(again.motion.torque - parts[0].motion.torque).max() < 0.2


def test_without_periods_the_noise_is_said_not_to_be_measured(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    from dataclasses import replace

    whole = record(iiwa14, table3, periods=2)
    plain = replace(whole, period_index=None, sample_in_period=None, period_s=None, samples_per_period=None)
    evidences = build_evidence(plain, iiwa14, iiwa14_base)
    assert evidences
    assert not any(evidence.noise_is_measured for evidence in evidences)


def test_a_joint_that_stands_still_gets_no_parameters_from_the_noise_of_its_encoder(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=2000, seed=3)
    moving = np.arange(7) == 3
    q, dq, ddq = np.where(moving, q, 0.3), dq * moving, ddq * moving
    torque, random = inverse_dynamics(iiwa14, table3, q, dq, ddq), np.random.default_rng(4)
    shape = (4 * 2000, 7)
    recording = recording_of(
        np.tile(q, (4, 1)) + 1e-6 * random.normal(size=shape),
        np.tile(torque, (4, 1)) + NOISE_NM * random.normal(size=shape),
        period_s=10.0,
        periods=4,
    )
    (evidence,) = build_evidence(recording, iiwa14, iiwa14_base)
    assert not evidence.motion.velocity[:, ~moving].any()
    assert np.abs(evidence.motion.velocity - dq).max() < 1e-4
    # Largest of the true parameters: 8 kg m, 4 kg m².
    assert np.abs(evidence.motion.full_parameters).max() < 20.0
    extension = extend(build_problem([evidence]), ())
    assert np.isfinite(extension.loose).all()
    assert np.abs(extension.base).max() < 200.0
