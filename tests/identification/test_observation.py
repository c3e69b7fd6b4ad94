"""The observation of a motion without its tall matrix. Truth: numpy's least squares on that matrix."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import EstimationError, UndeterminedParametersError
from identification.estimators.least_squares import solve_least_squares
from identification.estimators.observation import CompressedObservation, Observation, compress, compress_joints
from identification.robots import RobotModel, robot_from_arrays

FloatArray = np.ndarray
Motion = tuple[FloatArray, FloatArray, FloatArray]


def products(compressed: CompressedObservation) -> FloatArray:
    """[Y_b τ]ᵀ[Y_b τ] per joint."""
    return compressed.blocks.transpose(0, 2, 1) @ compressed.blocks


def noisy_torque(base: BaseRegressor, motion: Motion, noise: float) -> FloatArray:
    generator = np.random.default_rng(21)
    torque = base.matrix(*motion) @ generator.normal(size=base.size)
    return torque + noise * generator.normal(size=torque.shape)


def by_joints(base: BaseRegressor, motion: Motion, torque: FloatArray) -> CompressedObservation:
    """The motion compressed as a fit does it, from the columns of each joint."""
    joints = zip(base.joint_columns(*motion), torque.T, strict=True)
    return compress_joints([(columns, used, measured) for (columns, used), measured in joints], base.names)


@pytest.mark.parametrize("noise", [0.1, 0.0], ids=["noisy", "exact"])
def test_a_motion_compressed_by_joints_equals_its_tall_matrix_compressed(
    iiwa14: RobotModel, rich_motion: Callable[..., Motion], noise: float
) -> None:
    base = BaseRegressor(iiwa14, RegressorOptions(rotor_inertia=True, offset=True))
    motion = rich_motion(iiwa14, 5501)  # three chunks, the last one short
    torque = noisy_torque(base, motion, noise)
    matrix, joint = base.stacked(*motion)
    whole = compress(Observation(matrix, torque.T.ravel(), joint, base.names))
    parts = by_joints(base, motion, torque)
    np.testing.assert_array_equal(parts.counts, whole.counts)
    scale = np.abs(products(whole)).max()
    np.testing.assert_allclose(products(parts), products(whole), rtol=0.0, atol=1e-13 * scale)


def test_fit_by_joints_equals_numpys_least_squares(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, rich_motion: Callable[..., Motion]
) -> None:
    motion = rich_motion(iiwa14, 3000)
    torque = noisy_torque(iiwa14_base, motion, 0.3)
    expected = np.linalg.lstsq(iiwa14_base.matrix(*motion).reshape(-1, 57), torque.ravel(), rcond=None)[0]
    fitted = solve_least_squares(by_joints(iiwa14_base, motion, torque), weighting="none")
    np.testing.assert_allclose(fitted.values, expected, rtol=0.0, atol=1e-9)


def test_an_ill_conditioned_motion_fits_the_torque_that_the_tall_matrix_fits(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, rich_motion: Callable[..., Motion]
) -> None:
    q, dq, ddq = (0.002 * values for values in rich_motion(iiwa14, 3000))  # one posture, hardly left
    torque = noisy_torque(iiwa14_base, (q, dq, ddq), 1e-3)
    compressed = by_joints(iiwa14_base, (q, dq, ddq), torque)
    matrix = iiwa14_base.matrix(q, dq, ddq).reshape(-1, 57)
    scale = np.linalg.norm(matrix, axis=0)
    assert np.linalg.cond(matrix / scale) > 1e5
    expected = matrix @ (np.linalg.lstsq(matrix / scale, torque.ravel(), rcond=None)[0] / scale)
    np.testing.assert_allclose(matrix @ compressed.reduced().minimiser(), expected, rtol=0.0, atol=1e-9)


def test_a_prismatic_robot_is_compressed_alike(rich_motion: Callable[..., Motion]) -> None:
    robot = robot_from_arrays(
        np.array([[0.0, 0.0, 0.0, 0.2], [1.3, 0.1, 0.4, 0.0], [-0.7, 0.2, 0.1, 0.3]]),
        revolute=np.array([True, False, True]),
    )
    base = BaseRegressor(robot)
    motion = rich_motion(robot, 2500)
    torque = noisy_torque(base, motion, 0.2)
    expected = np.linalg.lstsq(base.matrix(*motion).reshape(-1, base.size), torque.ravel(), rcond=None)[0]
    fitted = by_joints(base, motion, torque).reduced().minimiser()
    np.testing.assert_allclose(fitted, expected, rtol=0.0, atol=1e-9 * max(1.0, np.abs(expected).max()))


def test_a_robot_at_rest_does_not_determine_its_parameters(iiwa14: RobotModel, iiwa14_base: BaseRegressor) -> None:
    still = np.zeros((100, 7))
    with pytest.raises(UndeterminedParametersError):
        by_joints(iiwa14_base, (still + 0.3, still, still), still).reduced()


def test_numbers_that_are_not_finite_are_named_with_their_place(iiwa14_base: BaseRegressor) -> None:
    matrix, torque = np.ones((140, 57)), np.ones(140)
    torque[73] = np.nan
    with pytest.raises(EstimationError, match=r"not finite, .* row 74 \(joint 4\)"):
        Observation(matrix, torque, np.repeat(np.arange(7), 20), iiwa14_base.names)
