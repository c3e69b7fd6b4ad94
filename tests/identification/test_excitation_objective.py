"""Claims about the differentiable base regressor and the criteria; truth from Pinocchio and finite differences."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio
import pytest

from identification.base_parameters import BaseRegressor
from identification.errors import DesignError
from identification.excitation.fourier import FourierTrajectory, fourier_basis
from identification.excitation.objective import (
    CRITERIA,
    BaseMatrix,
    FourierObjective,
    achieved_figures,
    criterion_of,
    mixture_weights,
)
from identification.excitation.regressor_adjoint import ChainRegressor
from identification.robots import Kinematics, load_robot

FloatArray = npt.NDArray[np.float64]

PINOCCHIO_ORDER = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]
"""Position of (M, MX, MY, MZ, XX, XY, XZ, YY, YZ, ZZ) among Pinocchio's (m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz)."""

GRAVITY = np.array([0.3, -0.2, -9.81])


def _branching_robot() -> tuple[Kinematics, pinocchio.Model]:
    """Six joints, revolute and prismatic, about slanted axes, with a branch at link 2; gravity not along z."""
    generator = np.random.default_rng(7)
    parent = np.array([-1, 0, 1, 2, 1, 4])
    revolute = np.array([True, True, False, True, True, False])
    axis = generator.normal(size=(6, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    rotation = np.array([pinocchio.exp3(generator.normal(size=3)) for _ in range(6)])
    translation = generator.normal(size=(6, 3))
    model = pinocchio.Model()
    model.gravity.linear = GRAVITY
    for j in range(6):
        joint = (
            pinocchio.JointModelRevoluteUnaligned(axis[j])
            if revolute[j]
            else pinocchio.JointModelPrismaticUnaligned(axis[j])
        )
        model.addJoint(int(parent[j]) + 1, joint, pinocchio.SE3(rotation[j], translation[j]), f"joint{j + 1}")
    return Kinematics(parent, rotation, translation, axis, revolute), model


def test_regressor_equals_pinocchios_on_a_branching_robot() -> None:
    kinematics, model = _branching_robot()
    data = model.createData()
    chain = ChainRegressor(kinematics, GRAVITY)
    q, dq, ddq = np.random.default_rng(1).normal(size=(3, 8, 6))
    own = chain.matrix(chain.motion(q, dq, ddq))
    for s in range(8):
        true = pinocchio.computeJointTorqueRegressor(model, data, q[s], dq[s], ddq[s])
        true = true.reshape(6, 6, 10)[:, :, PINOCCHIO_ORDER].reshape(6, 60)
        np.testing.assert_allclose(own[s], true, atol=1e-11)


def test_gradient_of_any_weighting_equals_finite_differences() -> None:
    kinematics, _ = _branching_robot()
    chain = ChainRegressor(kinematics, GRAVITY)
    generator = np.random.default_rng(2)
    state = list(generator.normal(size=(3, 4, 6)))
    weights = generator.normal(size=(4, 6, 60))

    def value(arguments: list[FloatArray]) -> FloatArray:
        total: FloatArray = np.sum(chain.matrix(chain.motion(*arguments)) * weights, axis=(1, 2))
        return total

    exact = chain.gradient(chain.motion(*state), weights)
    step = 1e-6
    for kind in range(3):
        for joint in range(6):
            ahead, behind = [x.copy() for x in state], [x.copy() for x in state]
            ahead[kind][:, joint] += step
            behind[kind][:, joint] -= step
            difference = (value(ahead) - value(behind)) / (2 * step)
            np.testing.assert_allclose(exact[kind][:, joint], difference, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("criterion", [*sorted(CRITERIA), "cond:1,d:2", "cond,d:0.5,a"])
def test_gradient_in_the_coefficients_equals_finite_differences(criterion: str) -> None:
    base = BaseMatrix(load_robot("iiwa14"))
    objective = FourierObjective(base, criterion, 0.1, 5, 60)
    generator = np.random.default_rng(3)
    coefficients, offset = 0.3 * generator.normal(size=(7, 10)), 0.2 * generator.normal(size=7)
    _, gradient, by_offset = objective(coefficients, offset)
    step = 1e-6
    for _ in range(6):
        direction, shift = generator.normal(size=(7, 10)), generator.normal(size=7)
        ahead = objective(coefficients + step * direction, offset + step * shift)[0]
        behind = objective(coefficients - step * direction, offset - step * shift)[0]
        exact = np.sum(gradient * direction) + np.sum(by_offset * shift)
        assert exact == pytest.approx((ahead - behind) / (2 * step), rel=2e-5, abs=1e-5)


def test_columns_are_those_of_the_regressor_that_fits_use() -> None:
    robot = load_robot("iiwa14")
    base, fits = BaseMatrix(robot), BaseRegressor(robot)
    q, dq, ddq = np.random.default_rng(4).normal(size=(3, 30, 7))
    own = base.samples(q, dq, ddq, 1e-12).matrix.reshape(-1, base.size)
    used = fits.matrix(q, dq, ddq).reshape(-1, base.size)
    assert base.size == 57
    # The order of columns differs; sorted, the Gram matrices' diagonals and all singular values must agree.
    np.testing.assert_allclose(np.sort(np.sum(own**2, axis=0)), np.sort(np.sum(used**2, axis=0)), rtol=1e-10)
    np.testing.assert_allclose(
        np.linalg.svd(own, compute_uv=False), np.linalg.svd(used, compute_uv=False), rtol=1e-9, atol=1e-9
    )


def test_criteria_are_what_their_names_say() -> None:
    matrix = np.random.default_rng(5).normal(size=(40, 6)) * np.array([1.0, 2.0, 3.0, 0.5, 5.0, 0.1])
    gram = matrix.T @ matrix
    assert np.exp(CRITERIA["cond"](gram)[0]) == pytest.approx(np.linalg.cond(matrix), rel=1e-9)
    assert CRITERIA["d"](gram)[0] == pytest.approx(-np.linalg.slogdet(gram)[1], rel=1e-12)
    assert np.exp(CRITERIA["a"](gram)[0]) == pytest.approx(np.trace(np.linalg.inv(gram)), rel=1e-9)


def test_a_mix_adds_log_cond_the_mean_log_deviation_and_the_log_root_mean_square_deviation() -> None:
    matrix = np.random.default_rng(8).normal(size=(40, 6)) * np.array([1.0, 2.0, 3.0, 0.5, 5.0, 0.1])
    covariance = np.linalg.inv(matrix.T @ matrix)
    expected = (
        2.0 * np.log(np.linalg.cond(matrix))
        + 0.5 * (0.5 * np.linalg.slogdet(covariance)[1] / 6)
        + 3.0 * np.log(np.sqrt(np.trace(covariance) / 6))
    )
    assert criterion_of("cond:2,d:0.5,a:3")(matrix.T @ matrix)[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("text", ["", "beauty", "cond:0", "cond:-1", "cond:x", "cond,cond", "cond:nan"])
def test_an_objective_nobody_can_mean_is_refused(text: str) -> None:
    with pytest.raises(DesignError, match="mixes such as"):
        mixture_weights(text)


@pytest.mark.parametrize("criterion", sorted(CRITERIA))
def test_a_motion_that_shows_nothing_is_infinitely_bad(criterion: str) -> None:
    base = BaseMatrix(load_robot("iiwa14"))
    value, gradient, _ = FourierObjective(base, criterion, 0.1, 5, 20)(np.zeros((7, 10)), np.zeros(7))
    assert value == np.inf
    assert not np.any(gradient)


def test_reported_condition_number_uses_1000_samples_and_the_true_sign() -> None:
    robot = load_robot("iiwa14")
    generator = np.random.default_rng(6)
    a, b = 0.3 * generator.normal(size=(2, 7, 5))
    trajectory = FourierTrajectory(0.1, a, b, np.zeros(7))
    fits = BaseRegressor(robot)
    time = np.arange(1000) / 100.0
    basis = fourier_basis(time, 0.1, 5)
    motion = [phi @ np.concatenate([a, b], axis=1).T for phi in basis]
    stacked = fits.matrix(*motion).reshape(7000, 57)
    achieved = achieved_figures(fits, trajectory)
    assert achieved["samples"] == 1000
    assert achieved["cond"] == pytest.approx(np.linalg.cond(stacked), rel=1e-8)
    assert achieved["log_det"] == pytest.approx(np.linalg.slogdet(stacked.T @ stacked)[1], rel=1e-8)
