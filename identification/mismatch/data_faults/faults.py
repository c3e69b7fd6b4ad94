"""Faults of the data that no physics explains: looked for before any effect is.

What the import found in single rows is passed on, not searched again; what stands is found in `recordings.standing`.
Signs (`torque_signs`) and time base are questions to the rigid body itself: gravity does not know the clock
while inertia torque goes with its square. A clock is claimed only where it also shows beside free physics of every
joint: a fault must explain what that cannot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from identification.arrays import FloatArray
from identification.audit.comparison import LEAST_SIGMAS
from identification.base_parameters import BaseRegressor
from identification.fitting.blocks import shortest_solution
from identification.mismatch.data_faults.thinned import (
    ROWS_PER_NUMBER,
    Thinned,
    by_joint_of,
    columns_of,
    thinned_stretch,
    torque_beside,
    transposed,
)
from identification.mismatch.data_faults.torque_signs import signs_of_stretches
from identification.mismatch.findings import DataFault
from identification.mismatch.settings import ROUNDING
from identification.recordings.clock import SMALLEST_CLOCK_ERROR, WIDEST_RATIO, clock_by_velocity
from identification.recordings.independence import is_called, recording_names
from identification.recordings.leaps import HIDDEN_GAPS
from identification.recordings.recording import Finding, Recording
from identification.recordings.standing import STANDING, standing_values
from identification.signals.processed import ProcessedSignals

ROW_FAULTS = {
    "gap": "lost_samples",
    "repeated_rows": "lost_samples",
    "garbled_rows": "garbled_rows",
    HIDDEN_GAPS: "lost_samples",
    "time_backwards": "garbled_rows",
    "wrong_joint_order": "wrong_joint_order",
    "clipped_torque": "saturated_sensor",
    "standing_torque": "lost_samples",
    "stuck_position": "lost_samples",
}
"""Kinds of what is found in rows. A row or a value that is repeated stands for a sample that did not come."""
TIME_BASE_COST_RATIO = 1.3


def find_data_faults(recordings: Sequence[Recording], regressor: BaseRegressor) -> tuple[tuple[DataFault, ...], ...]:
    """Of each of some recordings of one robot every fault found, none of a sound one.

    regressor: of the nominal model, with rotor inertia and offset where the torque needs them. A recording that is too
    short for the fit is judged by its rows only; signs are judged with common base parameters.
    """
    thinned = [thinned_stretch(recording) for recording in recordings]
    signs = signs_of_stretches(thinned, regressor)
    found = []
    for recording, stretch, own, name in zip(recordings, thinned, signs, recording_names(recordings), strict=True):
        standing = standing_values(recording)
        faults = [
            _row_fault(recording, finding, name)
            for finding in (*recording.report.findings, *standing)
            if finding.kind in ROW_FAULTS and not (finding.kind == "gap" and _gaps_are_dropped_rows(recording))
        ]
        faults += _inverted(own, name)
        time_base = None if stretch is None else _time_base(recording, stretch, regressor, own, name)
        if any(finding.kind == "stuck_position" for finding in standing):
            time_base = None  # a motion that was not driven asks for any clock
        faults += [] if time_base is None else [time_base]
        found.append(tuple(replace(fault, recording=name) for fault in faults))
    return tuple(found)


def upright(recording: Recording, faults: Sequence[DataFault]) -> Recording:
    """The recording with the torque of those joints turned whose sign one of its faults says is inverted."""
    inverted = {joint - 1 for fault in faults if fault.fault == "inverted_torque_sign" for joint in fault.joints}
    if not inverted:
        return recording
    sign = np.array([-1.0 if joint in inverted else 1.0 for joint in range(recording.n)])
    return replace(recording, torque=recording.torque * sign)


def all_upright(recordings: Sequence[Recording], faults: Sequence[DataFault]) -> list[Recording]:
    """Recordings as the faults of all of them have each turned."""
    return [upright(item, [fault for fault in faults if is_called(item, fault.recording)]) for item in recordings]


def stops_physics(faults: Sequence[DataFault]) -> bool:
    """Whether a fault makes every name worthless: with a wrong clock all inertial torque is wrong."""
    return any(fault.fault == "wrong_time_base" for fault in faults)


def _row_fault(recording: Recording, finding: Finding, name: str) -> DataFault:
    fault = ROW_FAULTS[finding.kind]
    after = ""
    if finding.kind in ("gap", "repeated_rows"):
        after = " What was recorded beside the gaps is used as it is."
    elif finding.kind in STANDING:
        after = " Leave these rows out, or record anew."
    joints = tuple(range(1, recording.n + 1)) if finding.joint is None else (finding.joint,)
    rows = (finding.first_row, finding.last_row, finding.count)
    return DataFault(fault, joints, f"{name}: {finding.sentence}.{after}", rows=rows)


def _gaps_are_dropped_rows(recording: Recording) -> bool:
    """Whether the holes in the time stamps are no more than the rows that the import itself left out."""
    missing = np.round(np.diff(recording.time) / recording.sampling_period_s - 1.0)
    return bool(missing[missing > 0.0].sum() <= recording.report.rows_read - recording.report.rows_kept)


def _inverted(signs: FloatArray, name: str) -> list[DataFault]:
    joints = tuple(int(joint) + 1 for joint in np.flatnonzero(signs < 0.0))
    if not joints:
        return []
    which, remedy = "joint " + ", ".join(str(joint) for joint in joints), ""
    if len(joints) == signs.size:
        which = "every joint (the vendor's sign, as FRI has it)" if signs.size > 1 else "joint 1"
        remedy = " `iiwa-ident import --flip-torque` turns it."
    return [
        DataFault(
            "inverted_torque_sign",
            joints,
            f"{name}: the torque of {which} has the wrong sign: turned, the recording goes far better with one "
            f"rigid body of positive inertia and friction.{remedy}",
        )
    ]


def _time_base(
    recording: Recording, stretch: Thinned, regressor: BaseRegressor, signs: FloatArray, name: str
) -> DataFault | None:
    """True rate over stated rate, from the recorded velocity or from inertia against gravity; stamps that hide missing
    rows are wrong by no one rate.
    """
    ratio, std, cost_ratio = _ratio_from_torque(stretch.signals, regressor, signs)
    source, hides_rows = "the inertia torque against gravity", bool(recording.report.of_kind(HIDDEN_GAPS))
    claimed = _is_wrong(ratio, std, cost_ratio)
    if claimed:
        other = _ratio_from_torque(stretch.signals, regressor, signs, stretch.rivals)
        claimed = _is_wrong(*other) and (other[0] > 1.0) == (ratio > 1.0)
    measured = clock_by_velocity(recording)
    if measured is not None and abs(np.log(measured[0])) > SMALLEST_CLOCK_ERROR:
        ratio, std = measured
        source, hides_rows = "the recorded velocity against the change of position", False
        claimed = abs(ratio - 1.0) >= max(SMALLEST_CLOCK_ERROR, LEAST_SIGMAS * std)
    if not claimed:
        return None
    every = tuple(range(1, recording.n + 1))
    if hides_rows:
        sentence = (
            f"{name}: the time base is wrong: its stamps hide missing rows, and inertia does not go with gravity by "
            "them. At what rate samples were taken cannot be told."
        )
        return DataFault("wrong_time_base", every, sentence)
    stated = 1.0 / recording.sampling_period_s
    sentence = (
        f"{name}: the time base is wrong: {source} says that samples were taken at {stated * ratio:.4g} Hz, not at the "
        f"stated {stated:.4g} Hz (ratio {ratio:.4g} ± {std:.2g})."
    )
    return DataFault("wrong_time_base", every, sentence, ratio=ratio, ratio_std=std)


def clock_in_doubt(recording: Recording, regressor: BaseRegressor) -> tuple[float, float] | None:
    """True rate over stated rate and its deviation where inertia asks for another clock against gravity, None else.

    Free functions of each joint may do as well: what is beyond them is a fault (`find_data_faults`). Signs are right.
    None too where the stamps hide missing rows, which is said of the rows.
    """
    stretch = thinned_stretch(recording)
    if stretch is None or recording.report.of_kind(HIDDEN_GAPS):
        return None
    ratio, std, cost_ratio = _ratio_from_torque(stretch.signals, regressor, np.ones(recording.n))
    return (ratio, std) if _is_wrong(ratio, std, cost_ratio) else None


def _is_wrong(ratio: float, std: float, cost_ratio: float) -> bool:
    """Whether the misfit falls enough with another clock, and that clock is another."""
    return cost_ratio > TIME_BASE_COST_RATIO and abs(ratio - 1.0) >= max(SMALLEST_CLOCK_ERROR, LEAST_SIGMAS * std)


@dataclass(frozen=True, slots=True, eq=False)
class _ClockCost:
    """Squares that are left when the clock runs by a ratio r, of rows that are a polynomial of second degree in r.

    grams: products (p, p) of the coefficients a ≤ b. rights: (p,) of each with the torque. squares: of the torque.
    """

    grams: dict[tuple[int, int], FloatArray]
    rights: list[FloatArray]
    squares: float

    def at(self, log_ratio: float) -> tuple[float, FloatArray]:
        """Squares that are left, and the parameters (p,) that leave them."""
        r = np.exp(log_ratio)
        gram = sum(
            (r ** (a + b) * (value if a == b else value + value.T) for (a, b), value in self.grams.items()),
            start=np.zeros_like(self.grams[0, 0]),
        )
        right = self.rights[0] + r * self.rights[1] + r**2 * self.rights[2]
        values = shortest_solution(gram, right, ROUNDING)
        return max(self.squares - float(values @ right), 1e-12 * self.squares), values

    def best(self) -> float:
        """Log of the ratio that leaves least."""
        grid = np.linspace(-np.log(WIDEST_RATIO), np.log(WIDEST_RATIO), 69)
        costs = [self.at(float(x))[0] for x in grid]
        best = int(np.clip(np.argmin(costs), 1, len(grid) - 2))
        bounds = (grid[best - 1], grid[best + 1])
        return float(minimize_scalar(lambda x: self.at(float(x))[0], bounds=bounds, method="bounded").x)


def _ratio_from_torque(
    stretch: ProcessedSignals, regressor: BaseRegressor, signs: FloatArray, rivals: Sequence[FloatArray] = ()
) -> tuple[float, float, float]:
    """Ratio, its standard deviation, and by what factor the residual's squares fall against a ratio of one.

    Y(q, r q̇, r² q̈) = Y(q, 0, 0) + r V + r² D with V viscous friction and D inertia; the product of rows is then a
    polynomial in r whose coefficients are made once.
    """
    gravity = columns_of(stretch, regressor, 0.0, 0.0)
    whole = columns_of(stretch, regressor, 1.0, 1.0)
    turned = columns_of(stretch, regressor, -1.0, 1.0)
    # Odd in the velocity is friction. Coulomb friction stays as it is: sign(r q̇) = sign(q̇).
    odd, even = 0.5 * (whole - turned), 0.5 * (whole + turned) - gravity
    sizes = np.array([name.startswith("FV_") for name in regressor.names])
    constant, linear = gravity + np.where(sizes, 0.0, odd), np.where(sizes, odd, 0.0)
    torque = torque_beside(stretch.torque * signs, rivals)
    weight = np.ones(stretch.n)
    blocks = [by_joint_of(block, rivals) for block in (constant, linear, even)]
    products = {(a, b): transposed(blocks[a]) @ blocks[b] for a in range(3) for b in range(a, 3)}
    seen = [(transposed(block) @ torque.T[..., None])[..., 0] for block in blocks]
    for _ in range(3):
        cost = _ClockCost(
            {pair: np.tensordot(weight**2, product, 1) for pair, product in products.items()},
            [weight**2 @ part for part in seen],
            float(((torque * weight) ** 2).sum()),
        )
        x = cost.best()
        _, values = cost.at(x)
        r = np.exp(x)
        residual = torque - ((blocks[0] + r * blocks[1] + r**2 * blocks[2]) @ values).T
        weight = 1.0 / np.maximum(residual.std(axis=0), 1e-6 * torque.std(axis=0) + 1e-12)
    # Curvature of the cost of the last weights.
    step = 0.02
    middle = cost.at(x)[0]
    curvature = (cost.at(x + step)[0] + cost.at(x - step)[0] - 2.0 * middle) / step**2
    std = (
        float(np.sqrt(2.0 * middle / max(1.0, torque.size / ROWS_PER_NUMBER) / curvature))
        if curvature > 0.0
        else float("inf")
    )
    return float(np.exp(x)), float(np.exp(x)) * std, cost.at(0.0)[0] / middle
