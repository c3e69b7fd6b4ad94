"""How gently the friction of the whole arm turns over: the width v of tanh(q̇/v), which eq. (1) has as sign(q̇).

Dry friction changes its sign over a small velocity, on a real arm and in most simulators. Where that is wide enough to
show, sign(q̇) misfits at every reversal of every joint and biases Coulomb friction. One width for all joints that turn
and one for all that slide, and only where most of them ask for it: what one joint alone asks for is an effect of that
joint, which the diagnosis names. A common delay of the torque blunts friction as well, so the width must gain beside
one. With periods the noise is known, and a width is judged by its likelihood; without, by rows that were not fitted, as
rotor inertias and offsets are. There no joint may get worse: what is left holds more than noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.base_parameters import BaseRegressor, Widths, direction_of, told_widths, widths_of
from identification.fitting.blocks import Block, shortest_solution
from identification.fitting.drives import CLEAR, FOLDS, REQUIRED_GAIN, fold_products, folds_of, held_out_squares
from identification.robots import RobotModel

GRID = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1, 2e-1)
"""Widths that are tried, rad/s (m/s): narrower ones lie within what standstills leave out."""
RESOLUTION = 0.01
"""Share of a width to which the likeliest is sought."""
NEEDED = 14.0
"""Log-likelihood that the joints must gain together without the one that gains most: what an effect of one must."""
NEEDED_OF_A_JOINT = 2.0
"""Log-likelihood that at least half of the joints must gain each: a chance of 1 in 20 in noise alone."""
_TOLERANCE = 1e-10

Gain = Callable[[FloatArray], FloatArray]
"""What each joint gains (n,) by widths (n,) against sign(q̇)."""


@dataclass(frozen=True, slots=True)
class FrictionWidth:
    """velocity: rad/s (m/s), the likeliest. gain: against sign(q̇), (n,) by joint: log-likelihood, or without known
    noise the logarithm of the ratio of held-out squares. clear: whether most joints ask for it; otherwise sign(q̇)
    stands.
    """

    velocity: Widths
    gain: FloatArray
    clear: bool


def width_sentence(velocity: Widths, robot: RobotModel) -> str:
    """What the reader is told of a width, rad/s (m/s)."""
    return (
        f"The friction of the whole arm turns over between about {told_widths(velocity, robot)}, as tanh(q̇/v): "
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
    sharp = profile.squares(np.zeros(regressor.robot.n))

    def gain(widths: FloatArray) -> FloatArray:
        return np.asarray(0.5 * (sharp - profile.squares(widths)))

    velocity, gained = _likeliest(gain, regressor)
    asking = np.count_nonzero(gained > NEEDED_OF_A_JOINT)
    clear = bool(2 * asking >= len(profile.joints) and gained.sum() - gained.max() >= NEEDED)
    return FrictionWidth(velocity, gained, clear)


def held_out_friction_width(
    blocks: Sequence[Block], delay_columns: Sequence[FloatArray], velocity_noise: FloatArray, regressor: BaseRegressor
) -> FrictionWidth:
    """The width that predicts best what was not fitted, and whether most joints are predicted better and none worse.

    blocks, delay_columns: as of `friction_width`, for rows whose noise is not known. velocity_noise: (n,) rad/s (m/s),
    standard deviation of each joint's: it turns the sign of a slow velocity, which blunts friction on average too, so
    a width has to be clear of it.
    """
    profile = _HeldOut(blocks, delay_columns, regressor)
    sharp = profile.squares(np.zeros(regressor.robot.n))

    def gain(widths: FloatArray) -> FloatArray:
        return np.asarray(np.log(sharp / profile.squares(widths)))

    velocity, gained = _likeliest(gain, regressor)
    asking = np.count_nonzero(gained > REQUIRED_GAIN)
    others = gained.sum() - gained.max()
    clear = 2 * asking >= len(profile.joints) and others > REQUIRED_GAIN * (len(profile.joints) - 1)
    widths = np.broadcast_to(velocity, regressor.robot.n)
    blunter = bool(np.all((widths == 0.0) | (widths > CLEAR * velocity_noise)))
    return FrictionWidth(velocity, gained, bool(clear and blunter and gained.min() >= -REQUIRED_GAIN))


def _likeliest(gain: Gain, regressor: BaseRegressor) -> tuple[Widths, FloatArray]:
    """The widths with the largest gain, one for the joints that turn and one for those that slide, and that gain."""
    revolute = np.asarray(regressor.robot.kinematics.revolute, dtype=np.bool_)
    widths = np.zeros(regressor.robot.n)
    for kind in (revolute, ~revolute):
        if kind.any() and _coulomb_columns(regressor):
            widths = _likeliest_of(kind, widths, gain)
    return widths_of(widths), gain(widths)


def _likeliest_of(kind: BoolArray, widths: FloatArray, gain: Gain) -> FloatArray:
    """The widths (n,) with that of one kind of joints at its likeliest; unchanged where none gains.

    Nor at the largest that is tried: what turns over no sooner is a law of the velocity, not a width.
    """
    from scipy.optimize import minimize_scalar  # not loaded by who reads the fit of another process

    def loss(log_width: float) -> float:
        return -float(gain(np.where(kind, np.exp(log_width), widths)).sum())

    logs = np.log(GRID)
    best = int(np.argmin([loss(each) for each in logs]))
    bounds = logs[max(best - 1, 0)], logs[min(best + 1, len(GRID) - 1)]
    found = minimize_scalar(loss, bounds=bounds, options={"xatol": RESOLUTION})
    is_one = -found.fun > gain(widths).sum() and found.x < logs[-1] - 2.0 * RESOLUTION
    return np.where(kind, np.exp(found.x), widths) if is_one else widths


def _coulomb_columns(regressor: BaseRegressor) -> dict[int, int]:
    """Column of each joint's (from 0) Coulomb friction."""
    return {
        joint: regressor.names.index(name)
        for joint in range(regressor.robot.n)
        if (name := f"FS_{joint + 1}") in regressor.names
    }


def _turning(blocks: Sequence[Block], widths: FloatArray) -> list[FloatArray]:
    """(R, n) of each block, what Coulomb friction is proportional to with these widths, projected."""
    every = widths_of(widths)
    return [block.signals.project(direction_of(block.signals.velocity, every)) for block in blocks]


class _HeldOut:
    """Squares of the rows of each fold under the fit of the others, as a function of the widths."""

    def __init__(self, blocks: Sequence[Block], delay_columns: Sequence[FloatArray], regressor: BaseRegressor) -> None:
        self._blocks = [
            replace(block, columns=np.concatenate([block.columns, delay[:, :, None]], axis=2))
            for block, delay in zip(blocks, delay_columns, strict=True)
        ]
        self._places = _coulomb_columns(regressor)
        self.joints = list(self._places)
        self._folds = folds_of(self._blocks)
        self._products = fold_products(self._blocks)
        self._columns: IntArray = np.arange(regressor.size + 1)

    def squares(self, widths: FloatArray) -> FloatArray:
        """(n,) sums of squares; 1 for a joint without torque."""
        products = [fold.copy() for fold in self._products]
        for joint, place in self._places.items():
            for fold in products:
                fold[joint, place] = fold[joint, :, place] = 0.0
        for block, turning, fold_of_row in zip(self._blocks, _turning(self._blocks, widths), self._folds, strict=True):
            for joint, place in self._places.items():
                rows = np.column_stack([block.columns[:, joint], block.torque[:, joint]])
                rows[:, place] = turning[:, joint]
                for number in range(FOLDS + 1):
                    own = rows[block.fitted[:, joint] & (fold_of_row == number)]
                    crossed = own[:, place] @ own
                    products[number][joint, place] += crossed
                    products[number][joint, :, place] += crossed
                    products[number][joint, place, place] -= crossed[place]
        squares = held_out_squares(products, self._columns)
        return np.where(np.isnan(squares), 1.0, squares)


class _Profile:
    """Squares of the weighted residual as a function of the widths, base parameters and a common delay fitted along.

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
        self.joints = list(_coulomb_columns(regressor))
        kept = np.setdiff1d(np.arange(regressor.size), list(_coulomb_columns(regressor).values()))
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

    def squares(self, widths: FloatArray) -> FloatArray:
        """(n,) squares of each joint's weighted residual with these widths; 0: sign(q̇)."""
        products = self._products.copy()
        turning = _turning(self._blocks, widths)
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
