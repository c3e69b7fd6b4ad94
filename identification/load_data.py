"""The load on the flange that the robot's own model does not know of, read from its external torque.

The cabinet subtracts a model of the arm with the load data it was given; what is left it calls external torque. A load
that is heavier than those data pulls through every motion in a pattern no push has: the regressor of a body on the last
link. Pure; who reads the recording and who says it is the daemon's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.regressor import link_columns
from identification.robots.model import RobotModel

LEAST_MASS_KG = 0.1
"""A cabinet's load data are given to a tenth of a kilogram: a load of less torque than that is within them."""
LEAST_SHARE = 0.5
"""A load is said where it is more than half of what friction and offsets leave of the external torque."""
BLOCKS = 20
_SMOOTH_RAD_S = 0.02
_FEWEST_SAMPLES = 200


@dataclass(frozen=True, slots=True, eq=False)
class UnknownLoad:
    """What is on the flange beyond the load data: mass, kg, negative where the cabinet believes in more than there is,
    and moment, (3,) kg m, its first moment about the last link's origin in that link's frame.

    covariance: (4, 4) of mass and moment, from what each block of the motion changes in them. weighs: whether both
    halves give at least LEAST_MASS_KG of one sign; else it is the centre that is wrong. share: of the sum of squares
    that friction and offsets leave, on rows that were not fitted. rms_before, rms_after: Nm (n,) without and with the
    load, friction and offsets fitted in both.
    """

    mass: float
    moment: FloatArray
    covariance: FloatArray
    weighs: bool
    share: float
    rms_before: FloatArray
    rms_after: FloatArray

    @property
    def center(self) -> FloatArray:
        """(3,) m in the last link's frame; it means something where the load weighs."""
        return self.moment / self.mass


def unknown_load(
    robot: RobotModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, external: FloatArray
) -> UnknownLoad | None:
    """The load in external torque (S, n) Nm, positive where something pushes the joint; None where there is none.

    q, dq, ddq: (S, n) rad, rad/s, rad/s². Own friction, of which a cabinet's model may know nothing, and an offset of
    each joint are fitted beside the load, so that they cannot pass for one. Every other of BLOCKS blocks of rows is
    foretold from the rest, and the other way round: a load is there if both say so, as much torque as LEAST_MASS_KG at
    the last link's origin has and LEAST_SHARE of what is left. Its first moments count with its mass: those of a load
    with a wrong centre have torque without weight.
    """
    samples, n = external.shape
    if samples < _FEWEST_SAMPLES:
        return None
    body = -link_columns(robot, q, dq, ddq, n - 1, range(10))
    # Mass and first moments alone: they weigh. A load's own inertia adds little, and poor motions do not show it.
    load = body[..., :4]
    own = np.zeros((samples, n, 3 * n))
    for joint in range(n):
        own[:, joint, 3 * joint : 3 * joint + 3] = np.stack(
            [np.ones(samples), dq[:, joint], np.tanh(dq[:, joint] / _SMOOTH_RAD_S)], axis=1
        )
    both = np.concatenate([load, own], axis=2)
    # In turns: a rest or a stretch of another kind is then in both halves.
    block = np.arange(samples) * BLOCKS // samples
    first = block % 2 == 0
    least = LEAST_MASS_KG * float(np.linalg.norm(load[..., 0]))
    shares, masses = [], []
    for fitted in (first, ~first):
        without, _ = _left(own, external, fitted)
        with_load, found = _left(both, external, fitted)
        before, after = float((without[~fitted] ** 2).sum()), float((with_load[~fitted] ** 2).sum())
        shares.append(1.0 - after / before if before > 0.0 else 0.0)
        masses.append(float(found[0]))
        if shares[-1] < LEAST_SHARE or float(np.linalg.norm(load @ found[:4])) < least:
            return None
    everything = np.ones(samples, dtype=bool)
    without, _ = _left(own, external, everything)
    weighs = min(map(abs, masses)) >= LEAST_MASS_KG and masses[0] * masses[1] > 0.0
    # A wrong centre is the difference of two heavy loads, whose inertia would be taken for a moment.
    columns = both if weighs else np.concatenate([body, own], axis=2)
    with_load, found = _left(columns, external, everything)
    rms = [np.sqrt((left**2).mean(axis=0)) for left in (without, with_load)]
    spread = _spread(columns, external, block)[:4, :4]
    return UnknownLoad(float(found[0]), found[1:4], spread, weighs, min(shares), rms[0], rms[1])


def _spread(columns: FloatArray, external: FloatArray, block: IntArray) -> FloatArray:
    """Covariance (P, P) of the parameters by the jackknife over blocks: neighbouring rows are wrong alike."""
    from identification.audit.evidence import between_parts  # here: it loads scipy, which a run moves without

    width = columns.shape[2]
    parts = [(columns[block == each].reshape(-1, width), external[block == each].ravel()) for each in range(BLOCKS)]
    normal = np.array([part.T @ part for part, _ in parts])
    right = np.array([part.T @ known for part, known in parts])
    kept = zip(normal.sum(axis=0) - normal, right.sum(axis=0) - right, strict=True)
    return between_parts(np.array([np.linalg.lstsq(*each, rcond=None)[0] for each in kept]))


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


def moment_at_rest(robot: RobotModel, q: FloatArray, external: FloatArray) -> tuple[float, float]:
    """What a load with any centre explains of the external torque of one posture at rest, (n,) Nm at (n,) rad.

    Returns its torque, Nm over all joints, and the chance (F) that torques without any pattern are explained so well.
    Of a load at rest three numbers show: its weight, and its moment about the two axes across gravity.
    """
    from scipy.special import fdtrc  # here: a run looks at its load without it

    still = np.zeros((1, robot.n))
    columns = -link_columns(robot, q[None], still, still, robot.n - 1, range(4))[0]
    shown = np.linalg.norm(columns, axis=1) > 1e-9 * np.linalg.norm(columns)
    found, _, rank, _ = np.linalg.lstsq(columns[shown], external[shown], rcond=1e-9)
    explained = columns[shown] @ found
    left, free = float(((external[shown] - explained) ** 2).sum()), int(shown.sum()) - int(rank)
    if free < 1 or left <= 0.0:
        return 0.0, 1.0
    torque = float(explained @ explained)
    return float(np.sqrt(torque)), float(fdtrc(rank, free, torque / rank / (left / free)))
