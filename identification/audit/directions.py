"""Gravity over the whole sphere, and the clock over a decade: what no tangent reaches is looked for on a grid.

The products of the columns without gravity and per unit of it are made once; any direction is then a product of small
matrices. With a given model the question is how the base stands beside it; without one, how it stands at all. Pure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from identification.audit.columns import GRAVITY, HEAVY, PARAMETERS, Geometry, across
from identification.audit.columns import INERTIAL as _INERTIAL
from identification.audit.evidence import Products, between_parts, log_evidence, products_of

__all__ = ["Directions", "sphere"]

FloatArray = npt.NDArray[np.float64]
POINTS = 80
TANGENT_RAD = 5e-3


def sphere(points: int = POINTS) -> FloatArray:
    """(points, 3) unit vectors spread evenly over the sphere (Fibonacci's spiral)."""
    place = np.arange(points) + 0.5
    height, angle = 1.0 - 2.0 * place / points, np.pi * (1.0 + np.sqrt(5.0)) * place
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
        chosen = [geometry.rows.block % parts == part for part in range(parts)]
        return cls(products_of(columns, torque, geometry.rows.used, chosen), n)

    @property
    def parts(self) -> tuple[int, ...]:
        """Of the rows, all."""
        return tuple(range(len(self.products.gram)))

    def map(self, gravity: FloatArray, ratio: float) -> FloatArray:
        """(K, 14 n) how the columns of a set-up are made of the products' columns."""
        size = PARAMETERS * self.n
        result = np.zeros((size + 3 * HEAVY * self.n, size))
        scale = np.ones((self.n, PARAMETERS))
        scale[:, :_INERTIAL] = ratio**2
        scale[:, _INERTIAL], scale[:, -1] = ratio, ratio**2
        result[:size] = np.diag(scale.ravel())
        for link in range(self.n):
            for parameter in range(HEAVY):
                places = size + np.arange(3) * HEAVY * self.n + link * HEAVY + parameter
                result[places, link * PARAMETERS + parameter] = gravity
        return result

    def evidence(
        self, gravity: FloatArray, weight: FloatArray, mean: FloatArray, factor: FloatArray, ratio: float = 1.0
    ) -> float:
        """Log evidence of the torque with parameters N(mean, F Fᵀ) and weights (n,), up to a constant of the torque."""
        return self._evidence(*self.products.summed(self.parts, weight), self.map(gravity, ratio), mean, factor)

    @staticmethod
    def _evidence(
        gram: FloatArray, right: FloatArray, turned: FloatArray, mean: FloatArray, factor: FloatArray
    ) -> float:
        gram, right = turned.T @ gram @ turned, turned.T @ right
        square = 2.0 * mean @ right - mean @ gram @ mean
        return float(0.5 * square) + log_evidence(gram, right - gram @ mean, factor)

    def left(self, gravity: FloatArray, weight: FloatArray, factor: FloatArray, part: int | None = None) -> FloatArray:
        """(n,) Nm RMS that free parameters leave; on one part those that are fitted to the others."""
        gram, right = self.products.summed([other for other in self.parts if other != part], weight)
        turned = self.map(gravity, 1.0)
        root = cho_factor(np.eye(factor.shape[1]) + factor.T @ (turned.T @ gram @ turned) @ factor)
        values = turned @ (factor @ cho_solve(root, factor.T @ (turned.T @ right)))
        asked = self.parts if part is None else (part,)
        squares = self.products.left(asked, values, np.arange(len(values)))
        return np.asarray(np.sqrt(squares / np.maximum(self.products.counts(asked), 1.0)))

    def best(
        self, weight: FloatArray, mean: FloatArray, factor: FloatArray, size: float = GRAVITY
    ) -> tuple[FloatArray, float]:
        """Gravity (3,) of the best direction, and its log evidence."""
        products = self.products.summed(self.parts, weight)

        def evidence(direction: FloatArray) -> float:
            turned = self.map(size * direction / np.linalg.norm(direction), 1.0)
            return self._evidence(*products, turned, mean, factor)

        points = sphere()
        values = [evidence(point) for point in points]
        best, found = self._refined(evidence, points[int(np.argmax(values))])
        # Upside down a motion of little inertia looks nearly alike, and the grid is too wide to see which is better.
        if evidence(-best) > found:
            best, found = self._refined(evidence, -best)
        return size * best, found

    @staticmethod
    def _refined(evidence: Callable[[FloatArray], float], start: FloatArray) -> tuple[FloatArray, float]:
        """The likeliest unit vector (3,) near a start, and its log evidence."""
        best, found = start, 0.0
        for reach in (0.2, 0.02):
            frame = np.vstack([best, across(best)])
            simplex = np.array([[0.0, 0.0], [reach, 0.0], [0.0, reach]])
            options: Any = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-3, "maxiter": 60}

            def cost(angles: FloatArray, frame: FloatArray) -> float:
                return -evidence(frame[0] + angles @ frame[1:])

            result = minimize(cost, np.zeros(2), (frame,), method="Nelder-Mead", options=options)
            direction = frame[0] + result.x @ frame[1:]
            best, found = direction / np.linalg.norm(direction), -float(result.fun)
        return best, found

    def spread(self, gravity: FloatArray, weight: FloatArray, mean: FloatArray, factor: FloatArray) -> float:
        """rad, standard deviation of the best direction along its worst tangent.

        What the evidence leaves open, and how far the direction moves when a part of the rows is left out.
        """
        size, frame = float(np.linalg.norm(gravity)), across(gravity)

        def curved(parts: Sequence[int]) -> tuple[FloatArray, FloatArray]:
            products = self.products.summed(parts, weight)

            def cost(first: float, second: float) -> float:
                turned = gravity + size * TANGENT_RAD * (np.array([first, second]) @ frame)
                return -self._evidence(*products, self.map(size * turned / np.linalg.norm(turned), 1.0), mean, factor)

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
