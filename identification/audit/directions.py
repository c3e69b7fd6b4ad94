"""Gravity over the whole sphere, and the clock over a decade: what no tangent reaches is looked for on a grid.

The products of the columns without gravity and per unit of it are made once; any direction is then a product of small
matrices. With a given model the question is how the base stands beside it; without one, how it stands at all. Pure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray, IntArray
from identification.audit.columns import GRAVITY, HEAVY, INERTIAL, PARAMETERS, Geometry, across
from identification.audit.evidence import Products, between_parts, log_evidence, posterior, products_of

POINTS = 80
TANGENT_RAD = 5e-3
FIRST_REACH_RAD, LEAST_REACH_RAD = 0.1, 1e-4
"""Of the points that the next step is drawn from: half of the grid's distance, and what no one measures."""
MOST_STEPS = 100
"""A smooth evidence takes fewer than thirty; one that is not smooth has no top to be found."""
LEAST_GAIN_NATS = 1e-3
"""No odds worth a step; the evidence of many rows is rounded to less."""


def sphere() -> FloatArray:
    """(POINTS, 3) unit vectors spread evenly over the sphere (Fibonacci's spiral)."""
    place = np.arange(POINTS) + 0.5
    height, angle = 1.0 - 2.0 * place / POINTS, np.pi * (1.0 + np.sqrt(5.0)) * place
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Products of the torque (R, n) with the columns that any gravity and clock are made of."""

    products: Products
    n: int

    @classmethod
    def of(cls, geometry: Geometry, torque: FloatArray, parts: int = 1) -> Directions:
        """Of the rows of a geometry, in so many parts: blocks in turns."""
        n, count = geometry.robot.n, len(torque)
        free = geometry.columns(np.zeros(3))
        heavy = np.moveaxis(geometry.heavy, 0, 2).reshape(count, n, -1)
        columns = np.concatenate([free, heavy], axis=2)
        return cls(products_of(columns, torque, geometry.rows.used, geometry.rows.block % parts, parts), n)

    @property
    def parts(self) -> tuple[int, ...]:
        """Of the rows, all."""
        return tuple(range(len(self.products.gram)))

    def turned(
        self, products: tuple[FloatArray, FloatArray], gravity: FloatArray, ratio: float = 1.0
    ) -> tuple[FloatArray, FloatArray]:
        """Gram (14 n, 14 n) and right side (14 n,) of a set-up's columns, from those of the products' columns."""
        gram, right = products
        size = PARAMETERS * self.n
        scale = np.ones((self.n, PARAMETERS))
        scale[:, :INERTIAL] = ratio**2
        scale[:, INERTIAL], scale[:, -1] = ratio, ratio**2
        own, n, heavy = scale.ravel(), self.n, slice(HEAVY)
        # Columns that feel gravity are the free ones plus those per unit of it; all is quadratic in the gravity.
        mixed = own[:, None] * (gravity @ gram[:size, size:].reshape(size, 3, -1))
        weight = gravity @ (gravity @ gram[size:, size:].reshape(3, -1)).reshape(HEAVY * n, 3, -1)
        result, seen = own[:, None] * gram[:size, :size] * own, own * right[:size]
        by_link = result.reshape(n, PARAMETERS, n, PARAMETERS)
        by_link[..., heavy] += mixed.reshape(n, PARAMETERS, n, HEAVY)
        by_link[:, heavy] += mixed.T.reshape(n, HEAVY, n, PARAMETERS)
        by_link[:, heavy, :, heavy] += weight.reshape(n, HEAVY, n, HEAVY)
        seen.reshape(n, PARAMETERS)[:, heavy] += (gravity @ right[size:].reshape(3, -1)).reshape(n, HEAVY)
        return result, seen

    @property
    def _heavy(self) -> IntArray:
        """Which of a set-up's columns feel gravity."""
        return (PARAMETERS * np.arange(self.n)[:, None] + np.arange(HEAVY)).ravel()

    def evidence(
        self, gravity: FloatArray, weight: FloatArray, mean: FloatArray, factor: FloatArray, ratio: float = 1.0
    ) -> float:
        """Log evidence of the torque with parameters N(mean, F Fᵀ) and weights (n,), up to a constant of the torque.

        A vector stands for the diagonal of F, here and below.
        """
        return self._evidence(self.turned(self.products.summed(self.parts, weight), gravity, ratio), mean, factor)

    @staticmethod
    def _evidence(products: tuple[FloatArray, FloatArray], mean: FloatArray, factor: FloatArray) -> float:
        gram, right = products
        square = 2.0 * mean @ right - mean @ gram @ mean
        return float(0.5 * square) + log_evidence(gram, right - gram @ mean, factor)

    def left(self, gravity: FloatArray, weight: FloatArray, width: FloatArray) -> FloatArray:
        """(n,) Nm RMS that free parameters leave, of these standard deviations (14 n,) beforehand."""
        gram, right = self.turned(self.products.summed(self.parts, weight), gravity)
        own = posterior(gram, right, width).values
        values = np.concatenate([own, np.outer(gravity, own[self._heavy]).ravel()])
        squares = self.products.left(self.parts, values, np.arange(len(values)))
        return np.asarray(np.sqrt(squares / np.maximum(self.products.counts(self.parts), 1.0)))

    def best(
        self, weight: FloatArray, mean: FloatArray, factor: FloatArray, size: float = GRAVITY
    ) -> tuple[FloatArray, float]:
        """Gravity (3,) of the best direction, and its log evidence."""
        products = self.products.summed(self.parts, weight)

        def evidence(direction: FloatArray) -> float:
            turned = self.turned(products, size * direction / np.linalg.norm(direction))
            return self._evidence(turned, mean, factor)

        points = sphere()
        values = [evidence(point) for point in points]
        best, found = self._refined(evidence, points[int(np.argmax(values))])
        # Upside down a motion of little inertia looks nearly alike, and the grid is too wide to see which is better.
        if evidence(-best) > found:
            best, found = self._refined(evidence, -best)
        return size * best, found

    @staticmethod
    def _refined(evidence: Callable[[FloatArray], float], start: FloatArray) -> tuple[FloatArray, float]:
        """The likeliest unit vector (3,) near a start, and its log evidence.

        Newton's steps on the sphere, their derivatives from points `reach` away; none is longer than twice the reach,
        which shrinks with them, and grows again while they lead on.
        """
        best, found, reach = start, evidence(start), FIRST_REACH_RAD
        for _ in range(MOST_STEPS):
            if reach <= LEAST_REACH_RAD:
                break
            frame = across(best)

            def leant(angles: FloatArray, here: FloatArray = best, frame: FloatArray = frame) -> FloatArray:
                direction = here + angles @ frame
                return np.asarray(direction / np.linalg.norm(direction))

            steps = reach * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]])
            values = np.array([evidence(leant(step)) for step in steps])
            slope = 0.5 * (values[:2] - values[2:4]) / reach
            bend = np.diag(values[:2] + values[2:4] - 2.0 * found) / reach**2
            bend[0, 1] = bend[1, 0] = (values[4] - values[0] - values[1] + found) / reach**2
            hill = np.linalg.eigvalsh(bend)[-1] < 0.0
            step = (
                -np.linalg.solve(bend, slope)
                if hill
                else slope * (2.0 * reach / max(float(np.linalg.norm(slope)), 1e-300))
            )
            length = float(np.linalg.norm(step))
            step *= min(1.0, 2.0 * reach / length) if length > 0.0 else 1.0
            steps, values = np.vstack([steps, step]), np.append(values, evidence(leant(step)))
            place = int(np.argmax(values))
            cut = not hill or length > 2.0 * reach
            gains = values[place] > found + LEAST_GAIN_NATS
            if gains:
                best, found = leant(steps[place]), float(values[place])
            if cut:
                reach = min(2.0 * reach, FIRST_REACH_RAD) if gains else 0.5 * reach
            else:  # a whole step says how near the top is
                reach = min(reach if gains else 0.5 * reach, max(0.5 * length, 0.1 * reach))
        return best, found

    def spread(self, gravity: FloatArray, weight: FloatArray, mean: FloatArray, factor: FloatArray) -> float:
        """rad, standard deviation of the best direction along its worst tangent.

        What the evidence leaves open, and how far the direction moves when a part of the rows is left out.
        """
        size, frame = float(np.linalg.norm(gravity)), across(gravity)

        def curved(parts: Sequence[int]) -> tuple[FloatArray, FloatArray]:
            products = self.products.summed(parts, weight)

            def cost(first: float, second: float) -> float:
                leant = gravity + size * TANGENT_RAD * (np.array([first, second]) @ frame)
                turned = self.turned(products, size * leant / np.linalg.norm(leant))
                return -self._evidence(turned, mean, factor)

            here, ahead, back = cost(0, 0), (cost(1, 0), cost(0, 1)), (cost(-1, 0), cost(0, -1))
            mixed = 0.25 * (cost(1, 1) + cost(-1, -1) - cost(1, -1) - cost(-1, 1))
            slope = np.array([0.5 * (ahead[k] - back[k]) for k in (0, 1)])
            bend = np.array([[ahead[0] + back[0] - 2.0 * here, mixed], [mixed, ahead[1] + back[1] - 2.0 * here]])
            # No direction is less certain than one of which nothing is known.
            return slope / TANGENT_RAD, bend / TANGENT_RAD**2 + np.eye(2)

        _, bend = curved(self.parts)
        covariance = np.linalg.inv(bend)
        if len(self.parts) > 1:
            slopes = np.array([curved([other for other in self.parts if other != part])[0] for part in self.parts])
            covariance = covariance + between_parts(slopes @ covariance)
        return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
