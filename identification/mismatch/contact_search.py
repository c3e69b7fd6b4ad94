"""The search for pushes: short smooth torques in one period, their window first, then link, point and force.

Here too: single samples that stand out, which look like very short pushes and are faults of the data. Called by
`between_periods`, which decides what is claimed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import Bounds, minimize, minimize_scalar

from identification.mismatch.change_candidates import Candidate, dispersion_of, fit_of, hopeless, inflated, spread_of
from identification.mismatch.contrasts import Contrasts, solve
from identification.mismatch.effects.base import Place
from identification.mismatch.effects.external_contact import ExternalContact, unit_forces
from identification.signals.periodic import to_lines

FloatArray = npt.NDArray[np.float64]

WINDOW = ("start_s", "duration_s", "sharpness", "skew")
CONTACT_DURATIONS_S = (0.15, 0.3, 0.6, 1.2, 2.4)
SHORTEST_S = 0.03
LONGEST_SHARE = 0.4
"""Longest contact, as a share of the period."""
POINT_MARGIN = 14.0
"""A contact at a free point of another link must gain this much more than one on the last link's axis."""
LARGEST_ARM_M = 0.5
PROFILE_STARTS = (1.0, 0.2)
OUTLIER_GAIN = 30.0
OUTLIER_PASSES = 8


def find_contact(
    contrasts: Contrasts, effect: ExternalContact, closed: Collection[tuple[float, float]]
) -> Candidate | None:
    """The window in which a push on a link explains most; `closed` are spans (s) that are already explained."""
    scan = _scan_windows(contrasts, closed)
    if scan is None:
        return None
    start, duration, tests, dispersion = scan
    shape = _refine_window(contrasts, effect, start, duration)
    # A force on a link gains no more than free torques do; its chance has its own and the window's parameters.
    free = float(_free_gains(contrasts, effect.envelope(contrasts.motion, shape)).sum())
    if hopeless(free / dispersion, 3 + len(WINDOW), tests):
        return None
    best: tuple[float, Place, dict[str, float]] | None = None
    for place in reversed(effect.places(contrasts.motion)):
        gain, point = _best_point(contrasts, effect, place, shape)
        margin = POINT_MARGIN + 0.02 * gain if best is not None and best[1].link == contrasts.motion.n else 3.0
        if best is None or gain > best[0] + margin:
            best = (gain, place, point)
    assert best is not None
    _, place, point = best
    shape = _polish(contrasts, effect, place, shape | point)
    fit = fit_of(contrasts, effect, place, shape)
    chance = fit.log10_chance(tests, len(WINDOW), dispersion)
    std = {
        name: value
        for key in ("start_s", "duration_s")
        for name, value in spread_of(contrasts, effect, place, shape, key, fit.gain).items()
    }
    span = (shape["start_s"], shape["start_s"] + shape["duration_s"])
    return Candidate(effect, place, shape, inflated(fit, dispersion), chance, tests, std, dispersion, span)


def _scan_windows(
    contrasts: Contrasts, closed: Collection[tuple[float, float]]
) -> tuple[float, float, float, float] | None:
    """Start and duration of the best half-sine window, number of tests, and how noisy that window is elsewhere.

    All positions of a window at once: its lines only turn with its position, so the products with the data are an
    inverse Fourier transform. (Of the plain lines: the samples that `evidence.project` leaves out do not move along.)
    """
    motion, evidence = contrasts.motion, contrasts.evidence
    period = motion.samples * motion.sampling_period_s
    lines = (len(evidence.frequency) - 1) // 2
    grid = 4 * lines
    position = np.arange(grid) * period / grid
    keep = 1.0 - 1.0 / contrasts.periods
    best: tuple[float, float, float, FloatArray, int, float] | None = None
    tests = 0.0
    for duration in CONTACT_DURATIONS_S:
        if duration > 0.3 * period or duration < 4.0 * motion.sampling_period_s:
            continue
        bump = np.where(motion.time < duration, np.sin(np.pi * motion.time / duration), 0.0)
        rows = contrasts.weight * to_lines(bump[:, None], lines)
        turned = _turned(rows[None], contrasts.ramp[None], grid)[0]
        norm = np.maximum((rows**2).sum(axis=0) - turned**2, 1e-300) * keep
        sizes = _turned(rows[None], contrasts.z, grid) / np.sqrt(norm)
        gains = sizes**2
        by_link = np.cumsum(gains, axis=2)
        freedom = np.arange(1, evidence.n + 1)
        value = by_link - 2.0 * freedom - 2.0 * np.sqrt(freedom)
        begin = motion.start_s[:, None] + position
        for low, high in closed:
            value[(begin + duration > low) & (begin < high)] = -np.inf
        tests += 3.0 * evidence.n * contrasts.periods * period / duration
        where = np.unravel_index(int(np.argmax(value)), value.shape)
        if best is None or value[where] > best[0]:
            best = (
                float(value[where]),
                float(begin[where[:2]]),
                duration,
                sizes[:, _neighbours(int(where[1]), duration / period * grid, grid), : where[2] + 1],
                int(where[2]),
                float(by_link[where]),
            )
    if best is None or not np.isfinite(best[0]):
        return None
    _, start, duration, there, joint, gain_there = best
    if hopeless(gain_there, joint + 1, tests):
        return None
    # Scatter of the same window and of those beside it over the periods, blind to pushes in fewer than half of them.
    scatter = 1.4826 * np.median(np.abs(there - np.median(there, axis=0)), axis=0)
    freedom_there = max(1, round(0.4 * (contrasts.periods - 1) * scatter.size))
    dispersion = dispersion_of(float((scatter**2).mean()) * freedom_there, freedom_there)
    return start, duration, tests, dispersion


def _neighbours(place: int, width: float, grid: int) -> list[int]:
    """Positions of a window and of the two that adjoin it."""
    return [round(place + shift * width) % grid for shift in (-1, 0, 1)]


def _turned(rows: FloatArray, z: FloatArray, grid: int) -> FloatArray:
    """Products of z (K, R, n) with rows (1, R, n) of a window at each of `grid` positions: (K, grid, n)."""
    window = rows[:, 1::2] + 1j * rows[:, 2::2]
    data = z[:, 1::2] + 1j * z[:, 2::2]
    spectrum = np.concatenate([2.0 * rows[:, :1] * z[:, :1] + 0j, np.conj(window) * data], axis=1)
    return np.asarray(np.fft.irfft(spectrum, n=grid, axis=1) * (grid / 2.0), dtype=np.float64)


def without_outliers(contrasts: Contrasts) -> FloatArray:
    """The contrasts without single samples that stand out: they are faults of the data and look like short pushes.

    A sample counts as one when a sudden jerk there explains more than any push of CONTACT_DURATIONS_S[0] around it.
    """
    motion, evidence = contrasts.motion, contrasts.evidence
    z = contrasts.z.copy()
    lines = (len(evidence.frequency) - 1) // 2
    grid = 16 * lines
    period = motion.samples * motion.sampling_period_s
    near = round(CONTACT_DURATIONS_S[0] / period * grid)
    single = np.zeros(motion.samples)
    single[0] = 1.0
    push = np.where(motion.time < CONTACT_DURATIONS_S[0], np.sin(np.pi * motion.time / CONTACT_DURATIONS_S[0]), 0.0)
    jerk, window = (contrasts.weight * to_lines(shape[:, None], lines) for shape in (single, push))
    angle = 2.0 * np.pi / grid * np.arange(1, lines + 1)
    for _ in range(OUTLIER_PASSES):
        gains = _turned(jerk[None], z, grid) / (jerk**2).sum(axis=0)
        power = gains**2 * (jerk**2).sum(axis=0)
        at = power.argmax(axis=1)
        periods, joints = np.nonzero(power.max(axis=1) > OUTLIER_GAIN)
        if not periods.size:
            break
        pushed = _turned(window[None], z, grid) ** 2 / (window**2).sum(axis=0)
        found = False
        for k, j in zip(periods, joints, strict=True):
            place = int(at[k, j])
            around = np.arange(place - 2 * near, place + near) % grid
            if pushed[k, around, j].max() > power[k, place, j]:
                continue
            turn = np.exp(-1j * angle * place)
            spectrum = (jerk[1::2, j] + 1j * jerk[2::2, j]) * turn
            rows = np.concatenate([jerk[:1, j], np.stack([spectrum.real, spectrum.imag], axis=1).ravel()])
            z[k, :, j] -= gains[k, place, j] * rows
            found = True
        if not found:
            break
    return np.asarray(z - z.mean(axis=0), dtype=np.float64)


def _refine_window(contrasts: Contrasts, effect: ExternalContact, start: float, duration: float) -> dict[str, float]:
    """Window and profile with free torques on every joint: only the profile has to be projected."""

    def gain_of(shape: Mapping[str, float]) -> float:
        return float(_free_gains(contrasts, effect.envelope(contrasts.motion, shape)).sum())

    window = {"start_s": start, "duration_s": duration, "skew": 1.0}
    found = [
        _search(gain_of, {**window, "sharpness": sharpness}, _longest(contrasts), 100) for sharpness in PROFILE_STARTS
    ]
    return max(found, key=gain_of)


def _free_gains(contrasts: Contrasts, factors: FloatArray) -> FloatArray:
    """(n,) what a torque of its own on each joint gains under one profile, factors (K, S) of its course."""
    touched = np.flatnonzero(factors.any(axis=1))
    if not touched.size:
        return np.zeros(contrasts.evidence.n)
    n = contrasts.evidence.n
    rows = [
        np.broadcast_to(contrasts.evidence.project(factors[k][:, None]), (len(contrasts.weight), n)) for k in touched
    ]
    white = np.stack([contrasts.whiten_repeated(row[..., None], range(n))[..., 0] for row in rows])
    norm = (white**2).sum(axis=(0, 1)) - (white.sum(axis=0) ** 2).sum(axis=0) / contrasts.periods
    seen = np.einsum("krj,krj->j", white, contrasts.z[touched])
    return np.asarray(seen**2 / np.maximum(norm, 1e-300), dtype=np.float64)


def _polish(contrasts: Contrasts, effect: ExternalContact, place: Place, shape: dict[str, float]) -> dict[str, float]:
    """Window and profile once more, now with the force itself."""
    free = {name: shape[name] for name in WINDOW}
    fixed = {name: value for name, value in shape.items() if name not in free}
    found = _search(
        lambda trial: fit_of(contrasts, effect, place, {**fixed, **trial}).gain,
        free,
        _longest(contrasts),
        60,
        step=0.03,
    )
    return {**fixed, **found}


def _longest(contrasts: Contrasts) -> float:
    return LONGEST_SHARE * contrasts.motion.samples * contrasts.motion.sampling_period_s


def _search(
    gain_of: Callable[[Mapping[str, float]], float],
    shape: dict[str, float],
    longest_s: float,
    evaluations: int,
    step: float = 0.15,
) -> dict[str, float]:
    """Simplex search over window centre, and the logarithms of duration, sharpness and skew."""
    middle = shape["start_s"] + 0.5 * shape["duration_s"]
    stretch = np.log(np.array([SHORTEST_S, longest_s]) / shape["duration_s"])

    def unpack(x: FloatArray) -> dict[str, float]:
        duration = shape["duration_s"] * float(np.exp(np.clip(x[1], *stretch)))
        return {
            "start_s": middle + float(x[0]) * shape["duration_s"] - 0.5 * duration,
            "duration_s": duration,
            "sharpness": float(np.clip(shape["sharpness"] * np.exp(3.0 * x[2]), 0.05, 4.0)),
            "skew": float(np.clip(shape["skew"] * np.exp(x[3]), 0.3, 3.0)),
        }

    simplex = np.vstack([np.zeros(4), step * np.eye(4)])
    options: Any = {"maxfev": evaluations, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-2}
    result = minimize(  # type: ignore[call-overload]  # the stubs lose the array type of the lambda
        lambda x: -gain_of(unpack(x)),
        np.zeros(4),
        method="Nelder-Mead",
        options=options,
    )
    return unpack(result.x) if -result.fun > gain_of(shape) else shape


def _best_point(
    contrasts: Contrasts, effect: ExternalContact, place: Place, shape: Mapping[str, float]
) -> tuple[float, dict[str, float]]:
    """Gain of a force on a link at its best point: on the axis of the last link, anywhere near on the others.

    The torque is bilinear in force and point; with the twelve products' normal equations made once, each point is a
    three-parameter problem.
    """
    motion = contrasts.motion
    assert place.link is not None
    upstream = motion.robot.kinematics.upstream(place.link - 1)
    factors = effect.envelope(motion, shape)
    rows = np.zeros((contrasts.periods, len(contrasts.evidence.frequency), len(upstream), 12))
    for period, factor in enumerate(factors):
        touched = factor > 0.0
        if touched.any():
            values = np.zeros((motion.samples, len(upstream), 12))
            forces = unit_forces(motion, motion.position[touched], place.link)[:, list(upstream)]
            values[touched] = factor[touched, None, None] * forces.reshape(*forces.shape[:2], 12)
            rows[period] = contrasts.evidence.project(values)
    white = contrasts.whiten(rows, upstream).reshape(-1, 12)
    right = white.T @ np.ascontiguousarray(contrasts.z[:, :, list(upstream)]).reshape(-1)
    gram = white.T @ white

    def gain_at(point: FloatArray) -> float:
        expand = np.kron(np.eye(3), np.concatenate([[1.0], point])[:, None])
        projected = expand.T @ right
        return float(projected @ solve(expand.T @ gram @ expand, projected)[0])

    if place.link == motion.n:
        axis = motion.robot.kinematics.axis[place.link - 1]
        result = minimize_scalar(
            lambda reach: -gain_at(reach * axis), bounds=(-LARGEST_ARM_M, LARGEST_ARM_M), method="bounded"
        )
        point, gain = float(result.x) * axis, -float(result.fun)
    else:
        best = minimize(  # type: ignore[call-overload]
            lambda p: -gain_at(p),
            np.array([0.05, 0.05, 0.05]),
            method="L-BFGS-B",
            bounds=Bounds(np.full(3, -LARGEST_ARM_M), np.full(3, LARGEST_ARM_M)),
        )
        point, gain = np.asarray(best.x), -float(best.fun)
    return gain, {f"point_{axis}_m": float(point[i]) for i, axis in enumerate("xyz")}
