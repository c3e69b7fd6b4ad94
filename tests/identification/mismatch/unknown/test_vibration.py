"""Vibrations with a rhythm of their own. Truth: plants computed by Pinocchio, vibrations written here."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.reduction import build_evidence
from identification.mismatch.unknown.vibration import vibrating
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.robots import RobotModel
from tests.identification.mismatch.plant import record

FloatArray = npt.NDArray[np.float64]
Shaken = Callable[[Recording], FloatArray]
JOINT = 4
HERTZ = 63.74
"""Not in step with a period of 10 s."""


def _speed(recording: Recording) -> FloatArray:
    return np.asarray(np.gradient(recording.position[:, JOINT - 1], recording.sampling_period_s))


def _rhythm(recording: Recording) -> FloatArray:
    return np.asarray(0.15 * np.sin(2.0 * np.pi * HERTZ * recording.time + 1.0))


def near_standstill(recording: Recording) -> FloatArray:
    return np.asarray(_rhythm(recording) * np.exp(-((_speed(recording) / 0.1) ** 2)))


def on_one_side(recording: Recording) -> FloatArray:
    return np.asarray(_rhythm(recording) * (recording.position[:, JOINT - 1] > 0.1))


def hum(recording: Recording) -> FloatArray:
    return _rhythm(recording)


def noise_of_fast_motion(recording: Recording) -> FloatArray:
    return np.asarray(0.2 * np.random.default_rng(5).normal(size=recording.samples) * np.abs(_speed(recording)))


def outliers(recording: Recording) -> FloatArray:
    """A few of them, all near standstill."""
    slow = np.flatnonzero(np.abs(_speed(recording)) < 0.05)
    torque = np.zeros(recording.samples)
    torque[np.random.default_rng(6).choice(slow, 10, replace=False)] = 5.0
    return torque


def thermal(recording: Recording) -> FloatArray:
    """Friction that falls over the recording: the periods differ where the joint turns round."""
    warm = np.linspace(1.0, -1.0, recording.samples)
    return np.asarray(0.3 * warm * np.sign(_speed(recording)))


def shaken(recording: Recording, by: Shaken) -> Recording:
    """The recording with a torque more on one joint."""
    torque = recording.torque.copy()
    torque[:, JOINT - 1] += by(recording)
    return replace(recording, torque=torque)


@pytest.mark.parametrize(("by", "where"), [(near_standstill, "moves at"), (on_one_side, "is at")])
def test_a_vibration_that_comes_and_goes_is_said_with_where_it_comes(
    iiwa14: RobotModel, table3: PhysicalParameters, by: Shaken, where: str
) -> None:
    """It is no part of the mean of the periods: the answer was that there is no mismatch."""
    fitted, unseen = (shaken(record(iiwa14, table3, periods=k, motion=m, seed=m), by) for k, m in ((8, 3), (4, 9)))
    diagnosis = diagnose([fitted], iiwa14, heldout=[unseen])
    (claim,) = diagnosis.classes
    assert (claim.name, claim.joint, claim.named) == ("broadband", JOINT, False)
    assert f"where the joint {where} " in claim.sentence
    (hertz,) = re.findall(r"near (\d+) Hz", claim.sentence)
    assert abs(int(hertz) - HERTZ) < 3.0
    assert diagnosis.verdict == "unexplained"
    assert not diagnosis.findings
    truth = np.sqrt(np.mean(np.concatenate([by(fitted), by(unseen)]) ** 2))
    # Part of it lies outside of the run of parts that shows it best.
    assert 0.7 * truth < claim.rms_nm < 1.1 * truth


@pytest.mark.parametrize("by", [hum, noise_of_fast_motion, outliers, thermal])
def test_what_is_everywhere_or_at_all_frequencies_is_no_vibration_of_a_state(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters, by: Shaken
) -> None:
    recordings = [shaken(record(iiwa14, table3, periods=k, motion=m, seed=m), by) for k, m in ((8, 3), (4, 9))]
    assert not vibrating([part for item in recordings for part in build_evidence(item, iiwa14, iiwa14_base)])
