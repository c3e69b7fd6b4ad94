"""The contrasts of noise alone: no direction of them may say more than chance, not even where periods meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from identification.base_parameters import BaseRegressor
from identification.mismatch.changes.contrasts import Contrasts
from identification.mismatch.evidence import Evidence
from identification.mismatch.noise import noise_of_mean
from identification.mismatch.reduction import build_evidence
from identification.robots import RobotModel
from tests.identification.synthetic import fourier_motion, recording_of

FloatArray = npt.NDArray[np.float64]

PERIOD_S, SAMPLES, PERIODS = 10.0, 1250, 8


@pytest.fixture(scope="module")
def evidence(iiwa14: RobotModel, iiwa14_base: BaseRegressor) -> Evidence:
    """Of a recording whose torque a test replaces."""
    generator = np.random.default_rng(3)
    position = np.tile(fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=4)[0], (PERIODS, 1))
    position += 2e-5 * generator.normal(size=position.shape)
    recording = recording_of(position, generator.normal(size=position.shape), period_s=PERIOD_S, periods=PERIODS)
    return build_evidence(recording, iiwa14, iiwa14_base)[0]


def _noise(corner_hz: float, rows: int, joints: int, period_s: float, generator: np.random.Generator) -> FloatArray:
    """Noise of one corner frequency, by its recursion."""
    pole = np.exp(-2.0 * np.pi * corner_hz * period_s)
    before = int(3.0 / (corner_hz * period_s))
    drawn = generator.normal(size=(before + rows, joints))
    return np.asarray(lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], drawn, axis=0)[before:], dtype=np.float64)


def _contrasts(evidence: Evidence, corner_hz: float, seed: int) -> Contrasts:
    motion, generator = evidence.motion, np.random.default_rng([seed, 78])
    torque = _noise(
        corner_hz, motion.samples * evidence.periods, evidence.n, motion.sampling_period_s, generator
    ).reshape(evidence.periods, motion.samples, evidence.n)
    rows = np.stack([evidence.project(period) for period in torque])
    noise, freedom = noise_of_mean(rows)
    return Contrasts(replace(evidence, period_torque=rows, noise=noise, noise_freedom=freedom))


@pytest.mark.parametrize("corner_hz", [0.4, 2.0, 5.0, 10.0])
@pytest.mark.parametrize("cut_s", [0.05, 0.16, 0.6])
def test_a_push_that_ends_with_the_period_shows_in_noise_no_more_than_any_other(
    evidence: Evidence, corner_hz: float, cut_s: float
) -> None:
    """Half a window ends in a jump, as noise does where a period ends: its square was up to three times chance's."""
    time = evidence.motion.time
    length = evidence.motion.samples * evidence.motion.sampling_period_s
    window = np.where(time > length - cut_s, np.sin(0.5 * np.pi * (time - length + cut_s) / cut_s), 0.0)
    rows = np.broadcast_to(evidence.project(window[:, None])[..., None], (len(evidence.frequency), evidence.n, 1))
    total = freedom = 0.0
    for seed in range(4):
        contrasts = _contrasts(evidence, corner_hz, seed)
        shown = contrasts.whiten_repeated(rows, range(evidence.n))[..., 0]
        # What is left of it, as a share of it: what a push there could say at most.
        share = (shown**2).sum(axis=0) / ((rows[..., 0] * contrasts.weight) ** 2).sum(axis=0)
        square = np.einsum("krj,rj->kj", contrasts.z, shown / np.linalg.norm(shown, axis=0)) ** 2
        total += float((square * share).sum())
        freedom += float(share.sum()) * (evidence.periods - 1)
    assert chi2.sf(total, freedom) > 1e-4
