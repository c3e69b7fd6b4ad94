"""Which name is given where no noise is measured. Truth: what was written onto the plant's torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from identification.mismatch.diagnosis import diagnose
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.robots import RobotModel
from tests.identification.mismatch.plant import Hidden, no_effect, on_joint, record


def _without_periods(recording: Recording, slow_nm: float, seed: int) -> Recording:
    """The same with so much RMS noise more, below 5 Hz, and no word of what repeats."""
    random, rate = np.random.default_rng(seed), 1.0 / float(recording.time[1] - recording.time[0])
    slow = lfilter(*butter(2, 5.0, fs=rate), random.normal(size=recording.torque.shape), axis=0)
    torque = recording.torque + slow_nm * slow / slow.std(axis=0)
    return replace(recording, torque=torque, period_s=None, period_index=None, sample_in_period=None)


def _stribeck(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    return on_joint(4, np.exp(-np.abs(dq[:, 3] / 0.1)) * np.sign(dq[:, 3]))


def _crosstalk(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    return on_joint(5, torque[:, 1])


def _loaded_friction(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    return on_joint(5, np.abs(torque[:, 4]) * np.sign(dq[:, 4]))


@pytest.mark.parametrize(
    ("hidden", "size", "slow_nm", "names", "classes"),
    [
        # A name that leaves nothing above the level of the noise was held to be worth nothing.
        (_stribeck, 0.4, 0.0, [("stribeck_friction", 4)], []),
        # Most of the misfit was asked for, four fifths of which are slow noise here.
        (_loaded_friction, 0.4, 0.15, [("load_dependent_friction", 5)], []),
        # It removed less than was asked for, and had to stand against classes that predict no better.
        (_stribeck, 1.2, 0.15, [("stribeck_friction", 4)], []),
        # Eight times the noise, and nothing was said: terms of it raised another joint's error by seven thousandths.
        (_crosstalk, 0.03, 0.15, [], [("other_torques", 5)]),
        (no_effect, 0.0, 0.15, [], []),
    ],
)
def test_where_no_noise_is_measured_a_name_predicts_and_has_the_odds(
    iiwa14: RobotModel,
    table3: PhysicalParameters,
    hidden: Hidden,
    size: float,
    slow_nm: float,
    names: list[tuple[str, int]],
    classes: list[tuple[str, int]],
) -> None:
    fitted, unseen = (
        _without_periods(
            record(iiwa14, table3, lambda *state: size * hidden(*state), motion=motion, seed=motion), slow_nm, motion
        )
        for motion in (3, 9)
    )
    diagnosis = diagnose([fitted], iiwa14, heldout=[unseen])
    assert [(item.effect, item.place.joint) for item in diagnosis.findings] == names
    assert not diagnosis.baseline.noise_is_measured
    assert "stay unexplained" not in diagnosis.remaining
    assert [(item.name, item.joint) for item in diagnosis.unnamed] == classes
