"""Nonlinear parameters of one effect, refined beside everything else that is fitted.

Golden section per parameter, in turns, then all together; base parameters and coefficients are fitted anew at every
point.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Effect, Place, ShapeParameter
from identification.mismatch.problem import Problem, spread
from identification.mismatch.search.library import EffectRows, Library
from identification.mismatch.search.screening import coefficients_of, group_gain
from identification.mismatch.settings import ALTERNATIVE

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
STEPS = 12
# Score below the top of the parabola through three points at which these steps end: a tenth of a standard deviation.
NEAR_TOP = 0.005
ROUNDS = 2
JOINT_STEPS = 8
# Step of a derivative, as a share of the parameter (of its range where that is linear); gain that ends a refinement.
SLOPE = 1e-3
WORTH_IT = 0.05
# Score from which an effect in its textbook form is a serious candidate, so that freer forms are tried.
LEAST_TO_FREE = 5.0
# Turns in which a nonlinear parameter that equals the coefficient is found, and the least step, as a share of it.
TURNS, NEARLY = 4, 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """An effect as it stands in a model: rows of all its columns."""

    rows: EffectRows

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.rows.effect

    @property
    def place(self) -> Place:
        """Where it sits."""
        return self.rows.place

    @property
    def shape(self) -> Mapping[str, float]:
        """Its nonlinear parameters."""
        return dict(self.rows.shape)


def columns_of(problem: Problem, members: Sequence[Member]) -> FloatArray:
    """(n R, m) whitened columns of some members, one beside the other."""
    columns = [spread(problem, item.rows.joints, item.rows.rows) for item in members]
    return np.concatenate(columns, axis=1) if columns else np.zeros((problem.torque.size, 0))


def gram_of(problem: Problem, member: Member) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gram matrix off the basis, product with the residual, and square lengths before, of a member's columns."""
    return gram_of_rows(problem, member.rows.joints, member.rows.rows)


def gram_of_rows(
    problem: Problem, touched: tuple[int, ...], values: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`gram_of` for rows (len(touched), R, m) of any columns."""
    joints, count = list(touched), values.shape[2]
    columns = problem.whitened(values, joints).reshape(-1, count)
    rows = problem.rows
    # Joints are in order: those of one or of all stand together, and their rows are not copied.
    together = joints[-1] - joints[0] + 1 == len(joints)
    chosen = slice(joints[0], joints[-1] + 1) if together else joints
    basis = problem.basis.reshape(problem.n, rows, -1)[chosen].reshape(len(joints) * rows, -1)
    residual = problem.residual.reshape(problem.n, rows)[chosen].ravel()
    shadow = basis.T @ columns
    plain = columns.T @ columns
    return plain - shadow.T @ shadow, columns.T @ residual, np.diag(plain).copy()


def score_of(problem: Problem, member: Member) -> float:
    """Half the drop of the whitened squares by a member, less the cost of further coefficients and of its shape."""
    gram, target, raw = gram_of(problem, member)
    gain, used = group_gain(gram, target, raw)
    if member.effect.one_sided and target.size == 1 and target[0] < 0.0:
        gain = 0.0
    return 0.5 * gain - ALTERNATIVE * max(used - 1, 0) - member.rows.cost


def estimate_of(problem: Problem, member: Member) -> tuple[FloatArray, FloatArray]:
    """Coefficients of the columns beside all that is fitted, and their inverse Gram matrix."""
    return coefficients_of(*gram_of(problem, member))


def refine(problem: Problem, library: Library, member: Member) -> Member:
    """The member with nonlinear parameters that gain most, within their bounds, near where they are.

    Parameters with a textbook value first stand at it; then they are freed, and stay so if that gains more than it
    costs.
    """
    parameters = list(member.effect.shape_parameters(library.evidences[0].motion, member.place))
    if not parameters:
        return member
    held = {item.name: item.textbook for item in parameters if item.textbook is not None}
    if not held:
        return _refined(problem, library, member, parameters)
    _, plain = _moved(problem, library, member, held)
    plain = member if plain is None else plain
    best = _refined(problem, library, plain, [item for item in parameters if item.name not in held])
    if score_of(problem, best) < LEAST_TO_FREE:
        return best
    starts = [best] if all(member.shape[name] == value for name, value in held.items()) else [best, member]
    freed = [_refined(problem, library, start, parameters) for start in starts]
    return max(best, *freed, key=lambda item: score_of(problem, item))


def _refined(problem: Problem, library: Library, member: Member, parameters: Sequence[ShapeParameter]) -> Member:
    tied = [parameter for parameter in parameters if parameter.tied]
    if tied:
        member = _followed(problem, library, member, tied)
    parameters = [parameter for parameter in parameters if not parameter.tied]
    if not parameters:
        return member
    best, best_score = member, score_of(problem, member)
    for _ in range(ROUNDS if len(parameters) > 1 else 1):
        before = best_score
        for parameter in parameters:
            score, moved = _best_near(problem, library, best, parameter)
            if moved is not None and score > best_score:
                best, best_score = moved, score
        if best_score - before < WORTH_IT:
            break
    free = [item for item in parameters if not item.integer and best.shape[item.name] != item.textbook]
    best = _together(problem, library, best, best_score, free)
    return _followed(problem, library, best, tied) if tied else best


def _followed(problem: Problem, library: Library, member: Member, parameters: Sequence[ShapeParameter]) -> Member:
    """The member whose nonlinear parameters equal its coefficient c, at the c that leaves least.

    Gauss-Newton on c times the columns at c, whose slope is that of the last two. Setting c to its own estimate again
    and again ends there too, but hardly moves where the columns at any c ask for nearly that c: a spring's take what is
    not the link's motion wholly away.
    """
    joints, bounds = member.rows.joints, parameters[0]
    (value,), _ = estimate_of(problem, member)
    visited: list[tuple[float, Member]] = []
    before = member.shape[bounds.name], member
    for _ in range(TURNS):
        value = min(max(float(value), bounds.lower), bounds.upper)
        known, beside = before
        if abs(value - known) <= NEARLY * abs(known):
            if visited:
                break
            value = known * (1.0 + NEARLY) if known else NEARLY * bounds.upper
        _, moved = _moved(problem, library, member, {item.name: value for item in parameters})
        if moved is None:
            break
        rows = moved.rows.rows
        slope = rows + value * (rows - beside.rows.rows) / (value - known)
        gram, product, _ = gram_of_rows(problem, joints, np.concatenate([rows, slope], axis=2))
        visited.append((float(value * (2.0 * product[0] - value * gram[0, 0])), moved))
        before, value = (value, moved), value + (product[1] - value * gram[0, 1]) / max(gram[1, 1], 1e-300)
    return max(visited, key=lambda item: item[0])[1] if visited else member


def _together(
    problem: Problem, library: Library, member: Member, score: float, free: Sequence[ShapeParameter]
) -> Member:
    """All continuous parameters at once by Gauss-Newton: a Stribeck velocity and its exponent form a narrow valley.

    Derivatives of the effect's torque by its nonlinear parameters stand beside its columns as further columns.
    """
    for _ in range(JOINT_STEPS if len(free) > 1 else 0):
        coefficients, _ = estimate_of(problem, member)
        slopes = []
        for parameter in free:
            value = member.shape[parameter.name]
            step = SLOPE * (value if parameter.logarithmic else parameter.upper - parameter.lower)
            step = -step if value + step > parameter.upper else step
            _, beside = _moved(problem, library, member, {parameter.name: value + step})
            if beside is None:
                return member
            slopes.append((beside.rows.rows - member.rows.rows) @ coefficients / step)
        columns = np.concatenate([member.rows.rows, np.stack(slopes, axis=2)], axis=2)
        change = coefficients_of(*gram_of_rows(problem, member.rows.joints, columns))[0][coefficients.size :]
        for share in (1.0, 0.5, 0.2, 0.05):
            wanted = {
                parameter.name: min(max(member.shape[parameter.name] + share * by, parameter.lower), parameter.upper)
                for parameter, by in zip(free, change, strict=True)
            }
            better, moved = _moved(problem, library, member, wanted)
            if moved is not None and better > score:
                break
        else:
            return member
        gained, member, score = better - score, moved, better
        if gained < WORTH_IT:
            return member
    return member


def _moved(
    problem: Problem, library: Library, member: Member, values: Mapping[str, float]
) -> tuple[float, Member | None]:
    """The member with some nonlinear parameters set to these values, and its score."""
    shape = tuple((key, values.get(key, old)) for key, old in member.rows.shape)
    rows = library.rows(member.effect, member.place, shape)
    if rows is None:
        return -math.inf, None
    moved = Member(rows)
    return score_of(problem, moved), moved


def _best_near(
    problem: Problem, library: Library, member: Member, parameter: ShapeParameter
) -> tuple[float, Member | None]:
    """The best value between the neighbours of the member's own (`apart`, on the parameter's grid, or its bounds)."""
    value = member.shape[parameter.name]

    def at(other: float) -> tuple[float, Member | None]:
        return _moved(problem, library, member, {parameter.name: other})

    forward, backward = (math.log, math.exp) if parameter.logarithmic else (float, float)
    below = [point for point in parameter.grid if point < value * (1.0 - 1e-9)]
    above = [point for point in parameter.grid if point > value * (1.0 + 1e-9)]
    lower = value - parameter.apart if parameter.apart else max(below, default=parameter.lower)
    upper = value + parameter.apart if parameter.apart else min(above, default=parameter.upper)
    if parameter.integer:
        points = range(math.ceil(lower), math.floor(upper) + 1)
        return max((at(float(point)) for point in points), key=lambda item: item[0], default=(-math.inf, None))
    left, right = forward(max(lower, parameter.lower)), forward(min(upper, parameter.upper))
    inner, outer = right - GOLDEN * (right - left), left + GOLDEN * (right - left)
    first, second = at(backward(inner)), at(backward(outer))
    best = max(first, second, key=lambda item: item[0])
    at_left = at_right = -math.inf
    for _ in range(STEPS):
        if first[0] >= second[0]:
            right, at_right, outer, second = outer, second[0], inner, first
            inner = right - GOLDEN * (right - left)
            first = at(backward(inner))
        else:
            left, at_left, inner, first = inner, first[0], outer, second
            outer = left + GOLDEN * (right - left)
            second = at(backward(outer))
        best = max(best, first, second, key=lambda item: item[0])
        if first[0] >= second[0]:
            rest = _rest_to_top((left, inner, outer), (at_left, first[0], second[0]))
        else:
            rest = _rest_to_top((inner, outer, right), (first[0], second[0], at_right))
        if rest < NEAR_TOP:
            break
    return best


def _rest_to_top(places: tuple[float, float, float], scores: tuple[float, float, float]) -> float:
    """How much higher than the score in the middle the parabola through three ends; infinite where one is not known."""
    if not all(map(math.isfinite, scores)):
        return math.inf
    before, after = places[1] - places[0], places[2] - places[1]
    rise, fall = (scores[1] - scores[0]) / before, (scores[1] - scores[2]) / after
    bend = (rise + fall) / (before + after)
    slope = (rise * after - fall * before) / (before + after)
    return slope**2 / (4.0 * bend) if bend > 0.0 else math.inf
