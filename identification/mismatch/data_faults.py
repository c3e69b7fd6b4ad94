"""Faults of the data that no physics explains: looked for before any effect is. Called by the diagnosis.

What the import found in single rows is passed on, not searched again. A clipped torque shows as a plateau at its own
extreme. Signs and time base are questions to the rigid body itself: the joints share inertial parameters, so one
joint's sign cannot be turned unnoticed, and gravity does not know the clock while inertia torque goes with its square.
Both are claimed only where they also show beside free physics of every joint: a fault must explain what that cannot.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar
from scipy.signal import savgol_filter

from identification.base_parameters import BaseRegressor
from identification.errors import RecordingError
from identification.fitting.torque_sign import judge_torque_sign
from identification.mismatch.findings import DataFault
from identification.mismatch.rival_physics import beside, rival_physics
from identification.recordings.recording import Finding, Recording
from identification.robots import RobotModel
from identification.signals.aperiodic import process_aperiodic
from identification.signals.periodic import process_periodic
from identification.signals.processed import ProcessedSignals

FloatArray = npt.NDArray[np.float64]
Rivals = Callable[[], tuple[FloatArray, ...]]

ROW_FAULTS = {
    "gap": "lost_samples",
    "repeated_rows": "lost_samples",
    "garbled_rows": "garbled_rows",
    "time_backwards": "garbled_rows",
}
"""Kinds of the import's findings. A repeated row stands for a sample that did not come."""
PLATEAU_SAMPLES = 10
PLATEAU_RUN = 3
PLATEAU_OVER_NEIGHBOUR = 5.0
SIGN_SQUARES = 2.0
"""By how many times one joint's squared residual the sum over the joints must fall when signs are turned."""
TIME_BASE_COST_RATIO = 1.3
SMALLEST_TIME_ERROR = 0.03
TIME_ERROR_SIGMAS = 5.0
WIDEST_RATIO = 30.0
MOST_STATES = 1200
SMOOTHED_S = 0.1
_CUTOFF = 1e-9


def find_data_faults(recording: Recording, robot: RobotModel, regressor: BaseRegressor) -> tuple[DataFault, ...]:
    """Every fault found in one recording, none for a sound one.

    regressor: of the nominal model, with rotor inertia and offset where the torque needs them. A recording that is too
    short for the fit is judged by its rows only.
    """
    del robot
    faults = [
        _row_fault(recording, finding)
        for finding in recording.report.findings
        if finding.kind in ROW_FAULTS and not (finding.kind == "gap" and _gaps_are_dropped_rows(recording))
    ]
    faults += _saturation(recording)
    try:
        stretches = [process_periodic(recording)] if recording.is_periodic else process_aperiodic(recording)
    except RecordingError:
        return tuple(faults)
    stretch, rivals = _thinned(max(stretches, key=lambda signals: signals.time.size))
    signs = _signs(stretch, regressor)
    if np.any(signs < 0.0):
        signs = np.where(_signs(stretch, regressor, rivals()) < 0.0, signs, 1.0)
    faults += _inverted(recording, signs)
    time_base = _time_base(recording, stretch, regressor, signs, rivals)
    return tuple(faults if time_base is None else [*faults, time_base])


def _row_fault(recording: Recording, finding: Finding) -> DataFault:
    fault = ROW_FAULTS[finding.kind]
    name = Path(recording.source.path).name
    after = " What was recorded beside the gaps is used as it is." if fault == "lost_samples" else ""
    joints = tuple(range(1, recording.n + 1)) if finding.joint is None else (finding.joint,)
    rows = (finding.first_row, finding.last_row, finding.count)
    return DataFault(fault, joints, f"{name}: {finding.sentence}.{after}", rows=rows)


def _gaps_are_dropped_rows(recording: Recording) -> bool:
    """Whether the holes in the time stamps are no more than the rows that the import itself left out."""
    missing = np.round(np.diff(recording.time) / recording.sampling_period_s - 1.0)
    return bool(missing[missing > 0.0].sum() <= recording.report.rows_read - recording.report.rows_kept)


def _saturation(recording: Recording) -> list[DataFault]:
    """Joints whose torque stays at its largest or smallest value while the robot moves."""
    faults = []
    moving = np.concatenate([[True], (np.diff(recording.position, axis=0) != 0.0).any(axis=1)])
    for joint in range(recording.n):
        torque = recording.torque[:, joint]
        rows: list[int] = []
        sides = []
        for extreme in (torque.max(), torque.min()):
            at = (torque == extreme) & moving
            edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]]).astype(np.int8)))
            longest = int((edges[1::2] - edges[::2]).max()) if edges.size else 0
            if at.sum() < PLATEAU_SAMPLES or longest < PLATEAU_RUN:
                continue
            values, counts = np.unique(torque, return_counts=True)
            beside = np.argsort(np.abs(values - extreme))[1:4]
            neighbour = int(counts[beside].max()) if beside.size else 0
            if at.sum() > PLATEAU_OVER_NEIGHBOUR * neighbour and values.size > 10:
                rows.extend(np.flatnonzero(at).tolist())
                sides.append(float(extreme))
        if rows:
            limits = " and ".join(f"{side:+.4g}" for side in sides)
            faults.append(
                DataFault(
                    "saturated_sensor",
                    (joint + 1,),
                    f"Joint {joint + 1}: the torque is cut off at {limits} {recording.torque_unit} in {len(rows)} "
                    f"samples between rows {min(rows) + 1} and {max(rows) + 1}; leave them out or record with less "
                    "load.",
                    rows=(min(rows) + 1, max(rows) + 1, len(rows)),
                )
            )
    return faults


def _thinned(stretch: ProcessedSignals) -> tuple[ProcessedSignals, Rivals]:
    """At most MOST_STATES samples of a stretch, spread evenly over those that count, torque smoothed over 0.1 s.

    With them, on demand, the free functions of each joint that a fault must beat.
    """
    step = float(stretch.time[1] - stretch.time[0])
    width = min(max(5, 2 * round(0.5 * SMOOTHED_S / step) + 1), (stretch.time.size - 1) // 2 * 2 - 1)
    counts = np.ones(stretch.time.size, dtype=np.bool_)
    if stretch.row_time is not None:
        place = np.minimum(np.searchsorted(stretch.row_time, stretch.time), stretch.row_time.size - 1)
        inside = (stretch.time >= stretch.row_time[0]) & (stretch.time <= stretch.row_time[-1])
        counts = inside & stretch.used[place].all(axis=1)
    index = np.flatnonzero(counts if counts.sum() > 100 else np.ones_like(counts))
    index = index[np.linspace(0, index.size - 1, min(MOST_STATES, index.size)).astype(int)]
    thinned = replace(
        stretch,
        time=stretch.time[index],
        position=stretch.position[index],
        velocity=stretch.velocity[index],
        acceleration=stretch.acceleration[index],
        torque=savgol_filter(stretch.torque, width, 3, axis=0)[index],
    )

    def rivals() -> tuple[FloatArray, ...]:
        rate = savgol_filter(stretch.torque, width, 3, deriv=1, delta=step, axis=0)[index]
        return rival_physics(thinned.position, thinned.velocity, thinned.torque, rate)

    return thinned, rivals


def _columns(stretch: ProcessedSignals, regressor: BaseRegressor, velocity: float, acceleration: float) -> FloatArray:
    """(S, n, p) with velocity and acceleration times those factors."""
    return regressor.matrix(stretch.position, velocity * stretch.velocity, acceleration * stretch.acceleration)


def _by_joint(columns: FloatArray, rivals: Sequence[FloatArray]) -> FloatArray:
    """(S, n, p) → (n, S, p), so that weights of joints can be changed after the products over the samples are made.

    rivals: per joint what is fitted along and taken off, or nothing.
    """
    if not rivals:
        return np.ascontiguousarray(columns.transpose(1, 0, 2))
    return np.stack([beside(basis, columns[:, joint]) for joint, basis in enumerate(rivals)])


def _torque_beside(torque: FloatArray, rivals: Sequence[FloatArray]) -> FloatArray:
    """(S, n) without what the free functions of each joint take of it."""
    return _by_joint(torque[:, :, None], rivals)[..., 0].T if rivals else torque


def _transposed(columns: FloatArray) -> FloatArray:
    return columns.transpose(0, 2, 1)


def _solve(gram: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shortest least squares from normal equations, and the pseudo-inverse."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    kept = values > _CUTOFF * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T / np.outer(scale, scale)
    return np.asarray(inverse @ right), np.asarray(inverse)


def _signs(stretch: ProcessedSignals, regressor: BaseRegressor, rivals: Sequence[FloatArray] = ()) -> FloatArray:
    """(n,) the signs, ±1, with which the measured torques fit one rigid body whose inertia and friction are positive.

    The squares of the residual are a quadratic form in the signs, so every pattern can be tried. Signs that cost
    little are left as they are.
    """
    by_joint = _by_joint(_columns(stretch, regressor, 1.0, 1.0), rivals)
    columns, torque = by_joint.transpose(1, 0, 2), _torque_beside(stretch.torque, rivals)
    n = stretch.n
    weight = 1.0 / np.maximum(torque.std(axis=0), 1e-12)
    patterns = np.array([(1.0, *rest) for rest in product((1.0, -1.0), repeat=n - 1)])
    order = np.argsort((patterns < 0.0).sum(axis=1), kind="stable")
    patterns = patterns[order]
    best = patterns[0]
    grams = _transposed(by_joint) @ by_joint
    seen = (_transposed(by_joint) @ torque.T[..., None])[..., 0]
    for _ in range(3):
        parts = weight[:, None] ** 2 * seen
        gram = np.tensordot(weight**2, grams, 1)
        _, inverse = _solve(gram, parts.sum(axis=0))
        form = np.diag((weight**2) * (torque**2).sum(axis=0)) - parts @ inverse @ parts.T
        cost = np.einsum("si,ij,sj->s", patterns, form, patterns)
        floor = 1e-12 * float(np.trace(form)) + 1e-300
        cheaper = int(np.argmin(cost))
        margin = SIGN_SQUARES * max(float(cost[cheaper]), floor) / n
        best = patterns[cheaper] if cost[0] > cost[cheaper] + margin else patterns[0]
        values = inverse @ (best @ parts)
        residual = best * torque - columns @ values
        weight = 1.0 / np.maximum(residual.std(axis=0), 1e-6 * torque.std(axis=0) + 1e-12)
    for joint in np.flatnonzero(best < 0.0):  # one that costs next to nothing says nothing
        other = best.copy()
        other[joint] = 1.0
        if other @ form @ other < best @ form @ best + margin:
            best = other
    states = (stretch.position, stretch.velocity, stretch.torque * best)
    # Residuals of neighbouring rows are alike: their number overstates what is known, by ten at least.
    judged = judge_torque_sign(regressor, values, 10.0 * inverse, *states)
    telling = np.abs(judged.inertia_significance) > 3.0
    negative = int((judged.inertia_significance[telling] < 0.0).sum())
    return np.asarray(-best if negative > 0.5 * max(1, telling.sum()) else best, dtype=np.float64)


def _inverted(recording: Recording, signs: FloatArray) -> list[DataFault]:
    joints = tuple(int(joint) + 1 for joint in np.flatnonzero(signs < 0.0))
    if not joints:
        return []
    every = len(joints) == recording.n
    which = "every joint" if every else "joint " + ", ".join(str(joint) for joint in joints)
    return [
        DataFault(
            "inverted_torque_sign",
            joints,
            f"The torque of {which} has the wrong sign: turned, the recording fits one rigid body with positive "
            "inertia.",
        )
    ]


def _time_base(
    recording: Recording, stretch: ProcessedSignals, regressor: BaseRegressor, signs: FloatArray, rivals: Rivals
) -> DataFault | None:
    """True rate over stated rate, from the recorded velocity or from inertia against gravity."""
    ratio, std, cost_ratio = _ratio_from_torque(stretch, regressor, signs)
    source = "the inertia torque against gravity"
    claimed = _is_wrong(ratio, std, cost_ratio)
    if claimed:
        other = _ratio_from_torque(stretch, regressor, signs, rivals())
        claimed = _is_wrong(*other) and (other[0] > 1.0) == (ratio > 1.0)
    measured = _ratio_from_velocity(recording)
    if measured is not None and abs(np.log(measured[0])) > SMALLEST_TIME_ERROR:
        ratio, std = measured
        source = "the recorded velocity against the change of position"
        claimed = abs(ratio - 1.0) >= max(SMALLEST_TIME_ERROR, TIME_ERROR_SIGMAS * std)
    if not claimed:
        return None
    stated = 1.0 / recording.sampling_period_s
    sentence = (
        f"The time base is wrong: {source} says that samples were taken at {stated * ratio:.4g} Hz, not at the stated "
        f"{stated:.4g} Hz (ratio {ratio:.4g} ± {std:.2g})."
    )
    return DataFault("wrong_time_base", tuple(range(1, recording.n + 1)), sentence, ratio=ratio)


def _is_wrong(ratio: float, std: float, cost_ratio: float) -> bool:
    """Whether the misfit falls enough with another clock, and that clock is another."""
    return cost_ratio > TIME_BASE_COST_RATIO and abs(ratio - 1.0) >= max(SMALLEST_TIME_ERROR, TIME_ERROR_SIGMAS * std)


def _ratio_from_velocity(recording: Recording) -> tuple[float, float] | None:
    """Slope of the recorded velocity over the difference of positions; None where they do not go together."""
    if recording.velocity is None or not np.isfinite(recording.velocity).all():
        return None
    step = np.diff(recording.time)
    even = step < 1.5 * recording.sampling_period_s
    width = max(1, round(0.02 / recording.sampling_period_s))
    index = np.flatnonzero(np.convolve(even, np.ones(2 * width), "valid") == 2 * width)
    if index.size < 10 * width:
        return None
    duration = (recording.time[index + 2 * width] - recording.time[index])[:, None]
    difference = (recording.position[index + 2 * width] - recording.position[index]) / duration
    total = np.concatenate([np.zeros((1, recording.n)), np.cumsum(recording.velocity, axis=0)])
    velocity = (total[index + 2 * width] - total[index]) / (2 * width)
    slopes = (difference * velocity).sum(axis=0) / np.maximum((difference**2).sum(axis=0), 1e-300)
    moving = difference.std(axis=0) > 0.1 * difference.std(axis=0).max()
    alike = (difference * velocity).sum(axis=0) ** 2 > 0.98 * (difference**2).sum(axis=0) * (velocity**2).sum(axis=0)
    chosen = slopes[moving & alike & (slopes > 0.0)]
    if chosen.size < max(1, 0.5 * moving.sum()):
        return None
    ratio = float(np.median(chosen))
    spread = 1.4826 * float(np.median(np.abs(chosen - ratio))) if chosen.size > 1 else 0.01 * ratio
    if not 1.0 / WIDEST_RATIO < ratio < WIDEST_RATIO or spread > 0.05 * ratio:
        return None
    return ratio, max(spread / np.sqrt(chosen.size), 1e-4)


def _ratio_from_torque(
    stretch: ProcessedSignals, regressor: BaseRegressor, signs: FloatArray, rivals: Sequence[FloatArray] = ()
) -> tuple[float, float, float]:
    """Ratio, its standard deviation, and by what factor the residual's squares fall against a ratio of one.

    Y(q, r q̇, r² q̈) = Y(q, 0, 0) + r V + r² D with V viscous friction and D inertia; the product of rows is then a
    polynomial in r whose coefficients are made once.
    """
    gravity = _columns(stretch, regressor, 0.0, 0.0)
    whole = _columns(stretch, regressor, 1.0, 1.0)
    turned = _columns(stretch, regressor, -1.0, 1.0)
    # Odd in the velocity is friction. Coulomb friction stays as it is: sign(r q̇) = sign(q̇).
    odd, even = 0.5 * (whole - turned), 0.5 * (whole + turned) - gravity
    sizes = np.array([name.startswith("FV_") for name in regressor.names])
    constant, linear = gravity + np.where(sizes, 0.0, odd), np.where(sizes, odd, 0.0)
    torque = _torque_beside(stretch.torque * signs, rivals)
    weight = np.ones(stretch.n)
    blocks = [_by_joint(block, rivals) for block in (constant, linear, even)]
    products = {(a, b): _transposed(blocks[a]) @ blocks[b] for a in range(3) for b in range(a, 3)}
    seen = [(_transposed(block) @ torque.T[..., None])[..., 0] for block in blocks]
    for _ in range(3):
        grams = {pair: np.tensordot(weight**2, product, 1) for pair, product in products.items()}
        rights = [weight**2 @ part for part in seen]
        squares = float(((torque * weight) ** 2).sum())

        def at(
            log_ratio: float,
            grams: dict[tuple[int, int], FloatArray] = grams,
            rights: list[FloatArray] = rights,
            squares: float = squares,
        ) -> tuple[float, FloatArray]:
            r = np.exp(log_ratio)
            gram = sum(
                (r ** (a + b) * (value if a == b else value + value.T) for (a, b), value in grams.items()),
                start=np.zeros_like(grams[0, 0]),
            )
            right = rights[0] + r * rights[1] + r**2 * rights[2]
            values, _ = _solve(gram, right)
            return max(squares - float(values @ right), 1e-12 * squares), values

        grid = np.linspace(-np.log(WIDEST_RATIO), np.log(WIDEST_RATIO), 69)
        costs = [at(float(x))[0] for x in grid]
        best = int(np.clip(np.argmin(costs), 1, len(grid) - 2))
        found = minimize_scalar(
            lambda x, at=at: at(float(x))[0], bounds=(grid[best - 1], grid[best + 1]), method="bounded"
        )
        x = float(found.x)
        _, values = at(x)
        r = np.exp(x)
        residual = torque - ((blocks[0] + r * blocks[1] + r**2 * blocks[2]) @ values).T
        weight = 1.0 / np.maximum(residual.std(axis=0), 1e-6 * torque.std(axis=0) + 1e-12)
    # Curvature of the cost of the last weights; ten rows of a coloured residual count as one.
    step = 0.02
    middle = at(x)[0]
    curvature = (at(x + step)[0] + at(x - step)[0] - 2.0 * middle) / step**2
    std = float(np.sqrt(2.0 * middle / max(1.0, 0.1 * torque.size) / curvature)) if curvature > 0.0 else float("inf")
    return float(np.exp(x)), float(np.exp(x)) * std, at(0.0)[0] / middle
