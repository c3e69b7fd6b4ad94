"""Where misfit sits: joints, bands, time, state of motion. Curves that describe, and claim no physics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.mismatch.evidence import Evidence
from identification.mismatch.figures import Curve
from identification.mismatch.problem import BAND_EDGES_HZ
from identification.mismatch.search.detection import BandPower
from identification.mismatch.settings import UNLIKELY

BINS = 40
SCANS = 20
"""Windows into which a stretch is cut for the time of the misfit."""
SHARE_OF_WINDOWS = 0.7
"""Windows are named, the fullest first, until they hold this share of the energy."""

COORDINATES = {"velocity": "rad/s", "position": "rad", "torque": "Nm", "travel": "rad", "time": "s"}
PHASE = "phase"
"""Coordinate of what repeats too often to be seen over any other, in rad."""


def bands_hz(power: BandPower, joint: int, highest_hz: float) -> list[list[float]]:
    """Bands of a joint (from 0) whose residual is no noise, neighbours joined: [[low, high], …] Hz."""
    edges = (0.0, *BAND_EDGES_HZ, np.inf)
    result: list[list[float]] = []
    for band in np.flatnonzero(power.probability[joint] < UNLIKELY):
        low, high = float(edges[band]), float(min(edges[band + 1], highest_hz))
        if result and result[-1][1] == low:
            result[-1][1] = high
        else:
            result.append([low, high])
    return result


def coordinates(evidence: Evidence, joint: int) -> dict[str, FloatArray]:
    """What residuals of a joint (from 0) are drawn against, each (S,): state, distance since the reversal, time."""
    motion = evidence.motion
    return {
        "velocity": motion.velocity[:, joint],
        "position": motion.position[:, joint],
        "torque": motion.torque[:, joint],
        "travel": travel_since_reversal(motion.velocity[:, joint], motion.sampling_period_s),
        "time": motion.time,
    }


def travel_since_reversal(velocity: FloatArray, step: float) -> FloatArray:
    """Distance run since the last change of direction, signed by the direction, (S,); the stretch taken as wrapped."""
    sign = np.where(velocity >= 0.0, 1.0, -1.0)
    turns = np.flatnonzero(np.diff(sign)) + 1
    path = np.cumsum(np.abs(velocity)) * step
    if turns.size == 0:
        return np.asarray(sign * path, dtype=np.float64)
    start = np.zeros(velocity.size)
    start[turns] = np.diff(np.concatenate([[0.0], path[turns]]))
    since = path - np.cumsum(start)
    since[: turns[0]] += path[-1] - path[turns[-1]]
    return np.asarray(sign * since, dtype=np.float64)


def best_curve(
    evidence: Evidence,
    joint: int,
    before: FloatArray,
    after: FloatArray,
    noise_nm: float,
    fitted: FloatArray | None = None,
    names: Sequence[str] = tuple(COORDINATES),
    phase: FloatArray | None = None,
) -> tuple[Curve, float]:
    """The coordinate that orders a series best, binned, and the share of the series' energy the bins hold.

    before, after: (S,) Nm residuals of the joint (from 0), nan where no row tells. fitted: (S,) Nm torque of an
    effect; then its own coordinate is looked for, else that of `before`. noise_nm: deviation of one sample.
    phase: (S,) rad, of an effect that repeats with it; then it is the coordinate, wrapped to one turn.
    """
    known = np.isfinite(before)
    before, after = before[known], after[known]
    fitted = None if fitted is None else fitted[known]
    series = before if fitted is None else fitted
    values = {name: item[known] for name, item in coordinates(evidence, joint).items()}
    if phase is not None:
        values, names = {PHASE: np.mod(phase[known] + np.pi, 2.0 * np.pi) - np.pi}, (PHASE,)
    shares = {name: _share_in_bins(values[name], series) for name in names}
    name = max(shares, key=lambda key: shares[key])
    index, centre, count = _bins(values[name])
    means = [
        None if item is None else np.bincount(index, weights=item, minlength=centre.size) / count
        for item in (before, after, fitted)
    ]
    assert means[0] is not None
    assert means[1] is not None
    unit = COORDINATES.get(name, "rad")
    curve = Curve(joint + 1, name, unit, centre, means[0], means[1], noise_nm / np.sqrt(count), means[2])
    return curve, shares[name]


def where_of(
    evidence: Evidence, power: BandPower, joint: int, series: FloatArray, curve: Curve, share: float
) -> dict[str, Any]:
    """The `where` of contract §6 for one joint (from 0): bands, windows of time, region of the state."""
    windows, share_of_time = time_windows(evidence.motion.time, series)
    energy = np.abs(curve.before if curve.fitted is None else curve.fitted)
    region = energy >= 0.5 * energy.max(initial=0.0)
    # Of a wave, no part of the turn is its place.
    inside = curve.centre[region & (curve.coordinate != PHASE)]
    return {
        "joint": joint + 1,
        "bands_hz": bands_hz(power, joint, float(evidence.frequency.max())),
        "time_windows_s": windows,
        "share_of_time": share_of_time,
        "state": {
            "coordinate": curve.coordinate,
            "unit": curve.unit,
            "from": float(inside.min()) if inside.size else None,
            "to": float(inside.max()) if inside.size else None,
            "share_of_energy": share,
        },
    }


def time_windows(time: FloatArray, series: FloatArray) -> tuple[list[list[float]], float]:
    """The fewest of 20 equal windows that hold 70 % of a series' energy, neighbours joined, and their share of time."""
    edges = np.linspace(0, time.size, SCANS + 1).astype(int)
    energy = np.add.reduceat(np.nan_to_num(series) ** 2, edges[:-1])
    order = np.argsort(-energy)
    enough = int(np.searchsorted(np.cumsum(energy[order]), SHARE_OF_WINDOWS * energy.sum())) + 1
    step = float(time[1] - time[0])
    result: list[list[float]] = []
    for window in sorted(order[:enough]):
        low, high = float(time[edges[window]]), float(time[edges[window + 1] - 1] + step)
        if result and abs(result[-1][1] - low) < 0.5 * step:
            result[-1][1] = high
        else:
            result.append([low, high])
    return [[round(low, 6), round(high, 6)] for low, high in result], enough / SCANS


def _bins(values: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Bins of about equal count: index of each sample, centres, counts."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    index = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(edges.size - 2, 0)).astype(np.int64)
    count = np.maximum(np.bincount(index, minlength=max(edges.size - 1, 1)), 1).astype(np.float64)
    centre = np.bincount(index, weights=values, minlength=count.size) / count
    return index, centre, count


def _share_in_bins(values: FloatArray, series: FloatArray) -> float:
    index, centre, count = _bins(values)
    means = np.bincount(index, weights=series, minlength=centre.size) / count
    return float(np.sum(count * means**2) / max(float(np.sum(series**2)), 1e-300))
