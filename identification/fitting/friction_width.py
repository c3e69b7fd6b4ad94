"""How gently the friction of the whole arm turns over: the width v of tanh(q̇/v), which eq. (1) has as sign(q̇).

Dry friction changes its sign over a small velocity, on a real arm and in most simulators. Where that is wide enough to
show, sign(q̇) misfits at every reversal of every joint and biases Coulomb friction. One width for all joints, and only
where most of them ask for it: what one joint alone asks for is an effect of that joint, which the diagnosis names. A
common delay of the torque blunts friction as well, so the width must gain beside one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor, direction_of
from identification.fitting.blocks import Block, shortest_solution

GRID = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1, 2e-1)
"""Widths that are tried, rad/s (m/s): narrower ones lie within what standstills leave out."""
STEPS = 10
NEEDED = 14.0
"""Log-likelihood that the joints must gain together without the one that gains most: what an effect of one must."""
NEEDED_OF_A_JOINT = 2.0
"""Log-likelihood that at least half of the joints must gain each: a chance of 1 in 20 in noise alone."""
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
_TOLERANCE = 1e-10


@dataclass(frozen=True, slots=True)
class FrictionWidth:
    """velocity: rad/s (m/s), the likeliest. gain: log-likelihood against sign(q̇), (n,) by joint. clear: whether most
    joints ask for it; otherwise sign(q̇) stands.
    """

    velocity: float
    gain: FloatArray
    clear: bool


def width_sentence(velocity: float) -> str:
    """What the reader is told of a width, rad/s (m/s)."""
    return (
        f"The friction of the whole arm turns over between about ±{1e3 * velocity:.1f} mrad/s (mm/s), as tanh(q̇/v): "
        "sign(q̇) is too sharp for it, and nothing of that is called missing physics"
    )


def friction_width(
    blocks: Sequence[Block], delay_columns: Sequence[FloatArray], weights: FloatArray, regressor: BaseRegressor
) -> FrictionWidth:
    """The width that explains most, and whether most joints gain by it; rows are weighted as in the fit.

    blocks: with the scales of the fit, so that a row's variance is 1 / (scale² weight). delay_columns: (R, n) Nm/s of
    each block, how the torque would change with a common delay. weights: (n,) of the joints.
    """
    profile = _Profile(blocks, delay_columns, weights, regressor)
    sharp = profile.squares(0.0)

    def gain(velocity: float) -> FloatArray:
        return np.asarray(0.5 * (sharp - profile.squares(velocity)))

    if not profile.joints:
        return FrictionWidth(0.0, np.zeros_like(sharp), False)
    best = int(np.argmax([gain(velocity).sum() for velocity in GRID]))
    low, high = np.log(GRID[max(best - 1, 0)]), np.log(GRID[min(best + 1, len(GRID) - 1)])
    for _ in range(STEPS):
        inner, outer = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        better = gain(float(np.exp(inner))).sum() > gain(float(np.exp(outer))).sum()
        low, high = (low, outer) if better else (inner, high)
    velocity = float(np.exp(0.5 * (low + high)))
    gained = gain(velocity)
    asking = np.count_nonzero(gained > NEEDED_OF_A_JOINT)
    clear = bool(2 * asking >= len(profile.joints) and gained.sum() - gained.max() >= NEEDED)
    return FrictionWidth(velocity, gained, clear)


class _Profile:
    """Squares of the weighted residual as a function of the width, base parameters and a common delay fitted along.

    Each joint's Coulomb column is in that joint's rows alone, so it is taken off them, and what is left has a normal
    matrix that is corrected by one rank per joint.
    """

    def __init__(
        self,
        blocks: Sequence[Block],
        delay_columns: Sequence[FloatArray],
        weights: FloatArray,
        regressor: BaseRegressor,
    ) -> None:
        self._blocks = [block for block in blocks if block.fitted.any()]
        names = regressor.names
        self.joints = [joint for joint in range(regressor.robot.n) if f"FS_{joint + 1}" in names]
        kept = [index for index, name in enumerate(names) if not name.startswith("FS_")]
        self._rows: list[list[FloatArray]] = []
        self._factors: list[FloatArray] = []
        size = len(kept) + 2
        self._products = np.zeros((regressor.robot.n, size, size))
        for block, delay in zip(self._blocks, delay_columns, strict=True):
            factor = block.fitted * block.scale * np.sqrt(weights)
            self._factors.append(factor)
            of_block = []
            for joint in range(regressor.robot.n):
                columns = np.column_stack([block.columns[:, joint, kept], delay[:, joint], block.torque[:, joint]])
                rows = columns * factor[:, joint, None]
                self._products[joint] += rows.T @ rows
                of_block.append(rows)
            self._rows.append(of_block)

    def squares(self, velocity: float) -> FloatArray:
        """(n,) squares of each joint's weighted residual with this width; 0: sign(q̇)."""
        products = self._products.copy()
        turning = [block.signals.project(direction_of(block.signals.velocity, velocity)) for block in self._blocks]
        for joint in self.joints:
            shared, own = np.zeros(products.shape[1]), 0.0
            for turned, factors, rows in zip(turning, self._factors, self._rows, strict=True):
                column = turned[:, joint] * factors[:, joint]
                shared += column @ rows[joint]
                own += float(column @ column)
            if own > 0.0:
                products[joint] -= np.outer(shared, shared) / own
        total = products.sum(axis=0)
        direction = np.append(shortest_solution(total[:-1, :-1], total[:-1, -1], _TOLERANCE), -1.0)
        return np.asarray(np.einsum("i,nij,j->n", direction, products, direction))
