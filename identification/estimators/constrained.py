"""The paper's program (10): physical parameters of smallest cost under (10b)–(10d), with a certificate.

Solved in y = (m, h = m·l_C, I_C, F), where all rules are linear and eq. (4) is linear but for h hᵀ/m. An
interior-point method (`interior_point`) runs from several seeded starts inside the rules; what it returns meets every
rule exactly, and its cost is set beside a lower bound that no set meeting the rules can go below (`semidefinite`).
Not here: least squares, and the check of the rules themselves (`feasibility`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import clarabel
import numpy as np
import numpy.typing as npt
import scipy.sparse

from identification.base_parameters import BaseRegressor
from identification.errors import SolverError
from identification.estimators.feasibility import (
    FeasibilityRules,
    Violation,
    linear_inequalities,
    rules_for,
    violations,
)
from identification.estimators.interior_point import InteriorPointResult, minimise_inside
from identification.estimators.observation import ReducedProblem
from identification.estimators.physical import (
    INERTIAL_COUNT,
    PhysicalParameters,
    symmetric,
    tensor_curvatures,
    tensor_jacobians,
)
from identification.estimators.semidefinite import relax_constrained_program, solve_semidefinite

FloatArray = npt.NDArray[np.float64]

# Distance kept from every rule, in its own unit: enough for a product of rounded numbers to stay on the right side.
_MARGIN = 1e-9
# kg m², asked for by a cut of full consistency; and how many local minima are taken on, how often.
_CONSISTENCY_MARGIN = 1e-6
_STARTS_WITH_CUTS = 4
# So many first starts whose costs differ by no more than this share of the least-squares cost are one minimum; those
# that reach the same one differ by 4e-8, distinct ones by 1e-4 and more.
_AGREEING_STARTS = 4
_SAME_MINIMUM = 1e-6
# Share of the least-squares cost that a better set could still gain, by the proven bound, below which none is looked
# for: what tells two distinct minima apart.
_NOTHING_TO_GAIN = 1e-4
_MOST_CUTS = 40
_SMALLEST_RELATIVE_COST = 1e-8
# First barrier parameter: a large one leads every start along the central path to one and the same minimum, a small
# one leaves it in the basin where it began.
_CENTRAL_BARRIER = 1e-2
_LOCAL_BARRIER = 1e-4
# Per kg, in units of the objective: settles masses that no torque depends on and nothing else.
_PRICE_OF_MASS = 1e-6
# Tried in turn, in typical sizes of the entries: how far inside the rules a start is put.
_DISTANCES_FROM_RULES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


@dataclass(frozen=True, slots=True)
class Start:
    """One start of the optimiser: where it began, the cost it reached, whether it converged, its iterations."""

    origin: str
    cost: float
    converged: bool
    iterations: int


@dataclass(frozen=True, slots=True)
class Certificate:
    """What is proven about a solution of program (10).

    cost: of the set returned; least_squares_cost: of (9), without rules; lower_bound: of any set that meets the rules;
    gap: (cost − lower_bound) / least_squares_cost, which bounds what a better optimiser could still gain.
    consistent_cost: of the pseudo-inertia program (full physical consistency, without the rules of (10d)).
    violations: rules of (10b)–(10d) that do not hold, compared exactly: empty. fully_consistent: whether all links'
    pseudo-inertias are positive definite, which (10d) does not ask for; smallest_eigenvalue: the smallest of theirs.
    """

    cost: float
    least_squares_cost: float
    lower_bound: float
    gap: float
    consistent_cost: float
    violations: tuple[Violation, ...]
    fully_consistent: bool
    smallest_eigenvalue: float

    @property
    def feasible(self) -> bool:
        """Whether every rule of (10b)–(10d) holds."""
        return not self.violations

    def to_json(self) -> dict[str, object]:
        """The certificate as it stands in model.json; costs are weighted sums of squared residuals."""
        return {
            "program": "(10a)-(10d), corrected",
            "feasible": self.feasible,
            "violations": [asdict(violation) for violation in self.violations],
            "cost": self.cost,
            "least_squares_cost": self.least_squares_cost,
            "lower_bound": self.lower_bound,
            "gap": self.gap,
            "consistent_cost": self.consistent_cost,
            "fully_consistent": self.fully_consistent,
            "smallest_pseudo_inertia_eigenvalue": self.smallest_eigenvalue,
        }


@dataclass(frozen=True, slots=True, eq=False)
class ConstrainedResult:
    """Solution of program (10).

    physical: μ. base_values: (p,) its base parameters. full: (full,) its dynamic parameters in the order of
    full_names, with rotor inertias and offsets where chosen. cost, lower_bound: as in the certificate. starts: all, the
    best first. rules: those asked for.
    """

    physical: PhysicalParameters
    base_values: FloatArray
    full: FloatArray
    cost: float
    lower_bound: float
    starts: tuple[Start, ...]
    certificate: Certificate
    rules: FeasibilityRules


def solve_constrained(
    problem: ReducedProblem,
    base: BaseRegressor,
    rules: FeasibilityRules | None = None,
    *,
    starts: int = 16,
    seed: int = 0,
    full_consistency: bool = False,
) -> ConstrainedResult:
    """Solve (10a)–(10d), corrected. problem: the reduced least-squares problem; its weights are the program's.

    starts: how many at most; the first from the convex relaxation, the second from the pseudo-inertia program, the
    others random inside the rules (seed). There are local minima, up to a few per cent apart where no feasible robot
    fits the data well; a random start then reaches the best of them about three times in ten, hence 16. Where the first
    four, of three kinds, all converge to one cost, there is one minimum to speak of and no more are asked; nor where
    the relaxation's bound proves that a better one could gain no more than 1e-4 of the least-squares cost.
    full_consistency: also ask for positive semidefinite pseudo-inertias, by cuts: S = ½ tr(I_C) 1 − I_C ⪰ 0 means
    vᵀ S v ≥ 0 for every v, which is linear in y, so the worst v of each link joins the rules until none is
    left. Raises SolverError if the rules contradict each other or no start converges to a set that meets them.
    """
    chosen = rules if rules is not None else rules_for(base.robot)
    program = ConstrainedProgram(problem, base, chosen)
    relaxation = relax_constrained_program(problem, base, chosen, full_consistency=full_consistency)
    consistent = solve_semidefinite(problem, base, chosen)
    generator = np.random.default_rng(seed)
    typical = program.variables_of(consistent.full)
    origins: list[tuple[str, FloatArray, float]] = [
        ("convex relaxation", program.inside(relaxation.start), _CENTRAL_BARRIER),
        ("pseudo-inertia program", program.inside(typical), _LOCAL_BARRIER),
    ]
    ends: list[tuple[str, InteriorPointResult]] = []
    for number in range(max(starts, 1)):
        if number >= len(origins):
            point = program.random_point(generator, typical)
            origins.append((f"random {number - 1}, seed {seed}", point, _LOCAL_BARRIER))
        origin, point, barrier = origins[number]
        ends.append((origin, program.solve_from(point, barrier)))
        if number + 1 == _AGREEING_STARTS and _agree([end for _, end in ends]):
            break
        gap = (program.cost(ends[-1][1].point) - relaxation.lower_bound) / program.scale
        # With full consistency the bound is that of another program, whose cuts want several minima to begin from.
        if not full_consistency and ends[-1][1].converged and gap <= _NOTHING_TO_GAIN:
            break
    ends.sort(key=lambda end: end[1].value)
    best = ends[0][1]
    if full_consistency:
        best = _made_consistent(program, [end.point for _, end in ends[:_STARTS_WITH_CUTS]])
    physical = program.physical(best.point)
    full = program.dynamic_parameters(best.point)
    base_values = base.base_from_full(full)
    cost = problem.cost(base_values)
    broken = violations(chosen, physical, base.options.symbols)
    if broken:
        worst = broken[0]
        raise SolverError(
            f"Program (10) ended outside its own rules: {worst.rule} of link {worst.link} is {worst.value:.6g}, "
            f"allowed is {worst.limit:.6g}.",
            solver="interior point",
            status="infeasible",
        )
    smallest = float(np.linalg.eigvalsh(physical.pseudo_inertia()).min())
    certificate = Certificate(
        cost=cost,
        least_squares_cost=problem.residual_square,
        lower_bound=relaxation.lower_bound,
        gap=(cost - relaxation.lower_bound) / program.scale,
        consistent_cost=consistent.cost,
        violations=broken,
        fully_consistent=smallest > 0.0,
        smallest_eigenvalue=smallest,
    )
    return ConstrainedResult(
        physical=physical,
        base_values=base_values,
        full=full,
        cost=cost,
        lower_bound=relaxation.lower_bound,
        starts=tuple(Start(origin, program.cost(end.point), end.converged, end.iterations) for origin, end in ends),
        certificate=certificate,
        rules=chosen,
    )


def _agree(ends: list[InteriorPointResult]) -> bool:
    """Whether all converged to one cost, in units of the least-squares cost."""
    values = [end.value for end in ends]
    return all(end.converged for end in ends) and max(values) - min(values) <= _SAME_MINIMUM


def _made_consistent(program: ConstrainedProgram, points: list[FloatArray]) -> InteriorPointResult:
    """The best local minimum, from those of program (10), of the program with full consistency."""
    for _ in range(_MOST_CUTS):
        ends = sorted((program.solve_from(program.inside(point)) for point in points), key=lambda end: end.value)
        cuts = [program.consistency_cuts(end.point) for end in ends]
        if not cuts[0]:
            return ends[0]
        program.add([cut for of_end in cuts for cut in of_end])
        points = [end.point for end in ends]
    raise SolverError(
        f"Program (10) with full consistency is not consistent after {_MOST_CUTS} rounds of cuts.",
        solver="interior point",
        status="iteration limit",
    )


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
        self.scale = max(
            problem.residual_square, _SMALLEST_RELATIVE_COST * float(problem.projected @ problem.projected)
        )
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
        viscous, coulomb = self._base.extra_of(y, "FV"), self._base.extra_of(y, "FS")
        none = np.zeros(self._links)
        return PhysicalParameters(
            mass=table[:, 0].copy(),
            center_of_mass=table[:, 1:4] / table[:, :1],
            inertia=symmetric(table[:, 4:INERTIAL_COUNT]),
            viscous=none if viscous is None else viscous,
            coulomb=none if coulomb is None else coulomb,
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

    def solve_from(self, y: FloatArray, initial_barrier: float = _LOCAL_BARRIER) -> InteriorPointResult:
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
