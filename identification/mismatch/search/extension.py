"""The nominal model extended by effects: base parameters and coefficients fitted together, with their covariance.

Also what that model predicts elsewhere, in Nm per row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, ShapeParameter
from identification.mismatch.problem import Problem, off, spread
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member, columns_of
from identification.mismatch.settings import ROUNDING

# Relative step of a nonlinear parameter for the derivative of its columns.
SHAPE_STEP = 1e-2
# Directions of the base parameters below this share of the best determined one count as open.
OPEN = 1e-7
# Information on a parameter, in its own unit, below which it counts as open.
LEAST_INFORMATION = 1e-12
# Degrees of freedom of a noise estimate below which its possible values have no mean to speak of.
FEWEST_FREEDOM = 4.0
# Blocks of neighbouring lines per joint whose products with the residual are taken as independent.
BLOCKS = 24


@dataclass(frozen=True, slots=True, eq=False)
class Extension:
    """Base parameters (p,), coefficients of each member, covariance of all.

    covariance: (p + Σ m, ·) of base parameters and coefficients, from the noise. loose: (p, p) factor L whose
    product L Lᵀ is the covariance of the base parameters alone, directions the motion leaves open with a huge one.
    problem: the nominal one it was fitted to.
    """

    members: tuple[Member, ...]
    base: FloatArray
    coefficients: tuple[FloatArray, ...]
    covariance: FloatArray
    loose: FloatArray
    problem: Problem


def extend(nominal: Problem, members: Sequence[Member]) -> Extension:
    """Fit base parameters and members to the measured rows; directions the motion leaves open stay at zero."""
    size = nominal.nominal.shape[2]
    factor, triangle, scale, loose = nominal_factor(nominal)
    added = columns_of(nominal, members)
    norms = np.concatenate([scale, np.maximum(np.linalg.norm(added, axis=0), 1e-300)])
    # QR of all columns, that of the nominal ones given; its triangle has their singular values.
    added = added / norms[size:]
    shared = factor.T @ added
    further, own = np.linalg.qr(off(factor, added))
    corner = np.zeros((own.shape[0], size))
    left, singular, right = np.linalg.svd(np.block([[triangle, shared], [corner, own]]))
    kept = singular > OPEN * singular[0]
    inverse = (right[kept].T / singular[kept]) / norms[:, None]
    target = np.concatenate([factor.T @ nominal.torque, further.T @ nominal.torque])
    solution = inverse @ (left[:, kept].T @ target)
    coefficients, position = [], size
    for member in members:
        coefficients.append(solution[position : position + member.rows.coefficients])
        position += member.rows.coefficients
    return Extension(tuple(members), solution[:size], tuple(coefficients), inverse @ inverse.T, loose, nominal)


@lru_cache(maxsize=4)
def nominal_factor(nominal: Problem) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Q, R and lengths of the whitened nominal columns, and `Extension.loose`; dozens of sets share one problem."""
    plain = nominal.whitened(nominal.nominal, range(nominal.n)).reshape(nominal.torque.size, -1)
    norms = np.linalg.norm(plain, axis=0)
    norms = np.maximum(norms, ROUNDING * norms.max())
    factor, triangle = np.linalg.qr(plain / norms)
    _, singular, right = np.linalg.svd(triangle)
    loose = right.T / np.maximum(singular, OPEN * singular[0]) / norms[:, None]
    return factor, triangle, norms, loose


def predicted(extension: Extension, nominal: FloatArray, library: Library) -> FloatArray:
    """Torque rows (n, R) Nm of the extended model on the evidences of a library; nominal: (n, R, p) rows there.

    Nuisances of the fitted recordings, which stand behind the base parameters, have no part there.
    """
    result = np.asarray(nominal @ extension.base[: nominal.shape[2]], dtype=np.float64)
    for member, coefficients in zip(extension.members, extension.coefficients, strict=True):
        rows = library.rows(member.effect, member.place, member.rows.shape)
        if rows is not None:
            result[list(rows.joints)] += rows.rows @ coefficients
    return result


def torque_beside(extension: Extension, library: Library, torque: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    """Torque (R, n) Nm of each evidence of a library without that of the members; base parameters stay in it."""
    nominal = np.concatenate([item.nominal for item in library.evidences]).transpose(1, 0, 2)
    taken = predicted(replace(extension, base=np.zeros(nominal.shape[2])), nominal, library).T
    cuts = np.cumsum([len(rows) for rows in torque])[:-1]
    return tuple(rows - part for rows, part in zip(torque, np.split(taken, cuts), strict=True))


def prediction_scatter(extension: Extension, nominal: FloatArray, library: Library) -> FloatArray:
    """Torque (n, R, m) Nm per independent unit of scatter of the coefficients, with what they drag along of the base.

    Squares summed over the last axis, and over that of `nominal @ loose`, which is the scatter of the base parameters
    at fixed coefficients with the open directions of the fitted motion, are the variance of `predicted` through the
    parameters.
    """
    joints, rows, size = nominal.shape
    count = extension.covariance.shape[0] - extension.base.size
    if not count:
        return np.zeros((joints, rows, 0))
    columns = np.zeros((joints, rows, count))
    position = 0
    for member in extension.members:
        there = library.rows(member.effect, member.place, member.rows.shape)
        own = slice(position, position + member.rows.coefficients)
        if there is not None:
            columns[list(there.joints), :, own] = there.rows
        position += member.rows.coefficients
    among = extension.covariance[extension.base.size :, extension.base.size :]
    shared = extension.covariance[:size, extension.base.size :]
    values, vectors = np.linalg.eigh(among)
    kept = values > 1e-12 * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    drag = shared @ (vectors[:, kept] / np.sqrt(values[kept]))
    return np.asarray(columns @ root + nominal @ drag, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Of one member: covariance of its coefficients, deviations of its shape and their covariance (m,) with
    these.
    """

    covariance: FloatArray
    shape_std: dict[str, float]
    shape_covariance: dict[str, FloatArray]

    def estimate(self, member: Member, coefficients: FloatArray) -> Estimate:
        """What the member's effect describes itself by."""
        return Estimate(
            member.place, member.shape, coefficients, self.covariance, self.shape_std, self.shape_covariance
        )


def uncertainties(
    nominal: Problem, extension: Extension, residual: FloatArray, library: Library, *, coloured: bool
) -> tuple[Uncertainty, ...]:
    """Uncertainty of every member, coefficients and nonlinear parameters of all of them together.

    The noise is estimated: each line counts with the mean of what its variance may be, ν / (ν - 2) times the estimate
    of ν degrees of freedom. coloured: the residual is not noise alone. Then the covariance is built from the residual
    itself: products of columns and residual summed over blocks of neighbouring lines, whatever the colour within a
    block (the sandwich with clusters, Liang and Zeger 1986), and never below that of the noise. Of a nonlinear
    parameter the data say nothing beyond its bounds; a direction that they leave open comes out as wide as that.
    """
    columns, labels, ranges = _tangents(nominal, extension, library)
    if not labels:
        return ()
    columns = off(nominal.basis, columns)
    information = columns.T @ columns + np.diag(12.0 / ranges**2)
    scale = np.sqrt(np.maximum(np.diag(information), LEAST_INFORMATION))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, OPEN**2 * values[-1])) @ vectors.T / np.outer(scale, scale)
    freedom = np.maximum(nominal.freedom, FEWEST_FREEDOM)
    inflated = columns * np.sqrt(2.0 / (freedom - 2.0)).ravel()[:, None]
    covariance = inverse + inverse @ (inflated.T @ inflated) @ inverse
    if coloured:
        covariance = no_narrower(inverse @ _block_products(nominal, columns, residual) @ inverse, covariance)
    result = []
    for index in range(len(extension.members)):
        own = [position for position, label in enumerate(labels) if label[0] == index and isinstance(label[1], int)]
        shape, together = dict[str, float](), dict[str, FloatArray]()
        for position, (of_member, name) in enumerate(labels):
            if of_member == index and isinstance(name, str):
                shape[name] = float(np.sqrt(max(covariance[position, position], 0.0)))
                together[name] = covariance[position, own]
        result.append(Uncertainty(covariance[np.ix_(own, own)], shape, together))
    return tuple(result)


def no_narrower(covariance: FloatArray, least: FloatArray) -> FloatArray:
    """A covariance (m, m) with its correlations and no deviation below that of another one.

    What it gives no variance at all has that of the other, correlated with nothing.
    """
    own, wanted = np.diag(covariance), np.diag(least)
    wider = np.sqrt(np.maximum(np.divide(wanted, own, out=np.zeros_like(own), where=own > 0.0), 1.0))
    result = covariance * wider * wider[:, None]
    none = own <= 0.0
    result[none], result[:, none] = 0.0, 0.0
    result[none, none] = wanted[none]
    return np.asarray(result)


def _tangents(
    nominal: Problem, extension: Extension, library: Library
) -> tuple[FloatArray, list[tuple[int, int | str]], FloatArray]:
    """Whitened columns of all coefficients and nonlinear parameters at the estimate, what each belongs to, its range.

    The range is infinite for coefficients. A parameter tied to a coefficient bends that one's column.
    """
    columns: list[FloatArray] = []
    labels: list[tuple[int, int | str]] = []
    ranges: list[float] = []
    motion = library.evidences[0].motion
    for index, (member, coefficients) in enumerate(zip(extension.members, extension.coefficients, strict=True)):
        own = member.rows.rows
        beside: list[FloatArray] = []
        names: list[tuple[int, int | str]] = []
        widths: list[float] = []
        for parameter in member.effect.shape_parameters(motion, member.place):
            # What stands at the textbook's value was not estimated; counted as if, it would widen all the others.
            given = parameter.integer or member.shape[parameter.name] == parameter.textbook
            slope = None if given else _slope(member, parameter, library, coefficients)
            if slope is None:
                continue
            if parameter.tied:
                own = own + slope[..., None]
                continue
            beside.append(slope)
            names.append((index, parameter.name))
            upper, lower = parameter.upper, parameter.lower
            width = member.shape[parameter.name] * np.log(upper / lower) if parameter.logarithmic else upper - lower
            widths.append(float(width))
        columns.append(spread(nominal, member.rows.joints, np.concatenate([own, *(s[..., None] for s in beside)], 2)))
        count = member.rows.coefficients
        labels.extend([*((index, column) for column in range(count)), *names])
        ranges.extend([*(count * [np.inf]), *widths])
    return (np.concatenate(columns, axis=1) if columns else np.zeros((0, 0))), labels, np.array(ranges)


def _slope(member: Member, parameter: ShapeParameter, library: Library, coefficients: FloatArray) -> FloatArray | None:
    """Derivative of the member's torque rows by one nonlinear parameter, (len(joints), R)."""
    value = member.shape[parameter.name]
    step = SHAPE_STEP * (abs(value) if parameter.logarithmic else parameter.upper - parameter.lower)
    high, low = min(value + step, parameter.upper), max(value - step, parameter.lower)
    ends = []
    for place in (high, low):
        shape = tuple((name, place if name == parameter.name else old) for name, old in member.rows.shape)
        ends.append(library.rows(member.effect, member.place, shape))
    if ends[0] is None or ends[1] is None or high <= low:
        return None
    return np.asarray((ends[0].rows - ends[1].rows) @ coefficients / (high - low), dtype=np.float64)


def _block_products(problem: Problem, columns: FloatArray, residual: FloatArray) -> FloatArray:
    """Σ u uᵀ over blocks, u = columnsᵀ residual within a block of lines of one joint."""
    edges = np.unique(np.round(np.geomspace(1.0, max(2, problem.rows), BLOCKS + 1)).astype(int)) - 1
    order = np.lexsort((problem.frequency, problem.evidence))
    product = (columns * residual[:, None]).reshape(problem.n, problem.rows, -1)[:, order]
    sums = np.add.reduceat(product, edges[:-1], axis=1).reshape(-1, columns.shape[1])
    count, size = sums.shape[0], columns.shape[1]
    return np.asarray(sums.T @ sums * count / max(count - size, 1), dtype=np.float64)
