"""Least squares (9) and its uncertainty (15). Truth: numpy's SVD solver, known parameters, Monte Carlo scatter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import EstimationError, UndeterminedParametersError
from identification.estimators.least_squares import solve_least_squares
from identification.estimators.observation import Observation, compress, merge
from identification.fitting.blocks import shortest_solution
from identification.robots import RobotModel, robot_from_arrays


def linear_problem(seed: int, rows: int = 600, size: int = 8, joints: int = 3) -> Observation:
    generator = np.random.default_rng(seed)
    matrix = generator.normal(size=(rows, size))
    joint = np.arange(rows) % joints
    matrix[joint == 2, :4] = 0.0  # a distal joint does not feel the parameters of the first links
    noise = np.array([1.0, 0.1, 0.01])[joint] * generator.normal(size=rows)
    torque = matrix @ np.arange(1.0, size + 1.0) + noise
    return Observation(matrix, torque, joint, tuple(f"P_{column}" for column in range(size)))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_plain_solution_and_its_deviation_are_the_textbooks(seed: int) -> None:
    observation = linear_problem(seed)
    result = solve_least_squares(observation, weighting="none")
    values, square, *_ = np.linalg.lstsq(observation.matrix, observation.torque, rcond=None)
    np.testing.assert_allclose(result.values, values, rtol=1e-10)
    assert result.cost == pytest.approx(float(square[0]), rel=1e-9)
    inverse = np.linalg.inv(observation.matrix.T @ observation.matrix)
    covariance = square[0] / (600 - 8) * inverse  # eq. (15)
    np.testing.assert_allclose(result.covariance, covariance, rtol=1e-8, atol=1e-12 * np.abs(covariance).max())
    singular = np.linalg.svd(observation.matrix, compute_uv=False)
    assert result.condition_number == pytest.approx(singular[0] / singular[-1], rel=1e-9)


def test_weights_are_the_inverse_residual_variances_and_the_solution_is_numpys() -> None:
    observation = linear_problem(1, rows=30000)
    result = solve_least_squares(observation)
    np.testing.assert_allclose(1.0 / np.sqrt(result.weights), [1.0, 0.1, 0.01], rtol=0.05)
    root = np.sqrt(result.weights)[observation.joint]
    values, *_ = np.linalg.lstsq(observation.matrix * root[:, None], observation.torque * root, rcond=None)
    np.testing.assert_allclose(result.values, values, rtol=1e-9)
    left = observation.torque - observation.matrix @ result.values
    rms = [np.sqrt(np.mean(left[observation.joint == joint] ** 2)) for joint in range(3)]
    np.testing.assert_allclose(rms, [1.0, 0.1, 0.01], rtol=0.05)


def test_weighted_deviations_match_the_scatter_of_many_fits() -> None:
    """200 noise draws: the scatter of each parameter over its stated σ is 1 within Monte Carlo error (±15 %)."""
    errors, stated = [], []
    for seed in range(200):
        observation = linear_problem(seed, rows=300)
        result = solve_least_squares(observation)
        errors.append(result.values - np.arange(1.0, 9.0))
        stated.append(result.std)
    ratio = np.sqrt(np.mean(np.square(np.array(errors) / np.array(stated)), axis=0))
    assert np.all((ratio > 0.8) & (ratio < 1.2)), ratio


def test_noise_free_iiwa_data_give_the_parameters_back(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table2: dict[str, float], rich_motion: Callable[..., tuple]
) -> None:
    truth = np.array(list(table2.values()))
    matrix, joint = iiwa14_base.stacked(*rich_motion(iiwa14))
    result = solve_least_squares(Observation(matrix, matrix @ truth, joint, iiwa14_base.names))
    np.testing.assert_allclose(result.values, truth, atol=1e-8)
    assert np.sqrt(np.mean((matrix @ (result.values - truth)) ** 2)) < 1e-10


@settings(max_examples=10, deadline=None)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_noise_free_data_of_any_robot_give_the_parameters_back(n: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    robot = robot_from_arrays(generator.uniform(-1.5, 1.5, (n, 4)), revolute=generator.random(n) < 0.7)
    base = BaseRegressor(robot, RegressorOptions(rotor_inertia=True, offset=True))
    q, dq, ddq = (generator.uniform(-2.0, 2.0, (300, n)) for _ in range(3))
    truth = generator.normal(size=base.size)
    matrix, joint = base.stacked(q, dq, ddq)
    result = solve_least_squares(Observation(matrix, matrix @ truth, joint, base.names))
    np.testing.assert_allclose(result.values, truth, atol=1e-8)


def test_a_joint_that_does_not_move_is_named(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, rich_motion: Callable[..., tuple]
) -> None:
    q, dq, ddq = rich_motion(iiwa14)
    for state in (q, dq, ddq):
        state[:, 6] = 0.0
    matrix, joint = iiwa14_base.stacked(q, dq, ddq)
    with pytest.raises(UndeterminedParametersError) as caught:
        solve_least_squares(Observation(matrix, matrix.sum(axis=1), joint, iiwa14_base.names))
    assert {"FV_7", "FS_7"} <= set(caught.value.parameters)
    assert "FV_1" not in caught.value.parameters
    assert caught.value.rank < 57
    assert "FV_7" in str(caught.value) or len(caught.value.parameters) > 12


def test_compressing_keeps_every_joints_residual() -> None:
    observation = linear_problem(5)
    values = np.linspace(0.5, 7.0, 8)
    residual = observation.torque - observation.matrix @ values
    expected = [np.sum(residual[observation.joint == joint] ** 2) for joint in range(3)]
    np.testing.assert_allclose(compress(observation).residual_squares(values), expected, rtol=1e-10)


@pytest.mark.parametrize("noise_free", [False, True])
def test_two_recordings_merged_equal_one_long_recording(noise_free: bool) -> None:
    whole = linear_problem(6, rows=900)
    torque = whole.matrix @ np.arange(8.0) if noise_free else whole.torque
    parts = [
        compress(Observation(whole.matrix[rows], torque[rows], whole.joint[rows], whole.names))
        for rows in (slice(0, 300), slice(300, 900))
    ]
    together = solve_least_squares(merge(parts))
    at_once = solve_least_squares(Observation(whole.matrix, torque, whole.joint, whole.names))
    np.testing.assert_allclose(together.values, at_once.values, atol=1e-9)
    np.testing.assert_allclose(whole.matrix @ together.values, whole.matrix @ at_once.values, atol=1e-9)


def test_row_order_does_not_matter() -> None:
    observation = linear_problem(7)
    order = np.random.default_rng(8).permutation(600)
    shuffled = Observation(
        observation.matrix[order], observation.torque[order], observation.joint[order], observation.names
    )
    np.testing.assert_allclose(solve_least_squares(shuffled).values, solve_least_squares(observation).values, rtol=1e-9)


def test_data_that_cannot_be_fitted_are_refused_with_their_place() -> None:
    good = linear_problem(9)
    torque = good.torque.copy()
    torque[17] = np.nan
    with pytest.raises(EstimationError, match="row 18"):
        Observation(good.matrix, torque, good.joint, good.names)
    with pytest.raises(EstimationError, match="longer motion"):
        Observation(good.matrix[:8], good.torque[:8], good.joint[:8], good.names)
    with pytest.raises(EstimationError, match="names"):
        Observation(good.matrix, good.torque, good.joint, good.names[:-1])


@pytest.mark.parametrize("weak", [1.0, 1e-3, 1e-7, 0.0])
def test_the_shortest_solution_has_nothing_along_what_the_rows_do_not_tell(weak: float) -> None:
    """Truth: the pseudo-inverse of the scaled columns, whose squares are the eigenvalues that the tolerance is of."""
    generator = np.random.default_rng(4)
    matrix = generator.normal(size=(200, 6)) * np.geomspace(1e-3, 1e3, 6)
    matrix[:, 5] = 10.0 * matrix[:, 4] + weak * matrix[:, 5]
    torque = generator.normal(size=200)
    norms = np.linalg.norm(matrix, axis=0)
    expected = np.linalg.pinv(matrix / norms, rcond=1e-5) @ torque / norms
    found = shortest_solution(matrix.T @ matrix, matrix.T @ torque, 1e-10)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
