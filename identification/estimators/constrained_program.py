"""The paper's program (10) in y = (m, h = m·l_C, I_C, F): its cost with exact derivatives, its rules, points inside.

In y all rules are linear and eq. (4) is linear but for h hᵀ/m. Which start is best, and how good a solution is proven
to be, is asked in `constrained`.
"""

from __future__ import annotations

import clarabel
import numpy as np
import scipy.sparse

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import SolverError
from identification.estimators.feasibility import FeasibilityRules, linear_inequalities
from identification.estimators.interior_point import InteriorPointResult, minimise_inside
from identification.estimators.observation import ReducedProblem
from identification.physical_parameters import (
    INERTIAL_COUNT,
    PhysicalParameters,
    symmetric,
    tensor_curvatures,
    tensor_jacobians,
)

LOCAL_BARRIER = 1e-4
"""First barrier parameter: a small one leaves a start in the basin where it began."""
# Distance kept from every rule, in its own unit: enough for a product of rounded numbers to stay on the right side.
_MARGIN = 1e-9
# kg m², asked for by a cut of full consistency.
_CONSISTENCY_MARGIN = 1e-6
# Per kg, in units of the objective: settles masses that no torque depends on and nothing else.
_PRICE_OF_MASS = 1e-6
# Tried in turn, in typical sizes of the entries: how far inside the rules a start is put.
_DISTANCES_FROM_RULES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


class ConstrainedProgram:
    """Program (10) in y: excess cost with exact derivatives, the rules as A y ≤ b, points inside them.

    y is (links, 10 + extras) raveled, the layout of full_names with (m, h, I_C) in place of the inertial entries.
    scale: weighted squared residuals that count as 1 in `excess`: the least-squares cost, so that values are of order
    one (an objective scaled by 1e3 or 1e-3 makes general solvers report false success).
    """

    def __init__(self, problem: ReducedProblem, base: BaseRegressor, rules: FeasibilityRules) -> None:
        self._problem = problem
        self._base = base
        self._rules = rules
        self._links = base.robot.n
        self._stride = INERTIAL_COUNT + len(base.options.symbols)
        self.scale = problem.scale
        root = np.sqrt(self.scale)
        self._image = problem.triangular @ base.regrouping / root
        self._target = problem.projected / root
        self._gram = 2.0 * self._image.T @ self._image
        matrix, bound = linear_inequalities(rules, self._links, base.options.symbols)
        self.matrix = scipy.sparse.csr_array(matrix)
        self.bound = bound - _MARGIN
        price = np.zeros((self._links, self._stride))
        price[:, 0] = _PRICE_OF_MASS if rules.lightest else 0.0
        self._price = price.ravel()

    def consistency_cuts(self, y: FloatArray) -> list[FloatArray]:
        """Rows a with a · y < 0 at this point and a · y ≥ 0 for every consistent set: vᵀ (½ tr(I_C) 1 − I_C) v."""
        rows = []
        table = y.reshape(self._links, self._stride)
        for link, tensor in enumerate(symmetric(table[:, 4:INERTIAL_COUNT])):
            values, vectors = np.linalg.eigh(0.5 * np.trace(tensor) * np.eye(3) - tensor)
            for value, v in zip(values, vectors.T, strict=True):
                if value < 0.0:
                    row = np.zeros((self._links, self._stride))
                    x, y_, z = v
                    row[link, 4:INERTIAL_COUNT] = [
                        0.5 - x * x, -2.0 * x * y_, -2.0 * x * z, 0.5 - y_ * y_, -2.0 * y_ * z, 0.5 - z * z,
                    ]  # fmt: skip
                    rows.append(row.ravel())
        return rows

    def add(self, rows: list[FloatArray]) -> None:
        """Ask for row · y ≥ margin too; the margin lets rounds of cuts end."""
        self.matrix = scipy.sparse.csr_array(np.vstack([self.matrix.toarray(), -np.array(rows)]))
        self.bound = np.append(self.bound, np.full(len(rows), -_CONSISTENCY_MARGIN))

    def dynamic_parameters(self, y: FloatArray) -> FloatArray:
        """π(y), eq. (4)."""
        table = y.reshape(self._links, self._stride)
        m, h = table[:, :1], table[:, 1:4]
        squares = h * h / m
        result = table.copy()
        result[:, 4] += squares[:, 1] + squares[:, 2]
        result[:, 7] += squares[:, 0] + squares[:, 2]
        result[:, 9] += squares[:, 0] + squares[:, 1]
        result[:, 5] -= h[:, 0] * h[:, 1] / m[:, 0]
        result[:, 6] -= h[:, 0] * h[:, 2] / m[:, 0]
        result[:, 8] -= h[:, 1] * h[:, 2] / m[:, 0]
        return result.ravel()

    def variables_of(self, full: FloatArray) -> FloatArray:
        """The y of dynamic parameters with positive masses, the inverse of `dynamic_parameters`."""
        table = full.reshape(self._links, self._stride)
        shifted = self.dynamic_parameters(full).reshape(self._links, self._stride)
        return np.asarray((2.0 * table - shifted).ravel(), dtype=np.float64)

    def physical(self, y: FloatArray) -> PhysicalParameters:
        """The physical parameters μ that y stands for."""
        table = y.reshape(self._links, self._stride)
        return PhysicalParameters(
            mass=table[:, 0].copy(),
            center_of_mass=table[:, 1:4] / table[:, :1],
            inertia=symmetric(table[:, 4:INERTIAL_COUNT]),
            viscous=self._base.extra_of(y, "FV"),
            coulomb=self._base.extra_of(y, "FS"),
        )

    def cost(self, y: FloatArray) -> float:
        """Weighted squared residuals, as `ReducedProblem.cost`."""
        return self._problem.cost(self._base.base_from_full(self.dynamic_parameters(y)))

    def excess(self, y: FloatArray) -> float:
        """(cost − least-squares cost) / scale, plus 1e-6 per kg where the lightest set is wanted."""
        residual = self._image @ self.dynamic_parameters(y) - self._target
        return float(residual @ residual + self._price @ y)

    def derivatives(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient (k,) and Hessian (k, k) of `excess`, exact."""
        residual = self._image @ self.dynamic_parameters(y) - self._target
        slope = 2.0 * self._image.T @ residual  # with respect to π
        links, stride, size = self._links, self._stride, len(y)
        table, slopes = y.reshape(links, stride), slope.reshape(links, stride)
        blocks = tensor_jacobians(table[:, 0], table[:, 1:4])
        # J is the identity plus one (6, 4) block per link: products with it go link by link
        gradient = slopes.copy()
        gradient[:, :4] += np.einsum("lij,li->lj", blocks, slopes[:, 4:INERTIAL_COUNT])
        right = self._gram.reshape(size, links, stride).transpose(1, 0, 2).copy()
        right[:, :, :4] += right[:, :, 4:INERTIAL_COUNT] @ blocks
        hessian = right.transpose(1, 0, 2).reshape(links, stride, size)
        hessian[:, :4] += blocks.transpose(0, 2, 1) @ hessian[:, 4:INERTIAL_COUNT]
        hessian = hessian.reshape(size, size)
        for link, curvature in enumerate(tensor_curvatures(table[:, 0], table[:, 1:4], slopes[:, 4:INERTIAL_COUNT])):
            first = link * stride
            hessian[first : first + 4, first : first + 4] += curvature
        return gradient.ravel() + self._price, hessian

    def inside(self, y: FloatArray) -> FloatArray:
        """The point nearest to y, in typical sizes of its entries, that keeps some distance from every rule.

        A convex quadratic program; the distance asked for shrinks until there is such a point. Raises SolverError if
        the rules contradict each other.
        """
        typical = self._typical_sizes(y)
        size = len(y)
        constraints = scipy.sparse.csc_matrix(self.matrix.multiply(typical))
        norms = np.sqrt(np.asarray(constraints.multiply(constraints).sum(axis=1)).ravel())
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        for distance in _DISTANCES_FROM_RULES:
            limit = self.bound - distance * norms - self.matrix @ y
            cones = [clarabel.NonnegativeConeT(len(limit))]
            identity = scipy.sparse.eye_array(size, format="csc")
            solution = clarabel.DefaultSolver(identity, np.zeros(size), constraints, limit, cones, settings).solve()
            point = np.asarray(y + typical * np.array(solution.x), dtype=np.float64)
            if np.all(self.bound - self.matrix @ point > 0.0):
                return point
        raise SolverError(
            "The rules (10b) and (10d) contradict each other: no set of physical parameters meets all of them.",
            solver="Clarabel",
            status=str(solution.status),
        )

    def random_point(self, generator: np.random.Generator, like: FloatArray) -> FloatArray:
        """A random point inside the rules with masses, sizes and friction of the order of those of `like`.

        As the paper started: every link a homogeneous body of random mass and size about a random centre of mass.
        """
        table = like.reshape(self._links, self._stride).copy()
        masses = np.maximum(table[:, 0], self._rules.mass[0])
        table[:, 0] = masses * 3.0 ** generator.uniform(-1.0, 1.0, self._links)
        reach = 0.5 * self._rules.center_of_mass
        table[:, 1:4] = table[:, :1] * generator.uniform(-reach, reach, (self._links, 3))
        sizes = generator.uniform(0.05, 0.3, (self._links, 3)) * self._rules.center_of_mass / 0.3
        squares = table[:, :1] * sizes**2 / 12.0
        table[:, 4:INERTIAL_COUNT] = 0.0
        for axis, entry in enumerate((4, 7, 9)):
            table[:, entry] = squares.sum(axis=1) - squares[:, axis]
        factors = 3.0 ** generator.uniform(-1.0, 1.0, (self._links, self._stride - INERTIAL_COUNT))
        table[:, INERTIAL_COUNT:] *= factors
        return self.inside(table.ravel())

    def solve_from(self, y: FloatArray, initial_barrier: float = LOCAL_BARRIER) -> InteriorPointResult:
        """The local minimum that the interior-point method reaches from a point y inside the rules."""
        return minimise_inside(
            self.excess, self.derivatives, self.matrix, self.bound, y, initial_barrier=initial_barrier
        )

    def _typical_sizes(self, y: FloatArray) -> FloatArray:
        """What counts as one unit of each entry near y: the link's own mass, extent and inertia."""
        table = y.reshape(self._links, self._stride)
        typical = np.empty_like(table)
        mass = np.clip(table[:, 0], *self._rules.mass)
        inertia = np.abs(table[:, [4, 7, 9]]).mean(axis=1)
        typical[:, 0] = mass
        typical[:, 1:4] = (mass * self._rules.center_of_mass)[:, None]
        typical[:, 4:INERTIAL_COUNT] = np.clip(inertia, *self._rules.diagonal_inertia)[:, None]
        typical[:, INERTIAL_COUNT:] = np.maximum(np.abs(table[:, INERTIAL_COUNT:]), 0.1)
        return typical.ravel()
