"""Claims about rows of a recording without periods. Truth: closed forms, and MuJoCo-free synthetic motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.errors import RecordingError
from identification.fitting.settings import Split
from identification.mismatch.aperiodic_evidence import (
    build_aperiodic_evidence,
    default_split,
    low_pass_of,
    weighted_by,
)
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.evidence import fit_parameters, rows_to_time
from identification.mismatch.settings import DiagnosisSettings
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.robots import RobotModel
from tests.identification.mismatch.plant import no_effect, on_joint, record
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

SETTINGS = DiagnosisSettings()
SPLIT = Split.parse("blocks:0.8:3")


def _aperiodic(recording: Recording) -> Recording:
    return replace(recording, period_s=None, period_index=None, sample_in_period=None)


@pytest.fixture(scope="module")
def recording(iiwa14: RobotModel, table3: PhysicalParameters) -> Recording:
    return _aperiodic(record(iiwa14, table3, no_effect, periods=2))


def test_the_low_pass_follows_the_motion_between_its_bounds(recording: Recording) -> None:
    fast = replace(recording, time=recording.time / 10.0)
    slow, quick = low_pass_of(recording, SETTINGS), low_pass_of(fast, SETTINGS)
    assert slow == 10.0
    assert 10.0 < quick <= SETTINGS.torque_bandwidth_hz
    assert low_pass_of(recording, replace(SETTINGS, low_pass_hz=17.0)) == 17.0


def test_rows_of_a_cosine_stand_on_its_frequency_and_keep_its_energy(
    recording: Recording, iiwa14: RobotModel, iiwa14_base: BaseRegressor
) -> None:
    (evidence,) = build_aperiodic_evidence(recording, iiwa14, iiwa14_base, SETTINGS)
    wave = np.cos(2.0 * np.pi * 3.0 * evidence.motion.time)[:, None]
    rows = evidence.project(wave)[:, 0]
    assert np.sum(rows**2) / evidence.samples == pytest.approx(0.5, rel=0.05)
    near = np.abs(evidence.frequency - 3.0) < 1.0
    assert np.sum(rows[near] ** 2) > 0.9 * np.sum(rows**2)
    back = rows_to_time(evidence, rows[:, None])[:, 0]
    known = np.isfinite(back)
    assert known.mean() > 0.9
    # Interpolation between rows: 25 rows a second for 3 Hz.
    assert np.abs(back[known] - wave[known, 0]).max() < 0.15


def test_fitted_and_held_out_rows_share_no_time(
    recording: Recording, iiwa14: RobotModel, iiwa14_base: BaseRegressor
) -> None:
    fitted, unseen = (
        build_aperiodic_evidence(recording, iiwa14, iiwa14_base, SETTINGS, SPLIT, held_out=which)[0]
        for which in (False, True)
    )
    known = [np.isfinite(rows_to_time(item, item.torque[:, :1])[:, 0]) for item in (fitted, unseen)]
    assert not np.any(known[0] & known[1])
    assert 1.5 < fitted.samples / unseen.samples < 4.0


def test_held_out_rows_of_a_right_model_are_left_with_noise_only(
    recording: Recording, iiwa14: RobotModel, iiwa14_base: BaseRegressor
) -> None:
    fitted, unseen = (
        build_aperiodic_evidence(recording, iiwa14, iiwa14_base, SETTINGS, SPLIT, held_out=which)
        for which in (False, True)
    )
    left = unseen[0].torque - unseen[0].nominal @ fit_parameters(fitted)
    ratio = np.sqrt(np.mean(left**2, axis=0)) / np.sqrt(np.mean(unseen[0].noise ** 2, axis=0))
    assert np.all(ratio < 1.6), ratio


def test_friction_that_turns_over_between_two_samples_of_the_thinned_motion_is_no_misfit(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    """The plant has no noise, and Coulomb friction by the sign of the velocity. Signs of every eighth sample left 3 mNm
    here, and of friction of 1 Nm as much as sensors' noise: arms with nothing hidden were called unexplained.
    """
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=10_000, seed=3)
    torque = inverse_dynamics(iiwa14, table3, q, dq, ddq)
    recording = _aperiodic(recording_of(q, torque, period_s=10.0, periods=1))
    (evidence,) = build_aperiodic_evidence(recording, iiwa14, iiwa14_base, SETTINGS)
    assert evidence.motion.sampling_period_s == pytest.approx(0.008)
    left = evidence.torque - evidence.nominal @ fit_parameters([evidence])
    assert np.sqrt(np.sum(left**2, axis=0) / evidence.samples).max() < 1e-3


def test_weights_follow_the_misfit_but_never_go_below_the_white_noise(
    recording: Recording, iiwa14: RobotModel, iiwa14_base: BaseRegressor
) -> None:
    (evidence,) = build_aperiodic_evidence(recording, iiwa14, iiwa14_base, SETTINGS)
    assert evidence.white_noise is not None
    left = np.zeros_like(evidence.torque)
    left[:, 4] = 5.0
    weighted = weighted_by(evidence, left)
    assert np.allclose(weighted.noise[:, 4], 0.5, rtol=0.01)
    assert np.allclose(weighted.noise[:, 2], evidence.white_noise[:, 2], rtol=0.01)


def test_a_split_that_leaves_no_block_is_refused(
    recording: Recording, iiwa14: RobotModel, iiwa14_base: BaseRegressor
) -> None:
    with pytest.raises(RecordingError, match="no block of time"):
        build_aperiodic_evidence(recording, iiwa14, iiwa14_base, SETTINGS, Split.parse("blocks:0.1:3"), held_out=True)
    assert default_split([recording], SETTINGS).kind == "blocks"


def test_a_stretch_in_which_the_arm_stands_still_is_left_out_and_a_recording_of_it_alone_is_refused(
    recording: Recording, iiwa14: RobotModel, iiwa14_base: BaseRegressor
) -> None:
    """Nothing can be fitted to a rest: least squares did not end."""
    count, places = recording.samples // 2, np.arange(recording.samples)
    moved_first = replace(recording, position=recording.position[np.minimum(places, 100)], velocity=None)
    still = replace(
        recording,
        time=recording.time + (places >= count),
        position=recording.position[np.where(places < count, 0, places)],
        velocity=None,
    )
    assert len(build_aperiodic_evidence(still, iiwa14, iiwa14_base, SETTINGS)) == 1
    with pytest.raises(RecordingError, match="no block of time in which a joint moves is left to fit"):
        build_aperiodic_evidence(moved_first, iiwa14, iiwa14_base, SETTINGS)


def test_a_plain_robot_without_periods_has_no_mismatch(recording: Recording, iiwa14: RobotModel) -> None:
    diagnosis = diagnose([recording], iiwa14)
    assert diagnosis.findings == ()
    assert diagnosis.verdict == "no_mismatch"


def test_a_hidden_effect_is_found_without_periods_and_checked_on_other_blocks(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    def hidden(_q: np.ndarray, dq: np.ndarray, _torque: np.ndarray) -> np.ndarray:
        return on_joint(4, 1.5 * np.sign(dq[:, 3]) * np.exp(-((dq[:, 3] / 0.1) ** 2)))

    diagnosis = diagnose([_aperiodic(record(iiwa14, table3, hidden, periods=2))], iiwa14)
    (finding,) = diagnosis.findings
    assert (finding.effect, finding.place.joint) == ("stribeck_friction", 4)
    assert finding.confirmed
    assert finding.coefficients[0] == pytest.approx(1.5, rel=0.15)


def _first(recording: Recording, seconds: float) -> Recording:
    rows = slice(0, int(seconds / recording.sampling_period_s))
    return replace(
        recording, time=recording.time[rows], position=recording.position[rows], torque=recording.torque[rows]
    )


def test_a_short_recording_gets_fewer_blocks_and_a_shorter_one_is_refused_before_any_work(
    recording: Recording, iiwa14: RobotModel, iiwa14_base: BaseRegressor
) -> None:
    """Below 6.3 s it was refused after half of the work, for blocks that were shorter than the filter."""
    short = _first(recording, 4.0)
    split = default_split([short], SETTINGS)
    for held_out in (False, True):
        build_aperiodic_evidence(short, iiwa14, iiwa14_base, SETTINGS, split, held_out=held_out)
    phases: list[str] = []
    with pytest.raises(RecordingError, match=r"0.99 s are too short .* takes 1\.9 s; record longer"):
        diagnose(
            [_first(recording, 1.0)],
            iiwa14,
            settings=replace(SETTINGS, low_pass_hz=10.0),
            progress=lambda phase, _: phases.append(phase),
        )
    assert not phases
