"""Functions that the classes of dependence are made of: smooth ones of one variable, stops, linear filters.

Pure mathematics; nothing here knows a robot.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.fft import irfft, rfft

from identification.arrays import FloatArray

SETTLE_S = 2.0
"""Behind a signal that does not repeat, within which filters come to rest."""

GRID = 401
"""Points of a table of functions; between them they run straight."""
NEGLIGIBLE = 1e-6
"""Share of the kernel's largest eigenvalue below which a direction is left out."""


@lru_cache(maxsize=32)
def smooth_table(length: float, most: int, trend: tuple[str, ...]) -> FloatArray:
    """(GRID, m ≤ most) functions on [−1, 1] whose independent unit weights give a smooth random function.

    Its covariance is exp(−d²/2 length²), without its part along the trends: "one", "linear" (x), "rise" (1 + x) and
    "sinh" (see `unwarped`). They are the leading eigenvectors of that kernel on a grid, positive at 1: weights that are
    kept may not depend on the sign in which a library happens to give a vector.
    """
    grid = np.linspace(-1.0, 1.0, GRID)
    kernel = np.exp(-0.5 * ((grid[:, None] - grid[None]) / length) ** 2)
    if trend:
        known = {"one": np.ones(GRID), "linear": grid, "rise": 1.0 + grid, "sinh": unwarped(0.5 * (1.0 + grid))}
        basis, _ = np.linalg.qr(np.stack([known[name] for name in trend], axis=1))
        kernel -= basis @ (basis.T @ kernel)
        kernel -= (kernel @ basis) @ basis.T
    values, vectors = np.linalg.eigh(kernel)
    values, vectors = values[::-1][:most], vectors[:, ::-1][:, :most]
    kept = values > NEGLIGIBLE * values[0]
    return np.ascontiguousarray(vectors[:, kept] * (np.sign(vectors[-1, kept]) * np.sqrt(values[kept])))


def tabulated(table: FloatArray, place: FloatArray) -> FloatArray:
    """Values (S, m) of tabulated functions at places (S,), taken to the ends of [−1, 1] beyond them."""
    position = (np.clip(place, -1.0, 1.0) + 1.0) * 0.5 * (len(table) - 1)
    index = np.minimum(position.astype(np.int64), len(table) - 2)
    values = np.diff(table, axis=0)[index]
    values *= (position - index)[:, None]
    values += table[index]
    return values


WARP = 0.04
"""Share of the largest speed around which the scale of speed turns from straight to logarithmic."""


def warped(share: FloatArray) -> FloatArray:
    """Speed as a share of the largest (0 … 1) on a scale, 0 … 1, that gives slow motion as much room as fast."""
    return np.asarray(np.arcsinh(share / WARP) / np.arcsinh(1.0 / WARP))


def unwarped(place: FloatArray) -> FloatArray:
    """Inverse of `warped`."""
    return np.asarray(WARP * np.sinh(place * np.arcsinh(1.0 / WARP)))


def fade(place: FloatArray, width: float) -> FloatArray:
    """1 within [−1, 1], 0 from `width` beyond it, half a cosine in between."""
    beyond = np.clip((np.abs(place) - 1.0) / width, 0.0, 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * beyond))


def stops(path: FloatArray, widths: FloatArray, *, periodic: bool) -> FloatArray:
    """States (S, m) of stop operators along a path (S,), each over its width: −1 … 1.

    A stop follows the path as a spring until it slips at its width (Prandtl; Brokate and Sprekels 1996). Starts at 0;
    a periodic path is walked twice, so that the second pass is the steady state. Between two reversals the state is
    known in closed form.
    """
    samples = path.size
    path = np.concatenate([path, path, path[:1]]) if periodic else path
    step = np.diff(path)
    moving = np.flatnonzero(step)
    state = np.zeros((path.size, widths.size))
    if moving.size:
        direction = np.sign(step[moving])
        turns = moving[np.flatnonzero(np.diff(direction)) + 1]
        start = np.zeros(widths.size)
        for first, last in zip([int(moving[0]), *turns], [*turns, path.size - 1], strict=True):
            travel = (path[first : last + 1] - path[first])[:, None] / widths
            state[first : last + 1] = np.clip(start + travel, -1.0, 1.0)
            start = state[last]
    return state[samples : 2 * samples] if periodic else state


def responses(
    signal: FloatArray,
    step_s: float,
    *,
    periodic: bool,
    lags_s: FloatArray,
    resonances_hz: FloatArray,
    damping: float,
    poles: int = 1,
) -> FloatArray:
    """A signal (S,) through filters that vanish at rest, (S, lags · poles + 2 · resonances): what linear dynamics adds.

    s T/(1 + s T)ⁱ for each lag, i = 1 … poles, then s w/(s² + 2 ζ w s + w²) and s²/(…) for each resonance of w = 2π f:
    two phases. Two poles are near a delay without any lag.

    A signal that does not wrap around is taken from its first value, and followed by SETTLE_S of that value, so that
    what a causal filter makes of its end does not reach its beginning.
    """
    samples = signal.size
    if not periodic:
        signal = np.concatenate([signal - signal[0], np.zeros(round(SETTLE_S / step_s))])
    s = 2.0j * np.pi * np.fft.rfftfreq(signal.size, step_s)[:, None]
    natural = 2.0 * np.pi * resonances_hz
    below = s**2 + 2.0 * damping * natural * s + natural**2
    behind = [s * lags_s / (1.0 + s * lags_s) ** order for order in range(1, poles + 1)]
    transfer = np.concatenate([*behind, s * natural / below, s**2 / below], axis=1)
    spectrum = rfft(signal)[:, None]
    return np.asarray(irfft(transfer * spectrum, n=signal.size, axis=0)[:samples], dtype=np.float64)
