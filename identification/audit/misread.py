"""Data read otherwise than they are: degrees for radians, another clock, torques in the order of other joints.

No column is small enough for the first and the last: they are tried as a whole, and taken only where next to nothing of
the misfit stays. The clock needs no model where a velocity was recorded. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.audit.columns import Geometry, SetUp
from identification.audit.comparison import LEAST_SIGMAS
from identification.audit.difference import Difference, Number, with_interval
from identification.audit.given import GivenModel
from identification.recordings.clock import SMALLEST_CLOCK_ERROR, clock_by_velocity
from identification.recordings.recording import Recording

FILTERED = 0.005
"""By which the filter of a recorded velocity makes it smaller or larger."""
STAYS = 0.12
"""Of the misfit of the joints that take part, what may stay for a misreading to be believed."""
WIDEST_RAD = 4.0 * np.pi
"""No joint of an arm turns that far; in degrees nearly every motion does."""


def misread(
    effect: str, joints: tuple[int, ...], explained: float, text: str, numbers: tuple[Number, ...] = ()
) -> Difference:
    """A difference in how the data were read. explained: share of the misfit that goes, nan where that is not known."""
    return Difference(effect, None, None, numbers, explained, float("nan"), "recording", f"{text}.", joints=joints)


def in_degrees(recording: Recording, revolute: BoolArray) -> Recording | None:
    """The recording with its positions taken for degrees, None where they can be radians."""
    span = np.abs(recording.position[:, revolute]).max(initial=0.0)
    if span < WIDEST_RAD:
        return None
    changed = {}
    for name in ("position", "velocity", "command_position", "link_position"):
        values = getattr(recording, name)
        if values is not None:
            changed[name] = np.where(revolute, np.radians(values), values)
    return replace(recording, **changed)


def by_its_velocity(recordings: Sequence[Recording]) -> tuple[list[Recording], Difference] | None:
    """Recordings with the clock that their velocity says, None where it is the stated one or nothing says."""
    found = [clock_by_velocity(recording) for recording in recordings]
    each = [item for item in found if item is not None]
    if not each or len(each) < len(recordings):
        return None
    ratio, std = (float(np.mean(values)) for values in zip(*each, strict=True))
    apart = float(np.std([value for value, _ in each]))
    std = float(np.sqrt(std**2 + apart**2 + (FILTERED * ratio) ** 2))
    if abs(np.log(ratio)) < max(SMALLEST_CLOCK_ERROR, LEAST_SIGMAS * std / ratio):
        return None
    number = Number("ratio", ratio, std, "")
    text = f"The clock is wrong: by the recorded velocity, true rate over stated rate is {with_interval(number)}"
    corrected = [
        replace(recording, time=recording.time / ratio, sampling_period_s=recording.sampling_period_s / ratio)
        for recording in recordings
    ]
    return corrected, misread("wrong_time_base", (), float("nan"), text, (number,))


def least_square(model: GivenModel, expected: FloatArray) -> FloatArray:
    """(n,) Nm², what a model leaves of its own recordings; where it does not say, 1 % of the torque it expects."""
    stated = np.nan_to_num(model.left) ** 2
    return np.asarray(np.where(np.isfinite(model.left), stated, 0.01 * expected.var(axis=0)) + 1e-12)


def misread_order(geometry: Geometry, set_up: SetUp, model: GivenModel) -> tuple[IntArray, Difference] | None:
    """Which recorded torque belongs to each joint, where it is not its own; None where the order holds.

    A cost is what a torque leaves of what the model expects, its mean aside, over what the model leaves anyway; a
    torque turned round counts as its own, so that a wrong sign does not pass for a wrong order.
    """
    rows, n = geometry.rows, geometry.robot.n
    if n < 2:
        return None
    used = rows.used.all(axis=1)
    expected = (geometry.columns(set_up.gravity) @ model.values)[used]
    expected, measured = expected - expected.mean(axis=0), (rows.torque[used] - rows.torque[used].mean(axis=0))
    floor = least_square(model, expected)
    square = ((measured[:, None, :] - expected[:, :, None]) ** 2).mean(axis=0)
    turned = ((measured + expected) ** 2).mean(axis=0)
    cost = square / floor[:, None]
    own = np.diag(cost).copy()
    upright = np.minimum(own, turned / floor)
    from scipy.optimize import linear_sum_assignment  # slow to load, and a plain fit does without

    _, order = linear_sum_assignment(cost)
    every = np.arange(n)
    # A joint takes part in a change of order only where its own torque is clearly not what is expected of it.
    total = float(cost[every, order].sum())
    for joint in range(n):
        other = int(np.flatnonzero(order == joint)[0])
        swapped = order.copy()
        swapped[[joint, other]] = swapped[[other, joint]]
        if float(cost[every, swapped].sum()) < total + 0.1 * n:
            order, total = swapped, float(cost[every, swapped].sum())
    part = order != every
    stays = float(cost[every, order][part].sum())
    if not part.any() or stays > STAYS * float(own[part].sum()) or stays > 0.5 * float(upright[part].sum()):
        return None
    joints = tuple(int(joint) + 1 for joint in np.flatnonzero(part))
    text = "The torques are in the order of other joints: " + ", ".join(
        f"that of joint {joint} stands under joint {int(order[joint - 1]) + 1}" for joint in joints
    )
    return order.astype(np.int64), misread("wrong_joint_order", joints, 1.0 - total / float(own.sum()), text)
