"""A torque sensor that became another one in the middle of a recording: its sign, its scale or its offset.

One rigid body is fitted to all rows, once as they stand and once with the torque of one joint another from some moment
on: a multiple of what it was, or more than it was. Taken only where next to nothing of that joint's misfit stays, as
other misreadings are. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.audit.columns import Geometry
from identification.audit.comparison import LEAST_GAIN
from identification.audit.given import sizes_of, wide_open
from identification.audit.held_out import STAYS
from identification.audit.rows import REPEATED, Rows, rows_of
from identification.errors import RecordingError
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel

MOMENTS = 16
"""Parts of equal length, at whose bounds a torque may become another one."""
FIRST_MOMENTS = (4, 8, 12)
FORMS = (("scale", -1.0), ("scale", 0.3), ("offset", 0.0))
"""With the value that its search begins from: no way leads from one sign to the other."""
ROUNDS = 6


@dataclass(frozen=True, slots=True)
class ChangedTorque:
    """joint: from 1. since_s, within_s: when, by the recording's time, and to what accuracy. form: "scale", the value
    times what the torque was before, or "offset", so many Nm (N) more. gain: nats against one law throughout.
    """

    joint: int
    since_s: float
    within_s: float
    form: str
    value: float
    gain: float

    @property
    def sentence(self) -> str:
        """What an operator reads."""
        if self.form == "offset":
            what = f"is {self.value:+.3g} Nm from what it was before"
        elif self.value < 0.0:
            what = f"has the other sign, {self.value:.2g} times what it was before"
        else:
            what = f"is {self.value:.2g} times what it was before"
        return f"From t = {self.since_s:.3g} ± {self.within_s:.2g} s on the torque of joint {self.joint} {what}"


def sentence_of_changes(changed: Sequence[ChangedTorque]) -> str:
    """What changes within a recording, in words. Several torques that change together are no sensor's fault."""
    if len(changed) == 1:
        return f"{changed[0].sentence}, which no one arm explains: leave one of the parts out"
    joints = ", ".join(str(joint) for joint in sorted(item.joint for item in changed))
    return (
        f"From t = {changed[0].since_s:.3g} ± {changed[0].within_s:.2g} s on the torques of joints {joints} are others "
        "than before: a load was picked up or put down there, or the arm was touched. Leave one of the parts out"
    )


def changed_torques(recording: Recording, robot: RobotModel) -> tuple[ChangedTorque, ...]:
    """The joints whose torque becomes another one within a recording, the clearest first; none of a sound recording.

    Not asked where joints follow others. Of a recording at rest or too short nothing is said.
    """
    if robot.mimics:
        return ()
    try:
        rows = rows_of([recording])
    except RecordingError:
        return ()
    sizes = sizes_of(robot, rows)
    part = rows.block * MOMENTS // (int(rows.block.max()) + 1)
    width = wide_open(sizes)
    columns = Geometry(robot, rows).columns(np.array(robot.gravity)) * width
    sums = _Sums.of(rows, columns, [part == number for number in range(MOMENTS)])
    # Rows are in the order of time, in stretches without a gap: time goes by their number.
    bounds = np.searchsorted(part, np.arange(MOMENTS + 1)) / len(part) * recording.duration_s + recording.time[0]
    found: list[ChangedTorque] = []
    while best := _clearest(sums, [each.joint - 1 for each in found], sizes.first_noise, sizes.least_noise):
        joint, moment, form, value, gain = best
        within = float(bounds[moment + 1] - bounds[moment - 1]) / 2.0
        found.append(ChangedTorque(joint + 1, float(bounds[moment]), within, form, value, gain))
        sums = sums.mended(joint, moment, form, value)
    return tuple(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """Over the rows of each joint (n) from each of M parts on, and of none: gram (n, M + 1, p, p) of the columns, their
    products seen (n, M + 1, p) with the torque, and sums columns (n, M + 1, p), squares, torque, counts (n, M + 1).
    """

    gram: FloatArray
    seen: FloatArray
    columns: FloatArray
    squares: FloatArray
    torque: FloatArray
    counts: FloatArray

    @classmethod
    def of(cls, rows: Rows, columns: FloatArray, parts: Sequence[BoolArray]) -> _Sums:
        """Of columns (R, n, p) in parts (R,), where the joint is used."""
        chosen = [[rows.used[:, joint] & part for part in parts] for joint in range(rows.torque.shape[1])]
        pairs = [[(columns[each, j], rows.torque[each, j]) for each in own] for j, own in enumerate(chosen)]
        return cls(
            *(
                _from_each_on(np.array([[make(y, tau) for y, tau in own] for own in pairs], dtype=np.float64))
                for make in (
                    lambda y, _: y.T @ y,
                    lambda y, tau: y.T @ tau,
                    lambda y, _: y.sum(axis=0),
                    lambda _, tau: tau @ tau,
                    lambda _, tau: tau.sum(),
                    lambda _, tau: tau.size,
                )
            )
        )

    def mended(self, joint: int, moment: int, form: str, value: float) -> _Sums:
        """With the torque of a joint as it was before, from a moment on."""
        scale, offset = (value, 0.0) if form == "scale" else (1.0, value)
        changed = {name: getattr(self, name).copy() for name in ("seen", "squares", "torque")}
        after, before = (joint, slice(moment, None)), (joint, slice(moment))
        counts, columns, torque = self.counts[after], self.columns[after], self.torque[after]
        changed["seen"][after] = (self.seen[after] - offset * columns) / scale
        changed["squares"][after] = (self.squares[after] - 2.0 * offset * torque + offset**2 * counts) / scale**2
        changed["torque"][after] = (torque - offset * counts) / scale
        for name, values in changed.items():
            values[before] += values[joint, moment] - getattr(self, name)[joint, moment]
        return replace(self, **changed)


def _from_each_on(sums: FloatArray) -> FloatArray:
    """(n, M + 1, …) sums over each part and those behind it, of those of the parts (n, M, …)."""
    return np.concatenate([np.cumsum(sums[:, ::-1], axis=1)[:, ::-1], np.zeros_like(sums[:, :1])], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Settled:
    likelihood: float
    squares: FloatArray
    value: float


def _clearest(
    sums: _Sums, known: Sequence[int], first: FloatArray, floor: FloatArray
) -> tuple[int, int, str, float, float] | None:
    """Joint, moment, form, value and gain of the likeliest change that is to be believed, None where none is.

    known: joints that changed already. first, floor: (n,) Nm, what a search begins from, and the least noise.
    """
    stated = _settled(sums, 0, MOMENTS, "scale", 1.0, first, floor)
    joints = [joint for joint in range(len(sums.counts)) if joint not in known]
    tried = [
        (_settled(sums, joint, moment, form, value, first, floor), joint, form)
        for joint in joints for moment in FIRST_MOMENTS for form, value in FORMS
    ]  # fmt: skip
    if not tried:
        return None
    near, joint, form = max(tried, key=lambda item: item[0].likelihood)
    closer = [(_settled(sums, joint, each, form, near.value, first, floor), each) for each in range(1, MOMENTS)]
    best, moment = max(closer, key=lambda item: item[0].likelihood)
    # A torque that is misread throughout is another fault: of that the first part is only short.
    throughout = _settled(sums, joint, 0, "scale", best.value if form == "scale" else 1.0, first, floor)
    gain = best.likelihood - max(stated.likelihood, throughout.likelihood)
    believed = gain > LEAST_GAIN and best.squares[joint] <= STAYS * stated.squares[joint]
    return (joint, moment, form, best.value, gain) if believed else None


def _settled(
    sums: _Sums, joint: int, moment: int, form: str, value: float, first: FloatArray, floor: FloatArray
) -> _Settled:
    """One rigid body with the torque of a joint another from a moment on, by turns with the noise that is left."""
    counts, gram, seen, squares = (each[:, 0] for each in (sums.counts, sums.gram, sums.seen, sums.squares))
    late, at, columns, torque, rows = (
        each[joint, moment] for each in (sums.gram, sums.seen, sums.columns, sums.torque, sums.counts)
    )
    std, left, own = first, squares, np.eye(len(counts))[joint]
    for _ in range(ROUNDS):
        scale, offset = (value, 0.0) if form == "scale" else (1.0, value)
        own_seen = seen + own[:, None] * ((scale - 1.0) * at - offset * columns)
        weight = 1.0 / (REPEATED * std**2)
        own_gram = np.tensordot(weight, gram, 1) + weight[joint] * (scale**2 - 1.0) * late + np.eye(len(at))
        values = np.linalg.solve(own_gram, weight @ own_seen)
        size = float(values @ late @ values)
        if rows > 0.0:
            value = (
                float(values @ at) / max(size, 1e-300) if form == "scale" else float(torque - values @ columns) / rows
            )
            scale, offset = (value, 0.0) if form == "scale" else (1.0, value)
            own_seen = seen + own[:, None] * ((scale - 1.0) * at - offset * columns)
        bent = (gram @ values) @ values + own * (scale**2 - 1.0) * size
        own_squares = squares + own * (offset**2 * rows - 2.0 * offset * torque)
        left = np.maximum(own_squares - 2.0 * own_seen @ values + bent, 0.0)
        std = np.maximum(np.sqrt(left / np.maximum(counts, 1.0)), floor)
    return _Settled(float(-(counts * np.log(std)).sum()) / REPEATED, left, value)
