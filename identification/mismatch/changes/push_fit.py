"""Force, point, window and profile of one push on one link, fitted together, and the rows that any push is compared on.

Rows are those of one period or of the mean: a `Ground`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import least_squares

from identification.arrays import FloatArray, IntArray
from identification.mismatch.effects.base import Place
from identification.mismatch.effects.external_contact import profile, reach_of, unit_forces
from identification.mismatch.motion import Motion

WINDOW = ("start_s", "duration_s", "sharpness", "skew")
POINT = ("point_x_m", "point_y_m", "point_z_m")
SHORTEST_S = 0.03
LONGEST_SHARE = 0.4
"""Longest contact, as a share of the period."""
SHOWN = 0.03
"""Share of the best shown direction of the force that each well shown one has, in squares."""
BENT_BY = 1.0
"""Deviation of the logarithm by which a profile may be bent, before data."""
UNBENT_BY = 0.1
MOST_STEPS = 40
SLOPE = 1e-4


class Ground(Protocol):
    """Rows in which a push is looked for, whitened and without all that is fitted beside it."""

    @property
    def motion(self) -> Motion:
        """The motion of one period."""

    def course(self, factor_of: Callable[[FloatArray], FloatArray], near: IntArray | None = None) -> FloatArray:
        """(P, S) of a function of the time (S,) of the recording, in each period that is looked at.

        near: samples of the period at which it is asked, all without.
        """

    def rows(self, values: FloatArray, joints: Sequence[int]) -> FloatArray:
        """(P, S, J, m) torque on some joints → (rows, m)."""

    def target(self, joints: Sequence[int]) -> FloatArray:
        """(rows,) what is to be explained; the same rows."""

    def free(self, factors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Normal equations, (n, n) and (n,), of a torque of its own on each joint under one course (P, S)."""


@dataclass(frozen=True, slots=True, eq=False)
class Push:
    """A push at its best. joints: from 0, that it reaches. gain: drop of the whitened squares.

    force: (3,) N with covariance (3, 3), which knows that point, window, and link are estimated too. shape_std: σ of
    point and window. tangent: (P, S, J, m) torque per unit of each parameter.
    """

    place: Place
    shape: Mapping[str, float]
    joints: tuple[int, ...]
    gain: float
    force: FloatArray
    covariance: FloatArray
    shape_std: Mapping[str, float]
    tangent: FloatArray


def fit_push(ground: Ground, link: int, shape: Mapping[str, float]) -> Push:
    """Force, point and window together, and the profile's bends if the shape has them, by Gauss and Newton."""
    sought = _Sought.on(ground, link, shape)
    target = ground.target(sought.upstream)
    known: dict[bytes, FloatArray] = {}

    def rows_at(x: FloatArray) -> FloatArray:
        if x.tobytes() not in known:
            known.clear()
            known[x.tobytes()] = ground.rows(sought.tangent_at(x), sought.upstream)
        return known[x.tobytes()]

    low, high = sought.bounds()
    inside = 1e-6 * np.where(np.isfinite(high - low), high - low, 0.0)
    first = np.clip(sought.vector(), low + inside, high - inside)
    rows = rows_at(first)[:, :3]
    gram, right = rows.T @ rows, rows.T @ target
    usual = size_of_force(gram, right)
    first[:3] = np.linalg.solve(gram + np.eye(3) / usual**2, right)
    centre, known_to = sought.before_data(first, usual)
    size = sought.size

    def residual(x: FloatArray) -> FloatArray:
        return np.concatenate([rows_at(x)[:, size] - target, known_to * (x - centre)])

    def jacobian(x: FloatArray) -> FloatArray:
        return np.concatenate([rows_at(x)[:, :size], np.diag(known_to)])

    result = least_squares(
        residual, first, jac=jacobian, bounds=(low, high), x_scale="jac", max_nfev=MOST_STEPS, ftol=1e-6
    )
    x = np.asarray(result.x, dtype=np.float64)
    slopes, left = rows_at(x)[:, :size], rows_at(x)[:, size] - target
    # What the data leave open lies within its bounds.
    known_to[6:10] = np.maximum(known_to[6:10], np.sqrt(12.0) / (high - low)[6:10])
    covariance = np.asarray(np.linalg.inv(slopes.T @ slopes + np.diag(known_to**2)), dtype=np.float64)
    found = sought.shape_of(x)
    return Push(
        place=Place(link=link),
        shape=found,
        joints=sought.upstream,
        gain=float(target @ target - left @ left),
        force=x[:3].copy(),
        covariance=covariance[:3, :3],
        shape_std=_std_of_shape(covariance, found["duration_s"]),
        tangent=sought.tangent_at(x)[..., :size],
    )


def _std_of_shape(covariance: FloatArray, duration_s: float) -> dict[str, float]:
    """σ of point and window, from the covariance of `_Sought`'s vector."""
    deviation = np.sqrt(np.diag(covariance))
    start = np.array([1.0, -0.5 * duration_s])
    return {
        **{name: float(deviation[3 + i]) for i, name in enumerate(POINT)},
        "start_s": float(np.sqrt(start @ covariance[6:8, 6:8] @ start)),
        "duration_s": float(deviation[7] * duration_s),
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Sought:
    """What is fitted, as one vector x: force (3,) N; point (3,) m; middle of the window, s; logarithms of its duration,
    sharpness and skew; bends.

    shape: where the search begins. upstream: joints from 0 that the push reaches. near: samples of the period in which
    it may act. unit: (near, J, 3, 4) torque of unit forces there. reach: lowest and highest point of the link.
    """

    ground: Ground
    shape: Mapping[str, float]
    upstream: tuple[int, ...]
    near: IntArray
    unit: FloatArray
    reach: tuple[FloatArray, FloatArray]

    @classmethod
    def on(cls, ground: Ground, link: int, shape: Mapping[str, float]) -> _Sought:
        """A push on a link, from 1."""
        start, duration = shape["start_s"], shape["duration_s"]
        wide = course_of(ground, {**shape, "start_s": start - 0.5 * duration, "duration_s": 2.0 * duration})
        near = np.flatnonzero((wide != 0.0).any(axis=0))
        upstream = tuple(ground.motion.robot.kinematics.upstream(link - 1))
        return cls(ground, shape, upstream, near, unit_torque(ground, link, wide)[near], reach_of(ground.motion, link))

    @property
    def bends(self) -> list[str]:
        """Their names in the shape."""
        return [name for name in self.shape if name.startswith("bend_")]

    @property
    def size(self) -> int:
        """Of x."""
        return 10 + len(self.bends)

    def vector(self) -> FloatArray:
        """(size,) where the search begins, without force."""
        shape = self.shape
        return np.array(
            [
                *(0.0, 0.0, 0.0),
                *(shape[name] for name in POINT),
                shape["start_s"] + 0.5 * shape["duration_s"],
                *(np.log(shape[name]) for name in WINDOW[1:]),
                *(shape[name] for name in self.bends),
            ]
        )

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """(size,) each: the point on the link, the window not far from where the search begins."""
        low, high = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        low[3:6], high[3:6] = self.reach
        middle, aside = self.vector()[6], 0.4 * self.shape["duration_s"]
        low[6], high[6] = middle - aside, middle + aside
        low[7:10], high[7:10] = np.log([SHORTEST_S, 0.05, 0.3]), np.log([longest_s(self.ground), 4.0, 3.0])
        return low, high

    def before_data(self, first: FloatArray, usual: float) -> tuple[FloatArray, FloatArray]:
        """(size,) each: what is known before and 1/σ of it: sizes of force and bends, points on the link."""
        lower, upper = self.reach
        centre, known_to = np.zeros(self.size), np.zeros(self.size)
        centre[3:6], known_to[3:6] = 0.5 * (lower + upper), np.sqrt(12.0) / (upper - lower)
        known_to[:3], known_to[10:] = 1.0 / usual, 1.0 / BENT_BY
        if self.bends:
            # The plain profile under the bends is as good as any near it.
            centre[8:10], known_to[8:10] = first[8:10], 1.0 / UNBENT_BY
        return centre, known_to

    def shape_of(self, x: FloatArray) -> dict[str, float]:
        """Point, window and bends of a vector."""
        duration = float(np.exp(x[7]))
        return {
            **self.shape,
            "start_s": float(x[6]) - 0.5 * duration,
            "duration_s": duration,
            "sharpness": float(np.exp(x[8])),
            "skew": float(np.exp(x[9])),
            **{name: float(x[3 + i]) for i, name in enumerate(POINT)},
            **{name: float(x[10 + i]) for i, name in enumerate(self.bends)},
        }

    def tangent_at(self, x: FloatArray) -> FloatArray:
        """(P, S, J, size + 1): torque per unit of each variable, and the torque itself."""
        factors = course_of(self.ground, self.shape_of(x), self.near)
        force, arm = x[:3], np.concatenate([[1.0], x[3:6]])
        by_force = (self.unit.reshape(-1, 4) @ arm).reshape(self.unit.shape[:3])
        by_point = (self.unit.transpose(0, 1, 3, 2) @ force)[..., 1:]
        torque = by_force @ force
        values = np.empty((len(factors), self.near.size, len(self.upstream), self.size + 1))
        values[..., :3] = factors[..., None, None] * by_force
        values[..., 3:6] = factors[..., None, None] * by_point
        for number in range(6, self.size):
            step = np.zeros(self.size)
            step[number] = SLOPE
            above, below = (course_of(self.ground, self.shape_of(x + change), self.near) for change in (step, -step))
            values[..., number] = ((above - below) / (2.0 * SLOPE))[..., None] * torque
        values[..., self.size] = factors[..., None] * torque
        result = np.zeros((len(factors), self.ground.motion.samples, *values.shape[2:]))
        result[:, self.near] = values
        return result


def course_of(ground: Ground, shape: Mapping[str, float], near: IntArray | None = None) -> FloatArray:
    """(P, S) the profile of a shape in each period that is looked at. near: as for `Ground.course`."""
    return ground.course(lambda time: profile(time, shape["start_s"], shape), near)


def longest_s(ground: Ground) -> float:
    """Longest push that is looked for, s."""
    return LONGEST_SHARE * ground.motion.samples * ground.motion.sampling_period_s


def unit_torque(ground: Ground, link: int, factors: FloatArray) -> FloatArray:
    """(S, J, 3, 4) torque of unit forces on a link wherever the push may act, 0 elsewhere."""
    motion = ground.motion
    upstream = list(motion.robot.kinematics.upstream(link - 1))
    values = np.zeros((motion.samples, len(upstream), 3, 4))
    touched = (factors != 0.0).any(axis=0)
    if touched.any():
        values[touched] = unit_forces(motion, motion.position[touched], link)[:, upstream]
    return values


def size_of_force(gram: FloatArray, right: FloatArray) -> float:
    """N, of the force's components that torque shows well. Those that it does not show are taken to be no larger."""
    values, vectors = np.linalg.eigh(gram)
    shown = values > SHOWN * values[-1]
    return max(float(np.linalg.norm(vectors[:, shown].T @ right / values[shown])), 1e-6)
