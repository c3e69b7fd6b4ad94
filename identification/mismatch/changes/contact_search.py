"""The search for pushes: short smooth torques in one period; the window is found here, the rest in `contact_force`.

Here too: single samples that stand out, which look like very short pushes and are faults of the data.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np

from identification.arrays import DEVIATION_FROM_MEDIAN, FloatArray, IntArray
from identification.mismatch.changes.candidates import REFINED, Candidate, dispersion_of, fit_of, hopeless, inflated
from identification.mismatch.changes.contact_force import locate_push, refine_window, window_gain
from identification.mismatch.changes.contrasts import Contrasts
from identification.mismatch.changes.push_fit import WINDOW
from identification.mismatch.effects.external_contact import ExternalContact
from identification.signals.periodic import to_lines

CONTACT_DURATIONS_S = (0.15, 0.3, 0.6, 1.2, 2.4)
OUTLIER_GAIN = 30.0
OUTLIER_PASSES = 8


def find_contact(
    contrasts: Contrasts, effect: ExternalContact, closed: Collection[tuple[float, float]], least: float = 0.0
) -> Candidate | None:
    """The window in which a push on a link explains most; `closed` are spans (s) that are already explained.

    least: gain below which another change is taken first, so that none is looked for.
    """
    scan = _scan_windows(contrasts, closed)
    if scan is None:
        return None
    start, duration, tests, dispersion = scan
    ground = PeriodGround(contrasts, start, duration)
    shape = refine_window(ground, start, duration)
    # A force on a link gains no more than free torques do; its chance has its own and the window's parameters.
    gain = window_gain(ground, shape) / dispersion
    if hopeless(gain, 3 + len(WINDOW), tests) or REFINED * gain < least:
        return None
    push = locate_push(ground, effect, shape, dispersion, least * dispersion)
    if push is None:
        return None
    fit = fit_of(contrasts, effect, push.place, push.shape)
    directions = min(len(push.joints), 6)
    chance = fit.log10_chance(tests, len(WINDOW) + max(0, directions - fit.rank), dispersion)
    span = (push.shape["start_s"], push.shape["start_s"] + push.shape["duration_s"])
    return Candidate(
        effect,
        push.place,
        push.shape,
        inflated(fit, dispersion),
        chance,
        tests,
        push.shape_std,
        dispersion,
        span,
        added_covariance=dispersion * (push.covariance - fit.covariance),
    )


class PeriodGround:
    """The contrasts of those periods that a push may reach; see `Ground`.

    A push in P of K periods stands in the mean too: its contrasts have the squares of the periods, by I − 11ᵀ/K.
    """

    def __init__(self, contrasts: Contrasts, start: float, duration: float) -> None:
        motion = contrasts.motion
        self.motion = motion
        length = motion.samples * motion.sampling_period_s
        first, last = start - duration, start + 2.0 * duration
        self._periods = np.flatnonzero((motion.start_s + length > first) & (motion.start_s < last))
        self._contrasts = contrasts
        count, share = self._periods.size, self._periods.size / contrasts.periods
        left = np.sqrt(max(1.0 - share, 1e-6))
        self._root = np.eye(count) - (1.0 - left) / count
        self._back = np.eye(count) + (1.0 / left - 1.0) / count
        self._target = np.einsum("pk,krj->prj", self._back, contrasts.z[self._periods])
        target = contrasts.without_seam(self._target[..., None], range(contrasts.evidence.n))[..., 0]
        self._against = (target * contrasts.weight).reshape(-1, contrasts.evidence.n)
        self._seams = (contrasts.seam * contrasts.weight[..., None]).reshape(len(contrasts.seam), -1)

    def course(self, factor_of: Callable[[FloatArray], FloatArray], near: IntArray | None = None) -> FloatArray:
        """(P, S)."""
        time = self.motion.time if near is None else self.motion.time[near]
        return np.stack([factor_of(self.motion.start_s[k] + time) for k in self._periods])

    def rows(self, values: FloatArray, joints: Sequence[int]) -> FloatArray:
        """(P R J, m)."""
        evidence = self._contrasts.evidence
        parts = np.zeros((len(values), evidence.frequency.size, *values.shape[2:]))
        for place, part in enumerate(values):
            if part.any():
                parts[place] = self._contrasts.whiten_repeated(evidence.project(part), joints)
        parts = np.einsum("pk,krjm->prjm", self._root, parts) if len(parts) > 1 else parts * self._root[0, 0]
        return np.asarray(parts.reshape(-1, values.shape[-1]), dtype=np.float64)

    def target(self, joints: Sequence[int]) -> FloatArray:
        """(P R J,)."""
        return np.ascontiguousarray(self._target[:, :, list(joints)]).reshape(-1)

    def free(self, factors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Diagonal, as the joints' noises are independent."""
        evidence, contrasts = self._contrasts.evidence, self._contrasts
        plain = np.zeros((len(factors), evidence.frequency.size))
        for place in np.flatnonzero(factors.any(axis=1)):
            plain[place] = evidence.project(factors[place][:, None])[:, 0]
        plain = self._root @ plain
        # Rows without seam: their squares are those with it, less those of their part in it.
        seams = (plain @ self._seams).reshape(len(plain), evidence.n, -1)
        squares = (plain**2).sum(axis=0) @ contrasts.weight**2 - (seams**2).sum(axis=(0, 2))
        return np.diag(np.maximum(squares, 0.0)), plain.ravel() @ self._against


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
        seams = (turned(rows[None], contrasts.seam.transpose(2, 0, 1), grid) ** 2).sum(axis=0)
        norm = np.maximum((rows**2).sum(axis=0) - seams, 1e-300) * keep
        sizes = turned(rows[None], contrasts.z, grid) / np.sqrt(norm)
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
    scatter = DEVIATION_FROM_MEDIAN * np.median(np.abs(there - np.median(there, axis=0)), axis=0)
    freedom_there = max(1, round(0.4 * (contrasts.periods - 1) * scatter.size))
    dispersion = dispersion_of(float((scatter**2).mean()) * freedom_there, freedom_there)
    return start, duration, tests, dispersion


def _neighbours(place: int, width: float, grid: int) -> list[int]:
    """Positions of a window and of the two that adjoin it."""
    return [round(place + shift * width) % grid for shift in (-1, 0, 1)]


def turned(rows: FloatArray, z: FloatArray, grid: int) -> FloatArray:
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
        gains = turned(jerk[None], z, grid) / (jerk**2).sum(axis=0)
        power = gains**2 * (jerk**2).sum(axis=0)
        at = power.argmax(axis=1)
        periods, joints = np.nonzero(power.max(axis=1) > OUTLIER_GAIN)
        if not periods.size:
            break
        pushed = turned(window[None], z, grid) ** 2 / (window**2).sum(axis=0)
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
