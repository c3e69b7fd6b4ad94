"""How often per turn of a joint what is left of its torque repeats: of each octave the order that shows most.

A tooth, a pole or a wave generator may repeat at any order; columns for each that a motion tells apart would be most of
a search.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.evidence import Evidence, rows_of_each, rows_to_time
from identification.mismatch.problem import Problem

STEP = 1e-3
"""rad (m) between places that torque is added up at: an order of 500 per turn then loses a hundredth."""
FINER = 4
"""How many orders are looked at for each that the joint's travel tells apart."""


def waves_left(problem: Problem, evidences: Sequence[Evidence]) -> dict[int, tuple[float, ...]]:
    """Joint (from 1) → orders, waves per 2π of its position, the largest of each octave above one wave in its travel.

    Of what the problem's basis leaves, each row by its weight: the products with sin and cos are large where such a
    torque would gain most.
    """
    found = {}
    left = (problem.residual.reshape(problem.weight.shape) * problem.weight).T
    times = [rows_to_time(item, left[rows]) for item, rows in zip(evidences, rows_of_each(evidences), strict=True)]
    torque = np.nan_to_num(np.concatenate(times))
    position = np.concatenate([item.motion.position for item in evidences])
    for joint in range(problem.n):
        place = np.rint((position[:, joint] - position[:, joint].min()) / STEP).astype(np.int64)
        size = FINER * (int(place.max()) + 1)
        power = np.abs(np.fft.rfft(np.bincount(place, torque[:, joint]), size)) ** 2
        found[joint + 1] = tuple(2.0 * np.pi / (size * STEP) * number for number in _largest_of_octaves(power))
    return found


def _largest_of_octaves(power: FloatArray) -> list[int]:
    """Numbers of the largest peak in each octave from FINER on: the slope beside one of another octave is none."""
    peaks = 1 + np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] > power[2:]))
    octave = np.floor(np.log2(peaks / FINER)).astype(np.int64)
    chosen = [peaks[octave == number] for number in range(int(octave.max(initial=-1)) + 1)]
    return [int(own[np.argmax(power[own])]) for own in chosen if own.size]
