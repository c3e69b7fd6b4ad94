"""One search per effect that changes between periods: a scan over contrasts, then a refinement of time and shape.

Each function returns the best candidate of its family on the contrasts as they are, with the chance that noise alone
makes it. What to claim, to subtract and to merge is decided in `between_periods`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import Bounds, minimize, minimize_scalar
from scipy.stats import chi2

from identification.mismatch.contrasts import Contrasts, Fit, solve
from identification.mismatch.effects.base import Place
from identification.mismatch.effects.enveloped import EnvelopedEffect
from identification.mismatch.effects.external_contact import ExternalContact, unit_forces
from identification.mismatch.effects.payload_change import PayloadChange
from identification.mismatch.effects.thermal_friction import ThermalFriction
from identification.mismatch.effects.torque_sensor_drift import EXPONENTIAL, LINEAR, STEP, TorqueSensorDrift
from identification.signals.periodic import to_lines

FloatArray = npt.NDArray[np.float64]

CONTACT_DURATIONS_S = (0.15, 0.3, 0.6, 1.2, 2.4)
PAYLOAD_SCAN = slice(0, 4)
"""Mass and first moments; the inertia about the joint adds little to the detection."""
COURSE_MARGIN = 8.0
"""A course with a time of its own must gain this much more than the linear one."""
POINT_MARGIN = 14.0
"""A contact at a free point of another link must gain this much more than one on the last link's axis."""
LARGEST_ARM_M = 0.5
PROFILE_STARTS = (1.0, 0.2)
OUTLIER_GAIN = 30.0
OUTLIER_PASSES = 8


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A candidate on the contrasts. joints: from 0, whose rows (K, R, J, m) it has. log10_chance, tests: see
    `Fit.log10_chance`.

    dispersion: how much noisier than its estimate the noise is beside the candidate; fit is already reduced by it.
    span_s: first and last time (s from the first sample) it acts on, for contacts; None for what lasts.
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


def find_drift(contrasts: Contrasts, effect: TorqueSensorDrift, closed: Collection[int]) -> Candidate | None:
    """The joint (not in `closed`, from 0) and course whose constant torque differs most between the periods."""
    starts = contrasts.motion.start_s
    last = float(starts[-1] + contrasts.motion.time[-1])
    times = np.geomspace(0.5 * (starts[1] - starts[0]), last, 5)
    courses = [(LINEAR, 0.0, starts)]
    courses += [(EXPONENTIAL, float(t), np.exp(-starts / t)) for t in times]
    courses += [(STEP, float(t), (starts >= t).astype(float)) for t in starts[1:]]
    weights = np.array([weight - weight.mean() for _, _, weight in courses])
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    gains = (weights @ contrasts.z[:, 0]) ** 2
    gains[:, list(closed)] = 0.0
    joint = int(np.unravel_index(np.argmax(gains), gains.shape)[1])
    if _hopeless(float(gains[:, joint].max()), 1, gains.size):
        return None
    place = Place(joint=joint + 1)
    best: dict[int, tuple[dict[str, float], Fit]] = {}
    for course, first, last_bound in ((LINEAR, 0.0, 0.0), (EXPONENTIAL, times[0], 3.0 * last), (STEP, 0.0, last)):
        choices = [index for index, (kind, _, _) in enumerate(courses) if kind == course]
        index = max(choices, key=lambda choice: float(gains[choice, joint]))
        shape = {"course": float(course), "time_s": courses[index][1]}
        if course == EXPONENTIAL:
            shape = _refine(contrasts, effect, place, shape, "time_s", (float(first), float(last_bound)), log=True)
        elif course == STEP:
            period = float(starts[1] - starts[0])
            around = (max(0.0, shape["time_s"] - period), min(last, shape["time_s"] + period))
            shape = _refine(contrasts, effect, place, shape, "time_s", around, points=21)
        best[course] = (shape, _fit(contrasts, effect, place, shape))
    chosen = max(best, key=lambda course: best[course][1].gain - (COURSE_MARGIN if course != LINEAR else 0.0))
    shape, fit = best[chosen]
    if chosen == LINEAR:
        shape = {"course": float(LINEAR)}
    rest = contrasts.z[:, 0, joint] @ contrasts.z[:, 0, joint] - gains[:, joint].max()
    dispersion = _dispersion(rest, contrasts.periods - 2)
    tests = float(contrasts.evidence.n * len(courses))
    chance = fit.log10_chance(tests, int(chosen != LINEAR), dispersion)
    std = {} if chosen == LINEAR else _spread(contrasts, effect, place, shape, "time_s", fit.gain)
    return Candidate(effect, place, shape, _inflated(fit, dispersion), chance, tests, std, dispersion)


def find_thermal(contrasts: Contrasts, effect: ThermalFriction, closed: Collection[int]) -> Candidate | None:
    """The joint whose friction fades most over the periods."""
    motion, starts = contrasts.motion, contrasts.motion.start_s
    best: tuple[float, Place, float] | None = None
    rests: dict[Place, float] = {}
    parameter = effect.shape_parameters(motion, Place())[0]
    places = [place for place in effect.places(motion) if place.joint is not None and place.joint - 1 not in closed]
    for place in places:
        assert place.joint is not None
        found = contrasts.repeated(effect, place, {})
        if found is None:
            continue
        white = contrasts.whiten_repeated(found[2], found[0])[:, 0]
        basis = np.linalg.qr(white)[0]
        seen = contrasts.z[:, :, place.joint - 1] @ basis
        for time in parameter.grid:
            weight = np.exp(-starts / time)
            weight = (weight - weight.mean()) / np.linalg.norm(weight - weight.mean())
            gain = float(np.sum((weight @ seen) ** 2))
            if best is None or gain > best[0]:
                best = (gain, place, time)
                rests[place] = float(np.sum(seen**2)) - gain
    if best is None or _hopeless(best[0], 2, len(places) * len(parameter.grid)):
        return None
    _, place, time = best
    bounds = (parameter.lower, parameter.upper)
    shape = _refine(contrasts, effect, place, {parameter.name: time}, parameter.name, bounds, log=True, points=9)
    fit = _fit(contrasts, effect, place, shape)
    dispersion = _dispersion(rests[place], 2 * (contrasts.periods - 2))
    tests = float(len(places) * len(parameter.grid))
    chance = fit.log10_chance(tests, 1, dispersion)
    std = _spread(contrasts, effect, place, shape, parameter.name, fit.gain)
    return Candidate(effect, place, shape, _inflated(fit, dispersion), chance, tests, std, dispersion)


def find_payload(contrasts: Contrasts, effect: PayloadChange) -> Candidate | None:
    """The moment at which the last link's parameters change, to a sample."""
    motion, starts = contrasts.motion, contrasts.motion.start_s
    place = effect.places(motion)[0]
    found = contrasts.repeated(effect, place, {})
    assert found is not None
    joints, values, constant = found
    white = contrasts.whiten_repeated(constant[..., PAYLOAD_SCAN], joints)
    gram = np.einsum("rjm,rjp->mp", white, white)
    seen = np.einsum("krj,rjm->km", contrasts.z[:, :, list(joints)], white)
    best_gain, best_step = -np.inf, 1
    for step in range(1, contrasts.periods):
        weight = (np.arange(contrasts.periods) >= step).astype(float)
        weight = (weight - weight.mean()) / np.linalg.norm(weight - weight.mean())
        right = weight @ seen
        gain = float(right @ solve(gram, right)[0])
        if gain > best_gain:
            best_gain, best_step = gain, step
    if _hopeless(best_gain, 4, 8.0 * contrasts.periods):
        return None
    shape = {"time_s": float(starts[best_step])}
    period = float(starts[1] - starts[0])
    last = float(starts[-1] + motion.time[-1])
    for width in (period, 0.1 * period, 0.02 * period):
        # With the change's own torque known, each moment costs one projection.
        coefficients = _fit(contrasts, effect, place, shape, PAYLOAD_SCAN).coefficients
        torque = values[..., PAYLOAD_SCAN] @ coefficients
        rows = constant[..., PAYLOAD_SCAN] @ coefficients

        def gain_at(time: float, torque: FloatArray = torque, rows: FloatArray = rows) -> float:
            factors = effect.envelope(motion, {"time_s": time})
            flat = np.ptp(factors, axis=1) == 0.0
            weights = [np.where(flat, factors[:, 0], 0.0)]
            patterns = [contrasts.whiten_repeated(rows[..., None], joints)]
            for number in np.flatnonzero(~flat):
                weights.append((np.arange(contrasts.periods) == number).astype(float))
                part = contrasts.evidence.project(factors[number][:, None] * torque)
                patterns.append(contrasts.whiten_repeated(part[..., None], joints))
            return contrasts.fit_pieces(joints, np.array(weights), patterns).gain

        grid = np.linspace(max(0.0, shape["time_s"] - width), min(last, shape["time_s"] + width), 31)
        gains = [gain_at(float(time)) for time in grid]
        best = int(np.argmax(gains))
        bounds = (grid[max(0, best - 1)], grid[min(30, best + 1)])
        result = minimize_scalar(
            lambda time: -gain_at(float(time)), bounds=bounds, method="bounded", options={"xatol": 1e-4}
        )
        shape = {"time_s": float(result.x if -result.fun > gains[best] else grid[best])}
    fit = _fit(contrasts, effect, place, shape)
    tests = 8.0 * contrasts.periods
    chance = fit.log10_chance(tests, 1)
    std = _spread(contrasts, effect, place, shape, "time_s", fit.gain, smallest=motion.sampling_period_s)
    return Candidate(effect, place, shape, fit, chance, tests, std)


def find_contact(
    contrasts: Contrasts, effect: ExternalContact, closed: Collection[tuple[float, float]]
) -> Candidate | None:
    """The window in which a push on a link explains most; `closed` are spans (s) that are already explained."""
    scan = _scan_windows(contrasts, closed)
    if scan is None:
        return None
    start, duration, tests, dispersion = scan
    shape = _refine_window(contrasts, effect, start, duration)
    best: tuple[float, Place, dict[str, float]] | None = None
    for place in reversed(effect.places(contrasts.motion)):
        gain, point = _best_point(contrasts, effect, place, shape)
        margin = POINT_MARGIN + 0.02 * gain if best is not None and best[1].link == contrasts.motion.n else 3.0
        if best is None or gain > best[0] + margin:
            best = (gain, place, point)
    assert best is not None
    _, place, point = best
    shape = _polish(contrasts, effect, place, shape | point)
    fit = _fit(contrasts, effect, place, shape)
    chance = fit.log10_chance(tests, 4, dispersion)
    std = {
        name: value
        for key in ("start_s", "duration_s")
        for name, value in _spread(contrasts, effect, place, shape, key, fit.gain).items()
    }
    span = (shape["start_s"], shape["start_s"] + shape["duration_s"])
    return Candidate(effect, place, shape, _inflated(fit, dispersion), chance, tests, std, dispersion, span)


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
                sizes[:, where[1], : where[2] + 1],
                int(where[2]),
                float(by_link[where]),
            )
    if best is None or not np.isfinite(best[0]):
        return None
    _, start, duration, there, joint, gain_there = best
    if _hopeless(gain_there, joint + 1, tests):
        return None
    # Scatter of the same window over the periods, blind to pushes in fewer than half of them.
    scatter = 1.4826 * np.median(np.abs(there - np.median(there, axis=0)), axis=0)
    freedom_there = max(1, round(0.4 * (contrasts.periods - 1) * (joint + 1)))
    dispersion = _dispersion(float((scatter**2).mean()) * freedom_there, freedom_there)
    return start, duration, tests, dispersion


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
    joints = tuple(range(contrasts.evidence.n))

    def gain_of(shape: Mapping[str, float]) -> float:
        factors = effect.envelope(contrasts.motion, shape)
        rows = np.zeros((contrasts.periods, len(contrasts.evidence.frequency), 1, 1))
        for period, factor in enumerate(factors):
            if factor.any():
                rows[period] = contrasts.evidence.project(factor[:, None])[:, :, None]
        white = contrasts.whiten(np.broadcast_to(rows, (*rows.shape[:2], len(joints), 1)), joints)[..., 0]
        norm = np.maximum((white**2).sum(axis=(0, 1)), 1e-300)
        return float(((white * contrasts.z).sum(axis=(0, 1)) ** 2 / norm).sum())

    window = {"start_s": start, "duration_s": duration, "skew": 1.0}
    found = [_search(gain_of, {**window, "sharpness": sharpness}, 100) for sharpness in PROFILE_STARTS]
    return max(found, key=gain_of)


def _polish(contrasts: Contrasts, effect: ExternalContact, place: Place, shape: dict[str, float]) -> dict[str, float]:
    """Window and profile once more, now with the force itself."""
    free = {name: shape[name] for name in ("start_s", "duration_s", "sharpness", "skew")}
    fixed = {name: value for name, value in shape.items() if name not in free}
    found = _search(lambda trial: _fit(contrasts, effect, place, {**fixed, **trial}).gain, free, 60, step=0.03)
    return {**fixed, **found}


def _search(
    gain_of: Callable[[Mapping[str, float]], float], shape: dict[str, float], evaluations: int, step: float = 0.15
) -> dict[str, float]:
    """Simplex search over window centre, and the logarithms of duration, sharpness and skew."""
    middle = shape["start_s"] + 0.5 * shape["duration_s"]

    def unpack(x: FloatArray) -> dict[str, float]:
        duration = shape["duration_s"] * float(np.exp(x[1]))
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


def _fit(
    contrasts: Contrasts,
    effect: EnvelopedEffect,
    place: Place,
    shape: Mapping[str, float],
    columns: slice = slice(None),
) -> Fit:
    return contrasts.fit_pieces(*contrasts.pieces(effect, place, shape, columns))


def _refine(
    contrasts: Contrasts,
    effect: EnvelopedEffect,
    place: Place,
    shape: dict[str, float],
    name: str,
    bounds: tuple[float, float],
    *,
    log: bool = False,
    points: int = 7,
) -> dict[str, float]:
    """One shape parameter at its best: a grid over the bounds, then a bounded search around its best point."""
    forward, back = (np.log, np.exp) if log else (float, float)
    low, high = float(forward(max(bounds[0], 1e-9) if log else bounds[0])), float(forward(bounds[1]))

    def gain_at(x: float) -> float:
        return _fit(contrasts, effect, place, {**shape, name: float(back(x))}).gain

    grid = np.linspace(low, high, points)
    gains = [gain_at(float(x)) for x in grid]
    best = int(np.argmax(gains))
    inner = (float(grid[max(0, best - 1)]), float(grid[min(points - 1, best + 1)]))
    result = minimize_scalar(lambda x: -gain_at(float(x)), bounds=inner, method="bounded", options={"maxiter": 20})
    x = float(result.x) if -result.fun > gains[best] else float(grid[best])
    return {**shape, name: float(back(x))}


def _spread(
    contrasts: Contrasts,
    effect: EnvelopedEffect,
    place: Place,
    shape: Mapping[str, float],
    name: str,
    gain: float,
    smallest: float = 1e-6,
) -> dict[str, float]:
    """Standard deviation of one shape parameter from how fast the gain falls off: 2 × 1σ ≙ a drop of 1 on each side."""
    value = shape[name]
    step = max(1e-3 * abs(value), smallest)
    for _ in range(12):
        drops = [
            gain - _fit(contrasts, effect, place, {**shape, name: value + sign * step}).gain for sign in (-1.0, 1.0)
        ]
        drop = 0.5 * (drops[0] + drops[1])
        if drop > 0.5:
            return {name: float(step / np.sqrt(drop))}
        step *= 2.0
        if step > abs(value) and value != 0.0:
            break
    return {name: float("nan")}


def _hopeless(gain: float, dof: int, tests: float) -> bool:
    """Whether a refinement, which adds a fifth to a scan's gain, cannot make it significant."""
    return bool(chi2.logsf(1.2 * gain + 3.0, dof) + np.log(tests) > -6.0)


def _dispersion(squares: float, freedom: int) -> float:
    """How much noisier the contrasts beside a candidate are than the noise estimate says; 1 within its own scatter.

    Drifting or wandering noise that successive differences do not see shows here.
    """
    ratio = squares / max(1, freedom)
    return float(ratio) if ratio > 1.0 + 2.0 * np.sqrt(2.0 / max(1, freedom)) else 1.0


def _inflated(fit: Fit, dispersion: float) -> Fit:
    return replace(fit, gain=fit.gain / dispersion, covariance=fit.covariance * dispersion)
