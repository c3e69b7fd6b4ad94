"""What the fitted model is worth on recordings it has not seen: the check behind every name.

Coefficients, nonlinear parameters and base parameters all come from the fitted recordings. Only directions of the base
parameters that those recordings do not determine to the noise of the held-out ones are left free there: they would say
nothing on the effects, and everything on the motion that was fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import fdtrc

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.mismatch.evidence import Evidence
from identification.mismatch.problem import BAND_EDGES_HZ, Problem, off
from identification.mismatch.search.extension import Extension, nominal_factor, predicted, prediction_scatter
from identification.mismatch.search.library import Library
from identification.mismatch.settings import CLEARLY, OPEN_BEYOND_NOISE


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Rows of what a model leaves on a set of evidences. rows, noise: (n, R) Nm; noise holds the model's scatter too.

    samples: (n,) samples S behind the rows, so that Σ rows² / S is the mean square over time. sensor_noise: (n, R) Nm.
    scatter: (n, R, k) Nm per unit of k independent deviations of the model's parameters.
    """

    rows: FloatArray
    noise: FloatArray
    sensor_noise: FloatArray
    used: BoolArray
    samples: int
    scatter: FloatArray

    @property
    def rms_nm(self) -> FloatArray:
        """(n,) RMS over time within the compared bandwidth."""
        return np.asarray(np.sqrt(self._sum(self.rows**2) / self.samples), dtype=np.float64)

    @property
    def noise_floor_nm(self) -> FloatArray:
        """(n,) RMS of the sensor's noise alone."""
        return np.asarray(np.sqrt(self._sum(self.sensor_noise**2) / self.samples), dtype=np.float64)

    @property
    def expected_nm(self) -> FloatArray:
        """(n,) RMS of the noise and the scatter of the model's parameters."""
        return np.asarray(np.sqrt(self._sum(self.noise**2) / self.samples), dtype=np.float64)

    @property
    def freedom(self) -> FloatArray:
        """(n,) degrees of freedom of the mean square, of rows that differ in power."""
        squares = np.where(self.used, self.rows**2, 0.0)
        return np.asarray(3.0 * squares.sum(axis=1) ** 2 / np.maximum((squares**2).sum(axis=1), 1e-300))

    def rows_of(self, rows: IntArray, samples: int) -> Residuals:
        """The same of some of the rows, with so many samples behind them."""
        names = ("rows", "noise", "sensor_noise", "used", "scatter")
        return replace(self, samples=samples, **{name: getattr(self, name)[:, rows] for name in names})

    @property
    def excess_energy(self) -> FloatArray:
        """(n,) Nm², mean square beyond noise and the scatter of the model; may come out negative."""
        return np.asarray(self._sum(self.rows**2 - self.noise**2) / self.samples, dtype=np.float64)

    @property
    def excess_deviation(self) -> FloatArray:
        """(n,) Nm², standard deviation of `excess_energy`: the scatter of few parameters moves many rows together."""
        misfit = np.maximum(self.rows**2 - self.noise**2, 0.0)
        independent = self.noise**4 - (self.scatter**2).sum(axis=2) ** 2
        together = np.array([float(np.sum((joint.T @ joint) ** 2)) for joint in self.scatter])
        variance = self._sum(2.0 * independent + 4.0 * self.noise**2 * misfit) + 2.0 * together
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)) / self.samples)

    @property
    def noise_at_most_nm(self) -> FloatArray:
        """(n,) RMS of the noise and the scatter of the model, a deviation more than is expected."""
        return np.asarray(np.sqrt(self.expected_nm**2 + self.excess_deviation))

    @property
    def excess_nm(self) -> FloatArray:
        """(n,) square root of the excess energy, zero where that is negative."""
        return np.asarray(np.sqrt(np.maximum(self.excess_energy, 0.0)), dtype=np.float64)

    def _sum(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.where(self.used, values, 0.0).sum(axis=1), dtype=np.float64)


def residuals(
    extension: Extension, evidences: Sequence[Evidence], library: Library, torque: Sequence[FloatArray] | None = None
) -> Residuals:
    """What an extended model leaves on evidences that were not fitted; library: the effects on those evidences."""
    nominal, weight, directions, scale = _base_scatter(extension.problem, tuple(evidences))
    measured = np.concatenate([item.torque for item in evidences] if torque is None else list(torque)).T
    noise = np.concatenate([item.noise for item in evidences]).T
    used = np.concatenate([item.used for item in evidences]).T
    whitened = (measured - predicted(extension, nominal, library)) * weight
    effects = prediction_scatter(extension, nominal, library)
    free = directions[:, scale > OPEN_BEYOND_NOISE]
    rows = off(free, whitened.ravel()).reshape(whitened.shape) * noise
    closed = directions[:, free.shape[1] :] * scale[free.shape[1] :]
    moved = off(free, (effects * weight[..., None]).reshape(whitened.size, -1))
    scatter = np.concatenate([closed, moved], axis=1)
    spread = (scatter**2).sum(axis=1) - (free**2).sum(axis=1)
    spread = np.maximum(spread, -1.0).reshape(whitened.shape) * noise**2
    return Residuals(
        rows=rows,
        noise=np.sqrt(np.maximum(noise**2 + spread, 0.0)),
        sensor_noise=noise,
        used=used,
        samples=sum(item.samples for item in evidences),
        scatter=scatter.reshape(*whitened.shape, -1) * noise[..., None],
    )


@lru_cache(maxsize=4)
def _base_scatter(
    fitted: Problem, evidences: tuple[Evidence, ...]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Nominal rows (n, R, p) of evidences, their weight, and directions (n R, p) and sizes of the whitened torque that
    scatters with the base parameters alone: the same for all sets of members of one problem.
    """
    nominal = np.ascontiguousarray(np.concatenate([item.nominal for item in evidences]).transpose(1, 0, 2))
    used = np.concatenate([item.used for item in evidences]).T
    weight = np.where(used, 1.0 / np.concatenate([item.noise for item in evidences]).T, 0.0)
    base = nominal @ nominal_factor(fitted)[3][: nominal.shape[2]] * weight[..., None]
    directions, scale, _ = np.linalg.svd(base.reshape(weight.size, -1), full_matrices=False)
    return nominal, weight, directions, scale


def worsened(rest: Residuals, now: Residuals) -> BoolArray:
    """(n,) joints on which what `now` adds to `rest` makes predictions worse than the noise of the rows allows.

    A true change d of the prediction lowers the squares by d² with a deviation of 2 d, in units of what stays: the
    noise, or the background where more stays than that. Rows of a coloured background count as `freedom` says. A rise
    within one such deviation is none, however far it is from what a true change does.
    """
    used = now.used.sum(axis=1)
    after, before = (np.where(now.used, item.rows / now.noise, 0.0) for item in (now, rest))
    level = np.maximum((after**2).sum(axis=1) / np.maximum(used, 1), 1.0)
    share = np.minimum(now.freedom / np.maximum(used, 1), 1.0) / level
    moved = share * ((after - before) ** 2).sum(axis=1)
    rise = share * (after**2 - before**2).sum(axis=1)
    deviation = 2.0 * np.sqrt(moved)
    return np.asarray(rise > np.maximum(CLEARLY * deviation - moved, deviation))


def misfit_probability(left: Residuals, evidences: Sequence[Evidence], highest_hz: float = np.inf) -> FloatArray:
    """(n,) chance that noise and the scatter of the model's parameters alone leave so much in any band of a joint.

    evidences: those of the rows, whose noise is measured. Band by band against the estimate of the noise and its
    degrees of freedom, up to a frequency; the smallest chance counts, times the number of bands.
    """
    frequency = np.concatenate([evidence.frequency for evidence in evidences])
    freedom = np.concatenate([evidence.noise_freedom for evidence in evidences])
    band = np.searchsorted(BAND_EDGES_HZ, frequency, side="left")
    inside = left.used & (frequency <= highest_hz)
    chance = np.ones(left.rows.shape[0])
    for joint in range(chance.size):
        for rows in (np.flatnonzero(inside[joint] & (band == number)) for number in np.unique(band)):
            if not rows.size:
                continue
            noise = left.sensor_noise[joint, rows]
            values, scatter = left.rows[joint, rows] / noise, left.scatter[joint, rows] / noise[:, None]
            shadow = scatter.T @ values
            squares = values @ values - shadow @ np.linalg.solve(np.eye(shadow.size) + scatter.T @ scatter, shadow)
            behind = max(float(freedom[rows, joint].mean()), 0.5 * rows.size)
            chance[joint] = min(chance[joint], float(fdtrc(rows.size, behind, squares / rows.size)))
    return np.minimum(chance * np.unique(band).size, 1.0)


def share_removed(before: Residuals, after: Residuals, joints: Sequence[int]) -> tuple[float, float]:
    """Share of the excess energy on some joints (from 0) that is gone, and the most it may be within two deviations.

    (1, 1) where there was no excess to begin with.
    """
    chosen = list(joints)
    first, last = float(before.excess_energy[chosen].sum()), float(after.excess_energy[chosen].sum())
    spread = float(np.sqrt((after.excess_deviation[chosen] ** 2).sum() + (before.excess_deviation[chosen] ** 2).sum()))
    if first <= 0.0:
        return 1.0, 1.0
    return 1.0 - last / first, 1.0 - (last - 2.0 * spread) / first
