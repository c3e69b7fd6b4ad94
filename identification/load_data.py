"""The load on the flange that the robot's own model does not know of, read from its external torque.

The cabinet subtracts a model of the arm with the load data it was given; what is left it calls external torque. A load
that is heavier than those data pulls through every motion in a pattern no push has: the regressor of a body on the last
link. Pure; who reads the recording and who says it is the daemon's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.regressor import link_columns
from identification.robots.model import RobotModel

LEAST_MASS_KG = 0.1
"""A cabinet's load data are given to a tenth of a kilogram."""
LEAST_SHARE = 0.5
"""A load is said where it is more than half of what friction and offsets leave of the external torque."""
BLOCKS = 20
_SMOOTH_RAD_S = 0.02
_FEWEST_SAMPLES = 200


@dataclass(frozen=True, slots=True, eq=False)
class UnknownLoad:
    """mass: kg, negative where the cabinet believes in more than there is. center: (3,) m in the last link's frame.

    share: of the sum of squares that friction and offsets leave, on rows that were not fitted. rms_before, rms_after:
    Nm (n,) without and with the load, friction and offsets fitted in both.
    """

    mass: float
    center: FloatArray
    share: float
    rms_before: FloatArray
    rms_after: FloatArray


def unknown_load(
    robot: RobotModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, external: FloatArray
) -> UnknownLoad | None:
    """The load in external torque (S, n) Nm, positive where something pushes the joint; None where there is none.

    q, dq, ddq: (S, n) rad, rad/s, rad/s². Own friction, of which a cabinet's model may know nothing, and an offset of
    each joint are fitted beside the load, so that they cannot pass for one. Every other of BLOCKS blocks of rows is
    foretold from the rest, and the other way round: a load is there if both say so, at least LEAST_MASS_KG of the same
    sign and LEAST_SHARE of what is left.
    """
    samples, n = external.shape
    if samples < _FEWEST_SAMPLES:
        return None
    # Mass and first moments alone: they weigh. A load's own inertia adds little, and poor motions do not show it.
    load = -link_columns(robot, q, dq, ddq, n - 1, range(4))
    own = np.zeros((samples, n, 3 * n))
    for joint in range(n):
        own[:, joint, 3 * joint : 3 * joint + 3] = np.stack(
            [np.ones(samples), dq[:, joint], np.tanh(dq[:, joint] / _SMOOTH_RAD_S)], axis=1
        )
    both = np.concatenate([load, own], axis=2)
    # In turns: a rest or a stretch of another kind is then in both halves.
    first = np.arange(samples) * BLOCKS // samples % 2 == 0
    shares, masses = [], []
    for fitted in (first, ~first):
        without, _ = _left(own, external, fitted)
        with_load, found = _left(both, external, fitted)
        before, after = float((without[~fitted] ** 2).sum()), float((with_load[~fitted] ** 2).sum())
        shares.append(1.0 - after / before if before > 0.0 else 0.0)
        masses.append(float(found[0]))
    heavy = min(map(abs, masses)) >= LEAST_MASS_KG and masses[0] * masses[1] > 0.0
    if not heavy or min(shares) < LEAST_SHARE:
        return None
    everything = np.ones(samples, dtype=bool)
    without, _ = _left(own, external, everything)
    with_load, found = _left(both, external, everything)
    rms = [np.sqrt((left**2).mean(axis=0)) for left in (without, with_load)]
    return UnknownLoad(float(found[0]), found[1:4] / found[0], min(shares), rms[0], rms[1])


def _left(columns: FloatArray, external: FloatArray, fitted: BoolArray) -> tuple[FloatArray, FloatArray]:
    """What least squares on the rows `fitted` leave on all rows, (S, n), and the parameters."""
    width = columns.shape[2]
    found, *_ = np.linalg.lstsq(columns[fitted].reshape(-1, width), external[fitted].ravel(), rcond=None)
    return np.asarray(external - columns @ found), np.asarray(found, dtype=np.float64)


def weight_at_rest(
    robot: RobotModel, q: FloatArray, external: FloatArray, reach_m: float
) -> tuple[float, float, float]:
    """What the external torque of one posture at rest, (n,) Nm at (n,) rad, weighs as a point on the last link's z.

    reach_m: how far out, m from the last link's origin. Returns its mass in kg, its share of the sum of squares of
    `external`, and the torque that one kilogram there has, Nm over all joints. One posture tells no more than a weight:
    nothing keeps it apart from friction that the standing joints hold, or from a hand on the arm.
    """
    still = np.zeros((1, robot.n))
    kilogram, meter = -link_columns(robot, q[None], still, still, robot.n - 1, (0, 3))[0].T
    kilogram = kilogram + reach_m * meter
    size = float(kilogram @ kilogram)
    mass = float(kilogram @ external) / size if size > 0.0 else 0.0
    left = external - mass * kilogram
    whole = float(external @ external)
    return mass, 1.0 - float(left @ left) / whole if whole > 0.0 else 0.0, float(np.sqrt(size))
