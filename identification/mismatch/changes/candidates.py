"""What every search for a change between periods shares: a candidate, its fit, one shape parameter at its best.

What is claimed is decided in `between_periods`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc

from identification.arrays import FloatArray
from identification.mismatch.changes.contrasts import Contrasts, Fit
from identification.mismatch.effects.base import Place
from identification.mismatch.effects.enveloped import EnvelopedEffect

REFINED = 1.2
"""A refinement adds a fifth to the gain of a rough one."""
MOMENTS = 31
"""Moments of a step that are tried in one look."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A candidate on the contrasts. joints: from 0, whose rows (K, R, J, m) it has. log10_chance, tests: see
    `Fit.log10_chance`.

    dispersion: how much noisier than its estimate the noise is beside the candidate; fit is already reduced by it.
    span_s: first and last time (s from the first sample) it acts on, for contacts; None for what lasts.
    added_covariance: what nonlinear parameters add to the coefficients'; None: as `shape_covariance` tells.
    columns: those of the effect that are fitted; the coefficients of the others are zero.
    """

    effect: EnvelopedEffect
    place: Place
    shape: Mapping[str, float]
    fit: Fit
    log10_chance: float
    tests: float
    shape_std: Mapping[str, float]
    dispersion: float = 1.0
    span_s: tuple[float, float] | None = None
    added_covariance: FloatArray | None = None
    columns: slice = field(default_factory=lambda: slice(None))


def fit_of(
    contrasts: Contrasts,
    effect: EnvelopedEffect,
    place: Place,
    shape: Mapping[str, float],
    columns: slice = slice(None),
) -> Fit:
    """The candidate's columns fitted to the contrasts."""
    return contrasts.fit_pieces(*contrasts.pieces(effect, place, shape, columns))


def refined_shape(
    contrasts: Contrasts,
    effect: EnvelopedEffect,
    place: Place,
    shape: dict[str, float],
    name: str,
    bounds: tuple[float, float],
    points: int = 7,
) -> dict[str, float]:
    """One positive shape parameter at its best: a grid of its logarithm, then a bounded search about its best point."""

    def gain_at(x: float) -> float:
        return fit_of(contrasts, effect, place, {**shape, name: float(np.exp(x))}).gain

    grid = np.linspace(float(np.log(max(bounds[0], 1e-9))), float(np.log(bounds[1])), points)
    x = _best_on(gain_at, grid, {"maxiter": 20})
    return {**shape, name: float(np.exp(x))}


def best_moment(gain_at: Callable[[float], float], start: float, width: float, last: float) -> float:
    """The moment of a step with the largest gain, s: a grid about the best so far, then a bounded search.

    Past the width of the compared band the gain is as rough as the noise itself: a search by halves alone would end on
    one of its many tops. So the last grid is finer than the band's width.
    """
    low, high = max(0.0, start - width), min(last, start + width)
    return _best_on(gain_at, np.linspace(low, high, MOMENTS), {"xatol": 1e-4})


def _best_on(gain_at: Callable[[float], float], grid: FloatArray, options: Any) -> float:
    """Where a gain is largest: the best point of a grid, or a better one of a bounded search between its neighbours."""
    gains = [gain_at(float(x)) for x in grid]
    best = int(np.argmax(gains))
    inner = grid[max(0, best - 1)], grid[min(len(grid) - 1, best + 1)]
    result = minimize_scalar(lambda x: -gain_at(float(x)), bounds=inner, method="bounded", options=options)
    return float(result.x if -result.fun > gains[best] else grid[best])


def spread_of(
    contrasts: Contrasts,
    effect: EnvelopedEffect,
    place: Place,
    shape: Mapping[str, float],
    name: str,
    gain: float,
    smallest: float = 1e-6,
    columns: slice = slice(None),
) -> dict[str, float]:
    """Standard deviation of one shape parameter from how fast the gain falls off: 2 × 1σ ≙ a drop of 1 on each side."""
    value = shape[name]
    step = max(1e-3 * abs(value), smallest)
    for _ in range(12):
        drops = [
            gain - fit_of(contrasts, effect, place, {**shape, name: value + sign * step}, columns).gain
            for sign in (-1.0, 1.0)
        ]
        drop = 0.5 * (drops[0] + drops[1])
        if drop > 0.5:
            return {name: float(step / np.sqrt(drop))}
        step *= 2.0
        if step > abs(value) and value != 0.0:
            break
    return {name: float("nan")}


def hopeless(gain: float, dof: int, tests: float) -> bool:
    """Whether a refinement of a scan's gain cannot make it significant."""
    return bool(chdtrc(dof, REFINED * gain + 3.0) * tests > np.exp(-6.0))


def dispersion_of(squares: float, freedom: int) -> float:
    """How much noisier the contrasts beside a candidate are than the noise estimate says; 1 within its own scatter.

    Drifting or wandering noise that successive differences do not see shows here.
    """
    ratio = squares / max(1, freedom)
    return float(ratio) if ratio > 1.0 + 2.0 * np.sqrt(2.0 / max(1, freedom)) else 1.0


def inflated(fit: Fit, dispersion: float) -> Fit:
    """The fit under a noise that much larger."""
    return replace(fit, gain=fit.gain / dispersion, covariance=fit.covariance * dispersion)
