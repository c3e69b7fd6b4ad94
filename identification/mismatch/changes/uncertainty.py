"""How much less certain the size of a change is because its times and its profile are estimated along with it.

Not here: the noise's own part, which the fit at fixed nonlinear parameters gives.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.changes.contrasts import Contrasts, solve
from identification.mismatch.effects.base import Place
from identification.mismatch.effects.enveloped import EnvelopedEffect
from identification.mismatch.search.extension import SHAPE_STEP

# Step of a derivative by a time, as a share of its range.
LINEAR_STEP = 1e-4


def shape_covariance(
    contrasts: Contrasts,
    effect: EnvelopedEffect,
    place: Place,
    shape: Mapping[str, float],
    coefficients: FloatArray,
    fitted: slice = slice(None),
) -> FloatArray:
    """Covariance (m, m) that the nonlinear parameters add to that of the coefficients, in units of white noise of one.

    fitted: columns of the effect that the coefficients (m,) belong to.

    First order: with the derivatives S of the torque by the nonlinear parameters beside the columns C, the
    coefficients move by (CᵀC)⁻¹CᵀS per unit of those. A parameter is no less certain than evenly within its bounds.
    """
    joints, rows = contrasts.rows(effect, place, shape)
    columns = contrasts.whiten(rows[..., fitted], joints).reshape(-1, coefficients.size)
    slopes, information = [], []
    for parameter in effect.shape_parameters(contrasts.motion, place):
        if parameter.integer or parameter.name not in shape:
            continue
        value, width = shape[parameter.name], parameter.upper - parameter.lower
        step = SHAPE_STEP * value if parameter.logarithmic else LINEAR_STEP * width
        ends = (min(value + step, parameter.upper), max(value - step, parameter.lower))
        if ends[0] <= ends[1]:
            continue
        high, low = (contrasts.rows(effect, place, {**shape, parameter.name: end})[1][..., fitted] for end in ends)
        slope = ((high - low) @ coefficients / (ends[0] - ends[1]))[..., None]
        slopes.append(contrasts.whiten(slope, joints).reshape(-1))
        information.append(12.0 / width**2)
    if not slopes:
        return np.zeros((coefficients.size, coefficients.size))
    tangent = np.stack(slopes, axis=1)
    shared = columns.T @ tangent
    inverse = solve(columns.T @ columns, shared[:, 0])[1]
    left = tangent.T @ tangent - shared.T @ inverse @ shared + np.diag(information)
    moved = inverse @ shared
    return np.asarray(moved @ np.linalg.solve(left, moved.T), dtype=np.float64)
