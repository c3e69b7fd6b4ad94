"""The paper's program (10): physical parameters of smallest cost under (10b)–(10d), with a certificate.

Solved in y = (m, h = m·l_C, I_C, F), where all rules are linear and eq. (4) is linear but for h hᵀ/m. An
interior-point method (`interior_point`) runs from several seeded starts inside the rules; what it returns meets every
rule exactly, and its cost is set beside a lower bound that no set meeting the rules can go below (`semidefinite`).
Not here: least squares, and the check of the rules themselves (`feasibility`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count, islice

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import SolverError
from identification.estimators.constrained_program import LOCAL_BARRIER, ConstrainedProgram
from identification.estimators.feasibility import FeasibilityRules, rules_for, violations
from identification.estimators.interior_point import InteriorPointResult
from identification.estimators.observation import ReducedProblem
from identification.estimators.semidefinite import relax_constrained_program, solve_semidefinite
from identification.json_values import plain
from identification.physical_parameters import PhysicalParameters

# Local minima that are taken on to full consistency, and rounds of cuts.
_STARTS_WITH_CUTS, _MOST_CUTS = 4, 40
# So many first starts whose costs differ by no more than this share of the least-squares cost are one minimum; those
# that reach the same one differ by 4e-8, distinct ones by 1e-4 and more.
_AGREEING_STARTS = 4
_SAME_MINIMUM = 1e-6
# Share of the least-squares cost that a better set could still gain, by the proven bound, below which none is looked
# for: what tells two distinct minima apart.
_NOTHING_TO_GAIN = 1e-4
# First barrier parameter: a large one leads every start along the central path to one and the same minimum.
_CENTRAL_BARRIER = 1e-2


@dataclass(frozen=True, slots=True)
class Start:
    """One start of the optimiser: where it began, the cost it reached, whether it converged."""

    origin: str
    cost: float
    converged: bool


@dataclass(frozen=True, slots=True)
class Certificate:
    """What is proven about a solution of program (10).

    cost: of the set returned; least_squares_cost: of (9), without rules; lower_bound: of any set that meets the rules;
    gap: (cost − lower_bound) / least_squares_cost, which bounds what a better optimiser could still gain.
    consistent_cost: of the pseudo-inertia program (full physical consistency, without the rules of (10d)).
    fully_consistent: whether all links' pseudo-inertias are positive definite, which (10d) does not ask for;
    smallest_pseudo_inertia_eigenvalue: of theirs. feasible: every rule of (10b)–(10d) holds, compared exactly; no other
    set is returned.
    """

    cost: float
    least_squares_cost: float
    lower_bound: float
    gap: float
    consistent_cost: float
    fully_consistent: bool
    smallest_pseudo_inertia_eigenvalue: float
    feasible: bool = True

    def to_json(self) -> dict[str, object]:
        """The certificate as it stands in model.json; costs are weighted sums of squared residuals."""
        return {"feasible": self.feasible, **plain(self)}


@dataclass(frozen=True, slots=True, eq=False)
class ConstrainedResult:
    """Solution of program (10).

    physical: μ. base_values: (p,) its base parameters. full: (full,) its dynamic parameters in the order of
    full_names, with rotor inertias and offsets where chosen. starts: all, the best first. rules: those asked for.
    """

    physical: PhysicalParameters
    base_values: FloatArray
    full: FloatArray
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

    starts: how many at most; the first from the pseudo-inertia program, the second from the convex relaxation, the
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
    typical = program.variables_of(consistent.full)
    begins = islice(_begins(program, typical, relaxation.start, seed), max(starts, 1))
    # With full consistency the bound is that of another program, whose cuts want several minima to begin from.
    ends = _ends(program, begins, None if full_consistency else relaxation.lower_bound)
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
        fully_consistent=smallest > 0.0,
        smallest_pseudo_inertia_eigenvalue=smallest,
    )
    return ConstrainedResult(
        physical=physical,
        base_values=base_values,
        full=full,
        starts=tuple(Start(origin, program.cost(end.point), end.converged) for origin, end in ends),
        certificate=certificate,
        rules=chosen,
    )


def _begins(
    program: ConstrainedProgram, typical: FloatArray, relaxed: FloatArray, seed: int
) -> Iterator[tuple[str, FloatArray, float]]:
    """Starts without end: what each is called, its point inside the rules, its first barrier parameter."""
    yield "pseudo-inertia program", program.inside(typical), _CENTRAL_BARRIER
    yield "convex relaxation", program.inside(relaxed), LOCAL_BARRIER
    generator = np.random.default_rng(seed)
    for number in count(1):
        yield f"random {number}, seed {seed}", program.random_point(generator, typical), LOCAL_BARRIER


def _ends(
    program: ConstrainedProgram, begins: Iterable[tuple[str, FloatArray, float]], lower_bound: float | None
) -> list[tuple[str, InteriorPointResult]]:
    """Where the starts end, best first: all, or as many as it takes to know that no more are needed.

    begins: as of `_begins`. lower_bound: of the cost, None if unknown.
    """
    ends: list[tuple[str, InteriorPointResult]] = []
    for origin, point, barrier in begins:
        end = program.solve_from(point, barrier)
        ends.append((origin, end))
        if len(ends) == _AGREEING_STARTS and _agree([each for _, each in ends]):
            break
        if lower_bound is None or not end.converged:
            continue
        if (program.cost(end.point) - lower_bound) / program.scale <= _NOTHING_TO_GAIN:
            break
    return sorted(ends, key=lambda each: each[1].value)


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
