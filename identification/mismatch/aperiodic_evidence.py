"""Evidence of a recording without periods: stretches cut into blocks of time, each block taken to cosine lines.

Blocks let rows be held out by time and weights differ between blocks that move and blocks that stand still; cosine
lines (the orthonormal DCT) let rows have frequencies without asking that a block joins its own end. Nothing repeats
here, so nothing tells noise from misfit: what stands in for the noise is the level above the compared band, and a
tenth of what a plain fit leaves where that is more. It serves as a weight, and `noise_is_measured` is False.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise

import numpy as np
from scipy.fft import dct, idct

from identification.arrays import BoolArray, FloatArray, runs_of
from identification.base_parameters import BaseRegressor, Widths, direction_of
from identification.errors import RecordingError
from identification.fitting.band import band_of_motion
from identification.fitting.settings import Split
from identification.mismatch.evidence import Evidence, fit_parameters, with_nominal, with_parameters
from identification.mismatch.motion import Motion
from identification.mismatch.problem import BAND_EDGES_HZ
from identification.mismatch.settings import MOST, ROWS_TELL, DiagnosisSettings
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.signals.alike import notes_on_alike
from identification.signals.aperiodic import (
    EDGE_PERIODS,
    ROWS_PER_CUTOFF_PERIOD,
    cutoff_of,
    low_pass_and_thin,
    process_aperiodic,
    zero_phase_low_pass,
)
from identification.signals.processed import ProcessedSignals

SAMPLES_PER_CUTOFF_PERIOD = 12.5
"""Of the thinned motion: enough for signs of velocity, which pass the low-pass after they are taken."""
ROW_STRIDE = 5
"""Every so many samples of the thinned motion a row: 2.5 per period of the cutoff frequency."""
BLOCKS_PER_RECORDING = 15
HELD_OUT_EVERY = 3
LONGEST_BLOCK_S = 2.0
FEWEST_ROWS = 8
GUARD_PERIODS = 1.0
"""Of the cutoff frequency: what is trimmed of a held-out block, half at each end."""
WEIGHT_SHARE = 0.1
SMALLEST_WEIGHT = 1e-6
ROUNDS = 3
MOST_ENERGY = 2.0
"""Of what weights by joint alone leave on a joint, that weights by joint and band may leave."""
NOISE_FREEDOM = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Rows first … last (exclusive) of a stretch, as many cosine lines as lie in the compared band.

    operator: (lines, samples) from the samples of the motion, the one at `start` first, to the lines: low-pass,
    thinning and DCT as one matrix, since it is applied to thousands of columns.
    """

    first: int
    last: int
    lines: int
    start: int
    operator: FloatArray


def low_pass_of(recording: Recording, settings: DiagnosisSettings) -> float:
    """Cutoff in Hz: the one asked for, that of the fit, or what the motion alone asks for."""
    if settings.low_pass_hz is not None:
        return cutoff_of(settings.low_pass_hz, recording.sampling_period_s)
    return band_of_motion(recording)


def default_split(recordings: Sequence[Recording], settings: DiagnosisSettings) -> Split:
    """Every third of fifteen blocks of time held out, for recordings of which none is; fewer blocks of a short one.

    Raises RecordingError for a recording too short for three blocks.
    """
    shortest = min(recordings, key=lambda recording: recording.duration_s)
    cutoff = low_pass_of(shortest, settings)
    block = (FEWEST_ROWS / ROWS_PER_CUTOFF_PERIOD + GUARD_PERIODS + EDGE_PERIODS) / cutoff
    blocks = min(BLOCKS_PER_RECORDING, int(shortest.duration_s / block))
    if blocks < HELD_OUT_EVERY:
        raise RecordingError.named(
            shortest.source.path,
            f"{shortest.duration_s:.2g} s are too short to hold each third block of "
            f"time out at a low-pass of {cutoff:.3g} Hz, which takes {HELD_OUT_EVERY * block:.2g} s; record longer, or "
            "give another recording with --heldout" + "".join(f"; {note}" for note in notes_on_alike(shortest)),
            field="t",
        )
    return Split("blocks", (shortest.duration_s / blocks, float(HELD_OUT_EVERY), HELD_OUT_EVERY - 1.0))


def thinned_stretches(
    recording: Recording, settings: DiagnosisSettings, coulomb_velocity: Widths
) -> list[ProcessedSignals]:
    """The stretches of the aperiodic pipeline on a coarser time grid, low-pass and row grid as there.

    Effects are evaluated on a few thousand samples whatever the rate; `project` works on the coarse grid, which the
    measured torque, and the direction of motion, reach through a low-pass far above the one of the rows.
    coulomb_velocity: of the direction (`direction_of`), rad/s. Raises RecordingError as
    `process_aperiodic`.
    """
    cutoff = low_pass_of(recording, settings)
    return [_thinned(signals, cutoff, coulomb_velocity) for signals in process_aperiodic(recording, cutoff)]


def build_aperiodic_evidence(
    recording: Recording,
    robot: RobotModel,
    regressor: BaseRegressor,
    settings: DiagnosisSettings,
    split: Split | None = None,
    *,
    held_out: bool = False,
) -> tuple[Evidence, ...]:
    """One evidence per gap-free stretch; of its rows those that the split fits, or those it holds out.

    Raises RecordingError where no stretch has a block that is long enough and in which a joint moves.
    """
    found = []
    for signals in thinned_stretches(recording, settings, regressor.options.coulomb_velocity):
        blocks = _blocks(recording, signals, split, held_out)
        if _used(signals, blocks).any():
            found.append(_evidence(recording, signals, blocks, robot, regressor))
    if not found:
        raise RecordingError.at(
            recording.source.path,
            f"no block of time in which a joint moves is left to {'check' if held_out else 'fit'}; "
            "choose longer blocks or another recording",
        )
    return tuple(found)


def _thinned(signals: ProcessedSignals, cutoff_hz: float, coulomb_velocity: Widths) -> ProcessedSignals:
    step = float(signals.time[1] - signals.time[0])
    stride = max(1, int(1.0 / step / (SAMPLES_PER_CUTOFF_PERIOD * cutoff_hz)))
    torque, direction = signals.torque, direction_of(signals.velocity, coulomb_velocity)
    if stride > 1:
        torque, direction = (zero_phase_low_pass(part, step, 0.4 / (stride * step)) for part in (torque, direction))
    coarse = stride * step
    time = signals.time[::stride]
    edge = round(EDGE_PERIODS / cutoff_hz / coarse)
    kept = slice(edge, time.size - edge, min(ROW_STRIDE, max(1, int(1.0 / coarse / (2.5 * cutoff_hz)))))
    project = partial(low_pass_and_thin, step=coarse, cutoff_hz=cutoff_hz, kept=kept)
    row_time = time[kept]
    assert signals.row_time is not None
    nearest = np.clip(np.searchsorted(signals.row_time, row_time), 0, signals.row_time.size - 1)
    used = signals.used[nearest]
    return replace(
        signals,
        time=time,
        position=signals.position[::stride],
        velocity=signals.velocity[::stride],
        acceleration=signals.acceleration[::stride],
        torque=torque[::stride],
        project=project,
        used=used,
        row_time=row_time,
        evaluate=project,
        evaluated=used,
        evaluation_time=row_time,
        facts={
            **signals.facts,
            "noise_density": _noise_density(signals.torque, step, cutoff_hz),
            "direction": direction[::stride],
        },
    )


def _noise_density(torque: FloatArray, step: float, cutoff_hz: float) -> FloatArray:
    """(n,) Nm² s, power per Hz (both sides) of the torque in the quietest octave above twice the cutoff."""
    window = np.hanning(len(torque))[:, None]
    power = np.abs(np.fft.rfft((torque - torque.mean(axis=0)) * window, axis=0)) ** 2
    power *= step / float(np.sum(window**2))
    frequency = np.fft.rfftfreq(len(torque), step)
    levels = []
    low = 2.0 * cutoff_hz
    while low < 0.45 / step:
        inside = (frequency >= low) & (frequency < min(2.0 * low, 0.48 / step))
        if inside.sum() > 10:
            levels.append(np.median(power[inside], axis=0) / np.log(2.0))
        low *= 2.0
    return np.asarray(np.min(levels, axis=0) if levels else np.zeros(torque.shape[1]), dtype=np.float64)


def _blocks(recording: Recording, signals: ProcessedSignals, split: Split | None, held_out: bool) -> tuple[Block, ...]:
    """Runs of rows of one role, cut to blocks of about equal length."""
    time = signals.row_time
    assert time is not None
    cutoff = float(signals.facts["low_pass_hz"])
    chosen = np.ones(time.size, dtype=np.bool_)
    if split is not None:
        start, duration = float(recording.time[0]), recording.duration_s
        chosen = split.held_out(time, start, duration)
        if held_out:
            # The low-pass carries fitted rows that far into held-out ones.
            chosen &= split.boundary_distance(time, start, duration) >= 0.5 / cutoff
        else:
            chosen = ~chosen
    step = float(time[1] - time[0])
    stride = round(step / float(signals.time[1] - signals.time[0]))
    operator_of = lru_cache(partial(_operator, signals, stride))
    blocks = []
    for first, last in runs_of(chosen).tolist():
        parts = max(1, round((last - first) * step / LONGEST_BLOCK_S))
        cuts = np.linspace(first, last, parts + 1).astype(int).tolist()
        for low, high in pairwise(cuts):
            if high - low >= FEWEST_ROWS:
                operator = operator_of(high - low)
                blocks.append(Block(low, high, len(operator), low * stride, operator))
    return tuple(blocks)


def _used(signals: ProcessedSignals, blocks: Sequence[Block]) -> BoolArray:
    """(blocks, n) where a joint moves: one that stands still most of a block says nothing on that joint there."""
    shares = [signals.used[block.first : block.last].mean(axis=0) for block in blocks]
    return np.array(shares) > MOST


def _operator(signals: ProcessedSignals, stride: int, count: int) -> FloatArray:
    """`Block.operator` of so many rows, `stride` samples apart: the same for all blocks of that length."""
    assert signals.row_time is not None
    cutoff = float(signals.facts["low_pass_hz"])
    step = float(signals.time[1] - signals.time[0])
    edge = round(float(signals.row_time[0] - signals.time[0]) / step)
    samples = 2 * edge + (count - 1) * stride + 1
    filtered = zero_phase_low_pass(np.eye(samples), step, cutoff)[edge : edge + (count - 1) * stride + 1 : stride]
    lines = min(count, int(2.0 * count * stride * step * cutoff) + 1)
    return np.ascontiguousarray(dct(filtered, axis=0, norm="ortho")[:lines])


def _evidence(
    recording: Recording,
    signals: ProcessedSignals,
    blocks: Sequence[Block],
    robot: RobotModel,
    regressor: BaseRegressor,
) -> Evidence:
    time = signals.row_time
    assert time is not None
    step = float(time[1] - time[0])
    project = partial(_to_cosine_lines, blocks=tuple(blocks))
    longest = max(block.last - block.first for block in blocks)
    # Blocks differ by a row or two: their lines are put on one grid of frequencies.
    grid = 0.5 / (longest * step)
    frequency = np.concatenate(
        [np.round(np.arange(block.lines) * 0.5 / ((block.last - block.first) * step) / grid) * grid for block in blocks]
    )
    used = np.repeat(_used(signals, blocks), [block.lines for block in blocks], axis=0)
    motion = Motion(
        robot=robot,
        time=signals.time - signals.time[0],
        position=signals.position,
        velocity=signals.velocity,
        acceleration=signals.acceleration,
        torque=np.zeros_like(signals.position),
        full_parameters=np.zeros(len(regressor.full_names)),
        periodic=False,
        start_s=np.array([float(signals.time[0] - recording.time[0])]),
        coulomb_velocity=regressor.options.coulomb_velocity,
        thinned_direction=signals.facts["direction"],
        compared_hz=float(signals.facts["low_pass_hz"]),
    )
    density = np.asarray(signals.facts["noise_density"])
    cutoff = float(signals.facts["low_pass_hz"])
    response = 1.0 / (1.0 + (frequency / cutoff) ** 8)
    torque = project(signals.torque)
    scale = np.sqrt(np.mean(torque**2, axis=0))
    white = np.maximum(np.sqrt(density / step)[None] * response[:, None], ROWS_TELL * scale)
    offset = signals.time - signals.time[0]
    evidence = Evidence(
        recording=recording,
        motion=motion,
        project=project,
        frequency=frequency,
        torque=torque,
        period_torque=None,
        nominal=np.zeros(0),
        noise=white + 1e-12,
        noise_freedom=np.full(torque.shape, NOISE_FREEDOM),
        used=used,
        noise_is_measured=False,
        restore=partial(_to_time, blocks=tuple(blocks), row_time=time - signals.time[0], time=offset),
        counted=sum(block.last - block.first for block in blocks),
        white_noise=white,
    )
    return _with_weights(with_nominal(evidence, regressor), regressor)


def _to_cosine_lines(values: FloatArray, *, blocks: tuple[Block, ...]) -> FloatArray:
    """(S, …) on the coarse grid → (R, …): orthonormal cosine lines of each block of low-passed rows."""
    flat = np.ascontiguousarray(values.reshape(len(values), -1))
    rows = [block.operator @ flat[block.start : block.start + block.operator.shape[1]] for block in blocks]
    return np.asarray(np.concatenate(rows).reshape(-1, *values.shape[1:]), dtype=np.float64)


def _to_time(rows: FloatArray, *, blocks: tuple[Block, ...], row_time: FloatArray, time: FloatArray) -> FloatArray:
    """(R, …) cosine lines → (S, …) on the motion's grid, interpolated; nan outside the blocks."""
    flat = rows.reshape(len(rows), -1)
    result = np.full((time.size, flat.shape[1]), np.nan)
    position = 0
    for block in blocks:
        padded = np.zeros((block.last - block.first, flat.shape[1]))
        padded[: block.lines] = flat[position : position + block.lines]
        position += block.lines
        series = idct(padded, axis=0, norm="ortho")
        own = row_time[block.first : block.last]
        inside = (time >= own[0]) & (time <= own[-1])
        for column in range(flat.shape[1]):
            result[inside, column] = np.interp(time[inside], own, series[:, column])
    return result.reshape(time.size, *rows.shape[1:])


def weighted_by(evidence: Evidence, left: FloatArray) -> Evidence:
    """The evidence with a tenth of what a model leaves (R, n), per joint and band, for noise; never less than white.

    A tenth: what a weight says is the ratio between joints and bands; as noise it would call any residual explained.
    Per joint alone where the evidence has no noise by band.
    """
    band = np.searchsorted(BAND_EDGES_HZ, evidence.frequency, side="left") * evidence.noise_by_band
    size = np.sqrt(np.mean(evidence.torque**2, axis=0))
    level = np.empty_like(evidence.torque)
    for number in np.unique(band):
        inside = band == number
        counted = np.maximum(evidence.used[inside].sum(axis=0), 1)
        level[inside] = np.sqrt((np.where(evidence.used[inside], left[inside], 0.0) ** 2).sum(axis=0) / counted)
    white = np.zeros_like(level) if evidence.white_noise is None else evidence.white_noise
    return replace(evidence, noise=np.maximum(white, WEIGHT_SHARE * level + SMALLEST_WEIGHT * size + 1e-12))


def weighted_by_joint(evidences: Sequence[Evidence], level: FloatArray) -> tuple[Evidence, ...]:
    """Evidences weighted as `fit` weighs rows without periods: each joint by what is left of it, bands alike.

    level: (n,) Nm, deviation of what is left of each joint.
    """
    torque = np.concatenate([item.torque for item in evidences])
    noise = WEIGHT_SHARE * level + SMALLEST_WEIGHT * np.sqrt(np.mean(torque**2, axis=0)) + 1e-12
    return tuple(replace(item, noise=np.tile(noise, (len(item.torque), 1))) for item in evidences)


def _with_weights(evidence: Evidence, regressor: BaseRegressor) -> Evidence:
    """The evidence weighted by what the plain fit leaves, in three rounds, and its nominal torque.

    By joint and band, unless that more than doubles the energy that weights by joint alone leave on some joint: there
    the bands that the model misfits count least and are misfitted the more, and what is left is the weights' own doing.
    """
    size = np.sqrt(np.mean(evidence.torque**2, axis=0))
    evidence = replace(evidence, noise=np.tile(np.maximum(size, 1e-12), (len(evidence.torque), 1)))
    start = fit_parameters([evidence])
    alike, by_band = (_in_rounds(replace(evidence, noise_by_band=chosen), start) for chosen in (False, True))
    energy = [((item.torque - item.nominal @ values) ** 2 * item.used).sum(axis=0) for item, values in (alike, by_band)]
    chosen, values = alike if np.any(energy[1] > MOST_ENERGY * energy[0]) else by_band
    return with_parameters(chosen, regressor, values)


def _in_rounds(evidence: Evidence, values: FloatArray) -> tuple[Evidence, FloatArray]:
    """The evidence weighted in rounds, from base parameters (p,), and those that fit it then."""
    for _ in range(ROUNDS):
        evidence = weighted_by(evidence, evidence.torque - evidence.nominal @ values)
        values = fit_parameters([evidence])
    return evidence, values
