"""Gravity over the whole sphere, and the clock over a decade: what no tangent reaches is looked for on a grid.

The products of the columns without gravity and per unit of it are made once; any direction is then a product of small
matrices. With a given model the question is how the base stands beside it; without one, how it stands at all. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from identification.audit.columns import GRAVITY, HEAVY, PARAMETERS, Geometry
from identification.audit.columns import INERTIAL as _INERTIAL
from identification.audit.evidence import Products, log_evidence, products_of

__all__ = ["Directions", "sphere"]

FloatArray = npt.NDArray[np.float64]
POINTS = 80


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
    def of(cls, geometry: Geometry, torque: FloatArray) -> Directions:
        """Of the rows of a geometry."""
        n, count = geometry.robot.n, len(torque)
        free = geometry.columns(np.zeros(3))
        heavy = np.moveaxis(geometry.heavy, 0, 2).reshape(count, n, -1)
        columns = np.concatenate([free, heavy], axis=2)
        return cls(products_of(columns, torque, geometry.rows.used, [np.ones(count, dtype=np.bool_)]), n)

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
        return self._evidence(*self.products.summed((0,), weight), self.map(gravity, ratio), mean, factor)

    @staticmethod
    def _evidence(
        gram: FloatArray, right: FloatArray, turned: FloatArray, mean: FloatArray, factor: FloatArray
    ) -> float:
        gram, right = turned.T @ gram @ turned, turned.T @ right
        square = 2.0 * mean @ right - mean @ gram @ mean
        return float(0.5 * square) + log_evidence(gram, right - gram @ mean, factor)

    def left(self, gravity: FloatArray, weight: FloatArray, factor: FloatArray) -> FloatArray:
        """(n,) Nm RMS that free parameters leave."""
        gram, right = self.products.summed((0,), weight)
        turned = self.map(gravity, 1.0)
        root = cho_factor(np.eye(factor.shape[1]) + factor.T @ (turned.T @ gram @ turned) @ factor)
        values = turned @ (factor @ cho_solve(root, factor.T @ (turned.T @ right)))
        squares = self.products.left((0,), values, np.arange(len(values)))
        return np.asarray(np.sqrt(squares / np.maximum(self.products.counts((0,)), 1.0)))

    def best(
        self, weight: FloatArray, mean: FloatArray, factor: FloatArray, size: float = GRAVITY
    ) -> tuple[FloatArray, float]:
        """Gravity (3,) of the best direction, and its log evidence."""
        products = self.products.summed((0,), weight)

        def evidence(direction: FloatArray) -> float:
            turned = self.map(size * direction / np.linalg.norm(direction), 1.0)
            return self._evidence(*products, turned, mean, factor)

        def cost(angles: FloatArray, frame: FloatArray) -> float:
            return -evidence(frame[0] + angles[0] * frame[1] + angles[1] * frame[2])

        points = sphere()
        values = [evidence(point) for point in points]
        best, found = points[int(np.argmax(values))], float(np.max(values))
        for reach in (0.2, 0.02):
            first = np.cross(best, np.eye(3)[int(np.argmin(np.abs(best)))])
            first /= np.linalg.norm(first)
            frame = np.stack([best, first, np.cross(best, first)])
            simplex = np.array([[0.0, 0.0], [reach, 0.0], [0.0, reach]])
            options: Any = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-3, "maxiter": 60}
            result = minimize(cost, np.zeros(2), (frame,), method="Nelder-Mead", options=options)
            direction = frame[0] + result.x[0] * frame[1] + result.x[1] * frame[2]
            best, found = direction / np.linalg.norm(direction), -float(result.fun)
        return size * best, found
