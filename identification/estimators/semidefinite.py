"""Convex programs for physical parameters, solved by Clarabel called directly: global optima with a lower bound.

Two programs over the dynamic parameters π of all links, both minimising ‖R K π − r‖² of a `ReducedProblem`:
`solve_semidefinite` asks that every link can exist (pseudo-inertia positive semidefinite) within the bounds (10b);
`relax_constrained_program` is a convex relaxation of the paper's program (10), whose optimum is a lower bound of it.
Not here: program (10) itself (`constrained`).

Both are centred at the least-squares solution, so that the objective is the excess cost and loses no digits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import clarabel
import numpy as np
import scipy.sparse

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import SolverError
from identification.estimators.feasibility import FeasibilityRules, linear_inequalities, rules_for
from identification.estimators.observation import ReducedProblem
from identification.physical_parameters import INERTIAL_COUNT, PhysicalParameters, pseudo_inertia, symmetric

_TENSOR, _DIAGONAL = slice(4, INERTIAL_COUNT), np.array([4, 7, 9])
"""XX … ZZ, and XX, YY, ZZ, among a link's ten entries."""
_SETTLING_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class SemidefiniteResult:
    """The best physically consistent parameters.

    physical: masses, centres of mass, inertias, friction (rotor inertias and offsets stand in full). base_values: (p,)
    their base parameters. full: (full,) their dynamic parameters. cost: weighted squared residuals, same unit as the
    least-squares cost. lower_bound: no physically consistent set within the bounds costs less (value of the dual
    program).
    """

    physical: PhysicalParameters
    base_values: FloatArray
    full: FloatArray
    cost: float
    lower_bound: float


@dataclass(frozen=True, slots=True, eq=False)
class RelaxationResult:
    """Lower bound of program (10): no set that meets (10b)–(10d) costs less than lower_bound.

    start: (full,) the relaxation's (m, h, I_C, F) in the layout of full_names; it meets the rules, but costs more.
    """

    lower_bound: float
    start: FloatArray


def solve_semidefinite(
    problem: ReducedProblem, base: BaseRegressor, rules: FeasibilityRules | None = None, *, inertia_margin: float = 1e-6
) -> SemidefiniteResult:
    """The parameters of smallest cost among those of robots that can exist.

    Asked for per link: pseudo-inertia [[Σ, h], [hᵀ, m]] ⪰ 0 with Σ reduced by inertia_margin (kg m², so that the
    result is consistent with something to spare), mass and centre of mass within (10b), friction within its bounds.
    The rules (10d) beyond these are not asked for. Where the rules want the lightest set, it is the lightest whose cost
    is within 1e-6 of the smallest, in units of the least-squares cost. Source: Wensing, Kim, Slotine, IEEE RA-L 2018;
    Sousa and Cortesão, IJRR 2014. Raises SolverError if Clarabel finds no solution.
    """
    chosen = rules if rules is not None else rules_for(base.robot)
    links, symbols = base.robot.n, base.options.symbols
    stride = INERTIAL_COUNT + len(symbols)
    matrix, bound = linear_inequalities(chosen, links, symbols)
    # keep the rows that speak of m, h and friction only: in π the tensor is about the frame's origin
    about_others = ~np.any(matrix.reshape(-1, links, stride)[..., _TENSOR], axis=(1, 2))
    program = _ConicProgram(problem.triangular @ base.regrouping, _centre(problem, base), problem)
    program.nonnegative(matrix[about_others], bound[about_others])
    for link in range(links):
        program.positive_semidefinite(*_pseudo_inertia_rows(link, stride, links * stride, inertia_margin), 4)
        if np.isfinite(chosen.radius_of_gyration):
            program.nonnegative(*_gyration_rows(link, stride, links * stride, chosen))
    solution = program.solve("pseudo-inertia program")
    if chosen.lightest:
        masses = np.zeros((links, stride))
        masses[:, 0] = 1.0
        solution = program.settle("pseudo-inertia program, lightest set", solution, masses.ravel())
    solution = replace(solution, variables=_inside_the_cone(solution.variables, links, stride, inertia_margin))
    physical = PhysicalParameters.from_dynamic_parameters(
        solution.variables.reshape(links, stride)[:, :INERTIAL_COUNT],
        base.extra_of(solution.variables, "FV"),
        base.extra_of(solution.variables, "FS"),
    )
    base_values = base.base_from_full(solution.variables)
    return SemidefiniteResult(
        physical=physical,
        base_values=base_values,
        full=solution.variables,
        cost=problem.cost(base_values),
        lower_bound=solution.lower_bound,
    )


def _inside_the_cone(variables: FloatArray, links: int, stride: int, margin: float) -> FloatArray:
    """The same parameters with each link's Σ about its centre of mass at least margin (kg m²) in every direction.

    The solver's tolerance may leave a link some 1e-5 kg m² outside, which a simulator refuses; the nearest Σ inside is
    taken (Frobenius norm). Masses and first moments stay.
    """
    table = variables.reshape(links, stride).copy()
    for link, tensor in enumerate(PhysicalParameters.from_dynamic_parameters(table[:, :INERTIAL_COUNT]).inertia):
        values, vectors = np.linalg.eigh(0.5 * np.trace(tensor) * np.eye(3) - tensor)
        lifted = (vectors * np.maximum(values, margin)) @ vectors.T
        change = np.trace(lifted) * np.eye(3) - lifted - tensor
        table[link, _TENSOR] += change[np.triu_indices(3)]
    return table.ravel()


def relax_constrained_program(
    problem: ReducedProblem, base: BaseRegressor, rules: FeasibilityRules, *, full_consistency: bool = False
) -> RelaxationResult:
    """Lower bound of program (10) by a convex relaxation.

    Variables (m, h, I_C, F) with all rules (10b), (10d), and per link a matrix H in place of h hᵀ/m, which eq. (4)
    makes the only nonlinear term: π = (m, h, I_C + tr(H) 1 − H, F). H = h hᵀ/m is relaxed to [[H, h], [hᵀ, m]] ⪰ 0
    and H_kk ≤ l² m, so every set of (10) has a counterpart here of the same cost. full_consistency: ask for
    ½ tr(I_C) 1 − I_C ⪰ 0 too, which is linear as it stands.
    """
    links, symbols = base.robot.n, base.options.symbols
    stride = INERTIAL_COUNT + len(symbols)
    size = links * stride
    to_full = np.hstack([np.eye(size), np.zeros((size, 6 * links))])
    units = symmetric(np.eye(6))
    turned = np.trace(units, axis1=1, axis2=2)[:, None, None] * np.eye(3) - units
    for link in range(links):
        own = slice(size + 6 * link, size + 6 * (link + 1))
        to_full[link * stride : (link + 1) * stride, own][_TENSOR] = turned[:, *np.triu_indices(3)].T
    centre = np.concatenate([_centre(problem, base), np.zeros(6 * links)])
    program = _ConicProgram(problem.triangular @ base.regrouping @ to_full, centre, problem)
    matrix, bound = linear_inequalities(rules, links, symbols)
    program.nonnegative(np.hstack([matrix, np.zeros((len(matrix), 6 * links))]), bound)
    for link in range(links):
        program.positive_semidefinite(*_lifted_rows(link, stride, links), 4)
        box = np.zeros((3, size + 6 * links))
        box[:, link * stride] = -(rules.center_of_mass**2)
        box[range(3), size + 6 * link + _DIAGONAL - 4] = 1.0
        program.nonnegative(box, np.zeros(3))
        if full_consistency:
            rows, constants = _pseudo_inertia_rows(link, stride, size + 6 * links, 0.0)
            program.positive_semidefinite(rows[:6], constants[:6], 3)
    solution = program.solve("relaxation of program (10)")
    return RelaxationResult(solution.lower_bound, solution.variables[:size].copy())


def _centre(problem: ReducedProblem, base: BaseRegressor) -> FloatArray:
    """Dynamic parameters whose base parameters are the least-squares ones; not a feasible set, only an origin."""
    centre = np.zeros(len(base.full_names))
    centre[base.kept] = problem.minimiser()
    return centre


def _pseudo_inertia_rows(link: int, stride: int, size: int, margin: float) -> tuple[FloatArray, FloatArray]:
    """Rows (10, size) and constants of the scaled upper triangle of [[½ tr(I) 1 − I − margin 1, h], [hᵀ, m]]."""
    rows = np.zeros((10, size))
    rows[:, link * stride : link * stride + INERTIAL_COUNT] = scaled_triangle(pseudo_inertia(np.eye(INERTIAL_COUNT)))
    return rows, scaled_triangle(np.diag([-margin, -margin, -margin, 0.0])[None])[:, 0]


def scaled_triangle(matrices: FloatArray) -> FloatArray:
    """(d (d + 1) / 2, k) upper triangles of symmetric matrices (k, d, d), column by column, as Clarabel takes them."""
    columns, rows = np.tril_indices(matrices.shape[1])
    return np.asarray((matrices[:, rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0))).T)


def _gyration_rows(link: int, stride: int, size: int, rules: FeasibilityRules) -> tuple[FloatArray, FloatArray]:
    """I_kk ≤ m (r² + 2 l²) about the frame's origin: what the rule on the radius of gyration r leaves of it there."""
    rows = np.zeros((3, size))
    rows[:, link * stride] = -(rules.radius_of_gyration**2 + 2.0 * rules.center_of_mass**2)
    rows[range(3), link * stride + _DIAGONAL] = 1.0
    return rows, np.zeros(3)


def _lifted_rows(link: int, stride: int, links: int) -> tuple[FloatArray, FloatArray]:
    """Rows of the scaled upper triangle of [[H, h], [hᵀ, m]]."""
    first, lifted = link * stride, links * stride + 6 * link
    rows = np.zeros((10, links * (stride + 6)))
    rows[:, first : first + 4] = scaled_triangle(pseudo_inertia(np.eye(INERTIAL_COUNT)[:4]))
    rows[:6, lifted : lifted + 6] = scaled_triangle(symmetric(np.eye(6)))
    return rows, np.zeros(10)


@dataclass(frozen=True, slots=True, eq=False)
class _ConicSolution:
    variables: FloatArray
    excess: float
    lower_bound: float


class _ConicProgram:
    """min ‖G (x − centre)‖² over x in an intersection of cones, with G·centre the least-squares optimum.

    Clarabel sees δ = x − centre and z = G δ/√scale as variables with the objective ‖z‖², never the squared matrix.
    """

    def __init__(self, image: FloatArray, centre: FloatArray, problem: ReducedProblem) -> None:
        self._image = image
        self._centre = centre
        self._problem = problem
        self._scale = problem.scale
        self._rows: list[FloatArray] = []
        self._bounds: list[FloatArray] = []
        self._cones: list[object] = []

    def nonnegative(self, matrix: FloatArray, bound: FloatArray) -> None:
        """Add matrix · x ≤ bound."""
        self._add(matrix, bound, clarabel.NonnegativeConeT(len(bound)))

    def positive_semidefinite(self, rows: FloatArray, constants: FloatArray, order: int) -> None:
        """Add: the symmetric matrix whose scaled upper triangle is rows · x + constants is positive semidefinite."""
        self._add(-rows, constants, clarabel.PSDTriangleConeT(order))

    def solve(self, what: str) -> _ConicSolution:
        """Solve; raises SolverError unless Clarabel reports a solution."""
        size, p = len(self._centre), len(self._image)
        objective = np.concatenate([np.zeros(size), np.full(p, 2.0)])
        solution = self._run(what, objective, np.zeros(size + p), [], [])
        bound = max(0.0, min(float(solution.obj_val), float(solution.obj_val_dual)))
        return _ConicSolution(
            variables=self._centre + np.array(solution.x[:size]),
            excess=float(np.square(solution.x[size:]).sum()),
            lower_bound=self._problem.residual_square + self._scale * bound,
        )

    def settle(self, what: str, optimum: _ConicSolution, price: FloatArray) -> _ConicSolution:
        """Of all points whose cost is within 1e-6 of the optimum's, the one with the smallest price · x.

        Where the solver cannot work in so thin a shell, within 1e-5, 1e-4, 1e-3.
        """
        for widening in (1.0, 10.0, 100.0):
            try:
                return self._settle(what, optimum, price, widening * _SETTLING_TOLERANCE)
            except SolverError:
                continue
        return self._settle(what, optimum, price, 1000.0 * _SETTLING_TOLERANCE)

    def _settle(self, what: str, optimum: _ConicSolution, price: FloatArray, tolerance: float) -> _ConicSolution:
        size, p = len(self._centre), len(self._image)
        cone_rows = np.vstack([np.zeros(size + p), np.hstack([np.zeros((p, size)), -np.eye(p)])])
        radius = np.append(np.sqrt(optimum.excess + tolerance * max(1.0, optimum.excess)), np.zeros(p))
        solution = self._run(
            what,
            np.zeros(size + p),
            np.concatenate([price, np.zeros(p)]),
            [(cone_rows, radius)],
            [clarabel.SecondOrderConeT(p + 1)],
        )
        return replace(optimum, variables=self._centre + np.array(solution.x[:size]))

    def _run(
        self,
        what: str,
        quadratic: FloatArray,
        linear: FloatArray,
        further_rows: list[tuple[FloatArray, FloatArray]],
        further_cones: list[object],
    ) -> clarabel.DefaultSolution:
        """Minimise ½ Σ quadratic_i v_i² + linear · v over v = (δ, z) under all cones; checks the status."""
        p, _ = self._image.shape
        equality = np.hstack([self._image / np.sqrt(self._scale), -np.eye(p)])
        inequality = np.vstack(self._rows)
        constraints = np.vstack(
            [equality, np.hstack([inequality, np.zeros((len(inequality), p))]), *(rows for rows, _ in further_rows)]
        )
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_threads = 1
        settings.tol_gap_abs = settings.tol_gap_rel = 1e-9
        settings.tol_feas = 1e-9
        solution = clarabel.DefaultSolver(
            scipy.sparse.diags_array(quadratic).tocsc(),
            linear,
            scipy.sparse.csc_matrix(constraints),
            np.concatenate([np.zeros(p), *self._bounds, *(bound for _, bound in further_rows)]),
            [clarabel.ZeroConeT(p), *self._cones, *further_cones],
            settings,
        ).solve()
        status = str(solution.status)
        if status not in ("Solved", "AlmostSolved", "InsufficientProgress"):
            raise SolverError(
                f"The {what} has no solution ({status}); are the bounds (10b) too tight?",
                solver="Clarabel",
                status=status,
            )
        return solution

    def _add(self, matrix: FloatArray, bound: FloatArray, cone: object) -> None:
        self._rows.append(matrix)
        self._bounds.append(bound - matrix @ self._centre)
        self._cones.append(cone)
