"""Data read otherwise than they are: degrees for radians, another clock, torques in the order of other joints.

No column is small enough for the first and the last: they are tried as a whole, and taken only where next to nothing of
the misfit stays. The clock needs no model where a velocity was recorded, nor does an order that is clear. Pure.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.arrays import FloatArray, IntArray, evenly
from identification.audit.columns import Geometry, SetUp
from identification.audit.comparison import LEAST_SIGMAS
from identification.audit.difference import Difference, Number, with_interval
from identification.audit.given import GivenModel, sizes_of, wide_open
from identification.audit.reading import with_clock
from identification.audit.rows import Rows
from identification.recordings.clock import SMALLEST_CLOCK_ERROR, clock_by_velocity
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel

FILTERED = 0.005
"""By which the filter of a recorded velocity makes it smaller or larger."""
STAYS = 0.12
"""Of the misfit of the joints that take part, what may stay for a misreading to be believed."""
NOT_ITS_OWN, ITS_OWN, CHEAPER = 0.5, 0.2, 0.3
"""Of a torque's square: what stays of one at least under the joint where it stands, and of each at most under the one
it goes with; and how much less stays in all. The columns of a joint near the base take much of any torque.
"""
DECISIVE, LEAST_LEFT = 0.01, 0.1
"""As the last, where it is enough by itself, and of how much in all: an arm of few joints takes much of any torque."""
ORDER_ROWS, ORDER_NOISE = 600, 0.1


def misread(
    effect: str, joints: tuple[int, ...], explained: float, text: str, numbers: tuple[Number, ...] = ()
) -> Difference:
    """A difference in how the data were read. explained: share of the misfit that goes, nan where that is not known."""
    return Difference(effect, None, None, numbers, explained, float("nan"), "recording", f"{text}.", joints=joints)


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
    corrected = [with_clock(recording, ratio) for recording in recordings]
    return corrected, misread("wrong_time_base", (), float("nan"), text, (number,))


def least_square(model: GivenModel, expected: FloatArray) -> FloatArray:
    """(n,) Nm², what a model leaves of its own recordings; where it does not say, 1 % of the torque it expects."""
    stated = np.nan_to_num(model.left) ** 2
    return np.asarray(np.where(np.isfinite(model.left), stated, 0.01 * expected.var(axis=0)) + 1e-12)


def _drive(rows: Rows, joint: int, *, friction: bool) -> FloatArray:
    """(R, k) what a torque under a joint (from 0) is compared beside: a constant, and friction that nobody knows."""
    constant = np.ones(len(rows.block))
    if not friction:
        return constant[:, None]
    return np.column_stack([constant, rows.velocity[:, joint], rows.direction[:, joint]])


def beside_friction(rows: Rows, values: FloatArray) -> FloatArray:
    """(R, n) torque less what friction and offset of each joint take of it on the rows where all are used."""
    used, result = rows.used.all(axis=1), values.copy()
    for joint in range(values.shape[1]):
        result[used, joint] = _beside(_drive(rows, joint, friction=True)[used], values[used, joint])
    return result


def _beside(columns: FloatArray, values: FloatArray) -> FloatArray:
    """Values (R,) or (R, m) less what columns (R, k) take of them."""
    return np.asarray(values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0])


def misread_order(geometry: Geometry, set_up: SetUp, model: GivenModel) -> tuple[IntArray, Difference] | None:
    """Which recorded torque belongs to each joint, where it is not its own; None where the order holds.

    A cost is what a torque leaves of what the model expects, its mean aside (and the friction, of which a drawn model
    says nothing), over what the model leaves anyway; a torque turned round counts as its own, so that a wrong sign does
    not pass for a wrong order.
    """
    rows, n = geometry.rows, geometry.robot.n
    if n < 2:
        return None
    used = rows.used.all(axis=1)
    expected = (geometry.columns(set_up.gravity) @ model.values)[used]
    own = [_drive(rows, joint, friction=not model.own)[used] for joint in range(n)]
    # Row j: what is left of every torque, and of what the model expects of joint j, under that joint.
    measured = np.stack([_beside(columns, rows.torque[used]) for columns in own], axis=1)
    expected = np.stack([_beside(columns, expected[:, joint]) for joint, columns in enumerate(own)], axis=1)
    floor = least_square(model, expected)
    square = ((measured - expected[:, :, None]) ** 2).mean(axis=0)
    turned = ((np.diagonal(measured, axis1=1, axis2=2) + expected) ** 2).mean(axis=0)
    cost = square / floor[:, None]
    own_cost = np.diag(cost).copy()
    upright = np.minimum(own_cost, turned / floor)
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
    if not part.any() or stays > STAYS * float(own_cost[part].sum()) or stays > 0.5 * float(upright[part].sum()):
        return None
    return order.astype(np.int64), of_order(order, 1.0 - total / float(own_cost.sum()))


def order_by_itself(
    rows: Rows, robot: RobotModel, gravity: FloatArray, *, only_decisive: bool = False
) -> IntArray | None:
    """Which joint's motion each torque goes with, without a model: the columns of every joint are fitted to every
    torque. As `misread_order`.

    A cost is the share of a torque that a joint's columns leave on blocks that were not fitted. only_decisive: by the
    stricter of the two bounds.
    """
    n, sizes = robot.n, sizes_of(robot, rows)
    chosen = evenly(len(rows.block), ORDER_ROWS)
    columns = Geometry(robot, rows).columns(gravity)[chosen]
    fitted = rows.block[chosen] % 2 == 0
    torque = (rows.torque / sizes.torque)[chosen]
    cost = np.zeros((n, n))
    width = wide_open(sizes)
    for joint in range(n):
        own = columns[:, joint] / sizes.torque[joint] * width
        gram = own[fitted].T @ own[fitted] + ORDER_NOISE**2 * np.eye(len(width))
        left = torque[~fitted] - own[~fitted] @ np.linalg.solve(gram, own[fitted].T @ torque[fitted])
        cost[joint] = (left**2).mean(axis=0) / np.maximum(torque[~fitted].var(axis=0), 1e-12)
    from scipy.optimize import linear_sum_assignment  # slow to load, and a plain fit does without

    _, order = linear_sum_assignment(cost)
    moved = [joint for joint in range(n) if order[joint] != joint]
    here, there = cost[moved, moved], cost[moved, order[moved]]
    clear = (here.sum() >= LEAST_LEFT and there.sum() <= DECISIVE * here.sum()) or (
        bool(moved)
        and not only_decisive
        and here.max() >= NOT_ITS_OWN
        and there.max() <= ITS_OWN
        and there.sum() <= CHEAPER * here.sum()
    )
    return np.asarray(order, dtype=np.int64) if moved and clear else None


def of_order(order: IntArray, explained: float) -> Difference:
    """What is said of an order: the torque of joint order[j] belongs to joint j."""
    joints = tuple(int(joint) + 1 for joint in np.flatnonzero(order != np.arange(len(order))))
    text = "The torques are in the order of other joints: " + ", ".join(
        f"that of joint {joint} stands under joint {int(order[joint - 1]) + 1}" for joint in joints
    )
    return misread("wrong_joint_order", joints, explained, text)
