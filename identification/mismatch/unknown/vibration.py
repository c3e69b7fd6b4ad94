"""Torque with a rhythm of its own that comes and goes with what a joint does: a dither, chatter, a limit cycle.

It is in step with no period, so the mean of the periods does not hold it, and what the periods differ by counts as
noise. Sensor noise is the same wherever a joint is and however it moves; here it is asked, frequency by frequency,
whether it is. A hum is everywhere, and depends on no state. What swells at all frequencies alike, as errors of the
clock do where the torque is steep, is none either: a vibration stands out of the lines beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import fdtrc

from identification.arrays import FloatArray, IntArray
from identification.mismatch.evidence import Evidence
from identification.mismatch.motion import Motion
from identification.mismatch.settings import ROUNDING, SPEAK
from identification.mismatch.unknown.claims import ClassClaim
from identification.mismatch.unknown.forms import rms_interval
from identification.mismatch.unknown.functions import unwarped, warped
from identification.signals.periods import PeriodTable

FRAME_S = 0.1
"""Length of the frames whose spectra are compared: about as long as a joint that turns round is near standstill."""
PARTS, FEWEST = 8, 20
"""Parts of a range, of which every run is asked that has so many frames."""
LOBE, SIDE = 2, (3, 5, 7, 9, 11)
"""Lines on either side over which a Hann window spreads a vibration, and those beside it: two apart, independent."""
SHARED = 1.0 + 2.0 / 36.0
"""Frames that one is worth less: the power of two that share half of a Hann window has a correlation of 1/36."""

WHERE: dict[str, tuple[str, str, Callable[[Motion, int], FloatArray]]] = {
    "own_velocity": ("moves at", "rad/s", lambda motion, joint: np.abs(motion.velocity[:, joint])),
    "own_position": ("is at", "rad", lambda motion, joint: motion.position[:, joint]),
    "own_load": ("carries", "Nm", lambda motion, joint: motion.torque[:, joint]),
}
"""What a vibration may come and go with: words, unit, values (S,) of a joint."""


@dataclass(frozen=True, slots=True, eq=False)
class _Frames:
    """What the K periods of one recording differ by, in F frames.

    place: (F, n) of each in `WHERE`. power: (n, K, F, B) Nm² of each line. score: by its rank among all frames of its
    line, as an exponential variable of mean one has it (Savage 1956): an outlier weighs little, and a line whose noise
    is the same everywhere has the mean one everywhere. worth: independent frames that the scatter of one is worth.
    """

    place: dict[str, FloatArray]
    power: FloatArray
    score: FloatArray
    worth: float


@dataclass(frozen=True, slots=True)
class _Vibration:
    """The clearest one of a joint over one coordinate (of `WHERE`): nats, from and to where, number of its line."""

    nats: float
    coordinate: str
    between: tuple[float, float]
    line: int


def vibrating(evidences: Sequence[Evidence]) -> list[ClassClaim]:
    """The clearest vibration of each joint that depends on its own state; none of recordings without periods."""
    frames = [_frames(item.motion, item.table) for item in evidences if item.table and item.periods > 1]
    if not frames or min(item.power.shape[3] for item in frames) <= 2 * SIDE[0]:
        return []
    claims = []
    for joint in range(evidences[0].n):
        best = max((_clearest(frames, joint, name) for name in WHERE), key=lambda item: item.nats)
        if best.nats >= SPEAK:
            claims.append(_claim(frames, joint, best))
    return [claim for claim in claims if claim.interval_nm[0] > 0.0]


def _frames(motion: Motion, table: PeriodTable) -> _Frames:
    count, size = len(table.periods), round(FRAME_S / table.sampling_period_s)
    starts = np.arange(0, table.torque.shape[1] - size + 1, max(1, size // 2))
    inside = starts[:, None] + np.arange(size)
    window = np.hanning(size + 2)[1:-1]
    window /= np.linalg.norm(window)
    place = {
        name: np.stack([at(motion, joint)[:: table.finer.factor][inside] @ window**2 for joint in range(motion.n)], 1)
        for name, (_, _, at) in WHERE.items()
    }
    present = np.isfinite(table.torque)
    torque = np.where(present, table.torque, 0.0)
    differing = np.where(present, torque - torque.sum(axis=0) / np.maximum(present.sum(axis=0), 1), 0.0)
    power = np.empty((motion.n, count, len(starts), size // 2 + 1))
    score = np.empty_like(power)
    exponential = np.cumsum(1.0 / np.arange(count * len(starts), 0, -1))
    for joint in range(motion.n):
        # Of a simulation without noise the scatter is what its numbers cannot hold.
        if differing[..., joint].std() <= ROUNDING * np.abs(torque[..., joint]).max(initial=0.0):
            power[joint], score[joint] = 0.0, 1.0
            continue
        lines = np.fft.rfft(np.ascontiguousarray(differing[..., joint])[:, inside] * window, axis=2)
        power[joint] = lines.real**2 + lines.imag**2
        for line in range(power.shape[3]):
            ranked = np.empty(exponential.size)
            ranked[np.argsort(power[joint, ..., line], axis=None)] = exponential
            score[joint, ..., line] = ranked.reshape(power.shape[1:3])
    return _Frames(place, power, score, (count - 1) / count / SHARED)


def _clearest(frames: Sequence[_Frames], joint: int, name: str) -> _Vibration:
    """The run of parts and the line that stand out most, the number of all that were asked taken into account."""
    lower, upper = _range(frames, joint, name)
    lines = min(item.power.shape[3] for item in frames)
    frame_count, worth, total = np.zeros(PARTS), np.zeros(PARTS), np.zeros((PARTS, lines))
    for item in frames:
        part = _part(item.place[name][:, joint], name, lower, upper)
        periods = item.power.shape[1]
        frame_count += np.bincount(part, minlength=PARTS) * periods
        worth += np.bincount(part, minlength=PARTS) * periods * item.worth
        np.add.at(total, part, item.score[joint].sum(axis=0)[:, :lines])
    # Sums of every run of neighbouring parts but for all of them: a torque that is everywhere depends on nothing.
    runs = [(first, last) for first, last in combinations(range(PARTS + 1), 2) if last - first < PARTS]
    runs = [(first, last) for first, last in runs if frame_count[first:last].sum() >= FEWEST]
    if not runs:
        return _Vibration(-np.inf, name, (lower, upper), 0)
    mean = np.stack([total[first:last].sum(axis=0) / frame_count[first:last].sum() for first, last in runs])
    freedom = 2.0 * np.array([[worth[first:last].sum()] for first, last in runs])
    beside, number = _beside(mean)
    # Below, and at half of the sampling rate, a line has no side.
    seen = slice(SIDE[0], -1)
    chance = fdtrc(freedom, number[:, seen] * freedom, (mean / np.maximum(beside, 1.0))[:, seen])
    joints = frames[0].power.shape[0]
    nats = -np.log(np.maximum(chance, 1e-300)) - np.log(chance.size * joints * len(WHERE))
    run, line = np.unravel_index(nats.argmax(), nats.shape)
    return _Vibration(float(nats.max()), name, _ends(*runs[run], name, lower, upper), int(line) + SIDE[0])


def _range(frames: Sequence[_Frames], joint: int, name: str) -> tuple[float, float]:
    """Least and largest place of all frames; of a speed from zero on."""
    places = np.concatenate([item.place[name][:, joint] for item in frames])
    return 0.0 if name == "own_velocity" else float(places.min()), float(places.max())


def _part(place: FloatArray, name: str, lower: float, upper: float) -> IntArray:
    """Number (F,) of the part that each place lies in; slow motion has as much room as fast motion."""
    share = (place - lower) / max(upper - lower, 1e-9)
    share = warped(share) if name == "own_velocity" else share
    return np.clip((share * PARTS).astype(np.int64), 0, PARTS - 1)


def _ends(first: int, last: int, name: str, lower: float, upper: float) -> tuple[float, float]:
    """Where a run of parts begins and ends."""
    share = np.array([first, last]) / PARTS
    share = unwarped(share) if name == "own_velocity" else share
    start, end = (lower + (upper - lower) * share).tolist()
    return start, end


def _beside(mean: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The larger (R, B) of the means of the lines on either side of a line, and how many (R, B) lines that is."""
    padded = np.pad(mean, ((0, 0), (SIDE[-1], SIDE[-1])), constant_values=np.nan)
    sides = np.stack([[padded[:, SIDE[-1] + sign * step :][:, : mean.shape[1]] for step in SIDE] for sign in (-1, 1)])
    number = np.isfinite(sides).sum(axis=1)
    means = np.where(number > 0, np.nansum(sides, axis=1) / np.maximum(number, 1), -np.inf)
    above = means[1] > means[0]
    return np.where(above, means[1], means[0]), np.where(above, number[1], number[0]).astype(np.float64)


def _claim(frames: Sequence[_Frames], joint: int, found: _Vibration) -> ClassClaim:
    """`broadband`, as no function of the state is its torque: only its power depends on that."""
    words, unit, _ = WHERE[found.coordinate]
    start, end = found.between
    lines = np.arange(found.line - LOBE, min(found.line + LOBE + 1, *(item.power.shape[3] for item in frames)))
    excess, square, count = np.zeros(lines.size), 0.0, 0
    for item in frames:
        place, power = item.place[found.coordinate][:, joint], item.power[joint][..., lines]
        here = (place >= start) & (place <= end)
        # A sine of mean square s has the power s · size / 2 in its lines, of a window of length one.
        unit_of_power = 1.0 / (item.power.shape[3] - 1)
        excess += unit_of_power * (power[:, here] - power[:, ~here].mean(axis=(0, 1))).sum(axis=(0, 1))
        square += unit_of_power**2 * float((power[:, here] ** 2).sum()) / item.worth
        count += power.shape[0] * power.shape[1]
    rms, interval = rms_interval(max(float(excess.sum()), 0.0) / count, float(np.sqrt(square)) / count)
    hertz = float(np.maximum(excess, 0.0) @ lines / max(float(np.maximum(excess, 0.0).sum()), 1e-300)) / FRAME_S
    sentence = (
        f"Joint {joint + 1}: a vibration near {hertz:.0f} Hz, in step with no period, where the joint "
        f"{words} {start:.2g} to {end:.2g} {unit} and hardly elsewhere, {rms:.2g} Nm RMS ({interval[0]:.2g} to "
        f"{interval[1]:.2g}) over the recordings."
    )
    return ClassClaim("broadband", joint + 1, rms, interval, found.nats, np.zeros(0), (), (), sentence, None)
