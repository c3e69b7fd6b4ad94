"""Covariance of a weighted linear estimate when residuals are coloured and differ from joint to joint.

The estimate solves Σ w Yᵀ (τ − Y π) = 0. Whatever the weights w, its covariance is A⁻¹ V A⁻¹ with A = Σ w Yᵀ Y and
V = Σ w² Yᵀ S Y, where S is the true covariance of the rows; eq. (15) is what remains if S is one number. Here S is
diagonal over spectral lines, joint by joint: the noise between periods where a recording has periods, otherwise the
residual's own power averaged over neighbouring lines.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from identification.arrays import FloatArray
from identification.estimators.observation import ReducedProblem
from identification.fitting.blocks import Block, to_line_power, to_rows, variances_of
from identification.signals.periodic import to_lines
from identification.signals.periods import smooth_over_lines

# A line of which the fit takes up more than this share says nothing about the noise there.
_MOST_LEVERAGE = 0.8


def coloured_covariance(
    blocks: list[Block], values: FloatArray, reduced: ReducedProblem, joint_weights: FloatArray
) -> FloatArray:
    """(p, p) covariance of the estimate `values` that the blocks' scales and joint_weights (n,) lead to.

    reduced: the weighted problem, A = RᵀR. Stretches and joints count as independent of each other, the noise as
    stationary over a stretch. Weaker without periods: the noise is then judged from residuals of which the fit has
    already taken up a part (corrected line by line with the leverage), misfit of the model counts as noise, and so do
    its correlations between joints as none.
    """
    inverse = scipy.linalg.solve_triangular(reduced.triangular, np.eye(len(values)))
    # In coordinates in which the problem is a unit matrix: what a motion hardly determines is else lost in rounding,
    # down to variances below zero.
    middle = np.zeros_like(inverse)
    for block in blocks:
        if not block.fitted.any():
            continue
        residual = block.torque - block.columns @ values
        spectral = block.signals.row_time is None
        known = variances_of(block, residual) if spectral and block.signals.row_noise is not None else None
        for joint in range(residual.shape[1]):
            rows = block.columns[:, joint] * (block.fitted[:, joint] * block.scale[:, joint])[:, None]
            used = np.flatnonzero((rows != 0.0).any(axis=0))
            rows = rows[:, used] @ inverse[used] * np.sqrt(joint_weights[joint])
            errors = residual[:, joint] * block.fitted[:, joint] * block.scale[:, joint] * np.sqrt(joint_weights[joint])
            if known is not None:
                variance = known[:, joint] * block.scale[:, joint] ** 2 * joint_weights[joint]
            else:
                if not spectral:  # the same rows, line by line over the whole stretch
                    lines = (len(rows) - 1) // 2
                    rows, errors = to_lines(rows, lines), to_lines(errors, lines)
                variance = _variance_from_residual(errors, rows)
            middle += (rows * variance[:, None]).T @ rows
    return np.asarray(inverse @ middle @ inverse.T, dtype=np.float64)


def _variance_from_residual(errors: FloatArray, rows: FloatArray) -> FloatArray:
    """(R,) variance per row from the smoothed power of the errors, each line less what the fit took up of it.

    rows: (R, p) in coordinates in which the whole problem is a unit matrix.
    """
    leverage = np.einsum("ri,ri->r", rows, rows)
    freedom = to_line_power(np.sqrt(np.maximum(1.0 - leverage, 0.0))[:, None])
    power = to_line_power(errors[:, None])
    smooth, kept = smooth_over_lines(power), np.maximum(smooth_over_lines(freedom), 1.0 - _MOST_LEVERAGE)
    if len(smooth) > 1:  # line 0 has no neighbours of its own kind
        smooth[0], kept[0] = smooth[1], kept[1]
    return to_rows(smooth / kept)[:, 0]
