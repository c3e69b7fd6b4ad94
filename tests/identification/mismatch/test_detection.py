"""Detection: power against noise, by joint and band."""

from __future__ import annotations

import numpy as np

from identification.mismatch.evidence import Evidence
from identification.mismatch.problem import build_problem
from identification.mismatch.search.detection import band_power, is_inflated, whittle


def test_noise_alone_is_consistent_with_noise(clean_evidence: Evidence) -> None:
    power = band_power(build_problem([clean_evidence]))
    assert power.least_probability > 1e-4
    assert abs(np.average(power.ratio, weights=power.freedom) - 1.0) < 0.1


def test_misfit_is_found_on_its_joint_and_in_its_band(clean_evidence: Evidence) -> None:
    time = clean_evidence.motion.time
    extra = np.zeros_like(clean_evidence.motion.torque)
    extra[:, 2] = 0.05 * np.sin(2.0 * np.pi * 30.0 * time)
    problem = build_problem([clean_evidence], [clean_evidence.torque + clean_evidence.project(extra)])
    power = band_power(problem)
    joint, band = np.unravel_index(np.argmin(power.probability), power.probability.shape)
    assert joint == 2
    assert problem.band[np.argmin(np.abs(problem.frequency - 30.0))] == band
    # Other bands of this joint see what bridged standstills move of so strong a wave; see the test of the evidence.
    assert np.delete(power.probability, joint, axis=0).min() > 1e-4


def test_an_unknown_background_is_never_below_the_noise(clean_evidence: Evidence) -> None:
    problem = build_problem([clean_evidence])
    power = band_power(problem, 0.5 * problem.residual)
    assert whittle(power) == 0.0
    assert not is_inflated(power)
    louder = band_power(problem, 3.0 * problem.residual)
    assert whittle(louder) < 0.0
    assert is_inflated(louder)
    assert np.sqrt(louder.ratio).mean() > 2.5
