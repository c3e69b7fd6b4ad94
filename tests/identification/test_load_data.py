"""Claims about a load that the cabinet does not know of.

Truth: Pinocchio's Newton-Euler of that load alone; and what is known of a recording of a real LBR Med 7 whose cabinet
did not have its tool's load data.
"""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest

from identification.excitation import default_trajectory
from identification.load_data import unknown_load
from identification.robots import load_robot
from identification.robots.model import RobotModel
from tests.reference import recording_file

FloatArray = np.ndarray
FRICTION_NM, OFFSET_NM, NOISE_NM = 0.4, 0.3, 0.2


@pytest.fixture(scope="module")
def motion() -> tuple[RobotModel, FloatArray, FloatArray, FloatArray]:
    robot = load_robot("iiwa14")
    table = default_trajectory().table(1000.0)
    spacing = 0.001
    dq = (np.roll(table, -1, axis=0) - np.roll(table, 1, axis=0)) / (2 * spacing)
    ddq = (np.roll(table, -1, axis=0) - 2 * table + np.roll(table, 1, axis=0)) / spacing**2
    return robot, table[::10], dq[::10], ddq[::10]


def point_load(robot: RobotModel, mass: float, center: FloatArray, states: tuple[FloatArray, ...]) -> FloatArray:
    """Torque (S, 7) Nm that a point on the last link needs, by Pinocchio on an arm that weighs nothing else."""
    model = robot.pinocchio_model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pinocchio.Inertia.Zero()
    model.appendBodyToJoint(robot.n, pinocchio.Inertia(mass, center, np.zeros((3, 3))), pinocchio.SE3.Identity())
    data = model.createData()
    return np.array([pinocchio.rnea(model, data, *state) for state in zip(*states, strict=True)])


def disturbance(dq: FloatArray, generator: np.random.Generator) -> FloatArray:
    """What else stands in a cabinet's external torque: own friction it does not know, an offset, noise."""
    return -FRICTION_NM * np.tanh(dq / 0.01) + OFFSET_NM + NOISE_NM * generator.standard_normal(dq.shape)


@pytest.mark.parametrize(("real", "told"), [(0.8, 0.0), (2.5, 1.0), (0.0, 1.5)])
def test_a_load_that_the_cabinet_was_not_told_of_is_found_with_its_mass(
    motion: tuple[RobotModel, FloatArray, FloatArray, FloatArray], real: float, told: float
) -> None:
    robot, *states = motion
    center, generator = np.array([0.02, -0.01, 0.19]), np.random.default_rng(11)
    external = -point_load(robot, 1.0, center, tuple(states)) * (real - told) + disturbance(states[1], generator)
    found = unknown_load(robot, *states, external)
    assert found is not None
    assert found.mass == pytest.approx(real - told, abs=0.1)
    np.testing.assert_allclose(found.center, center, atol=0.05)
    assert np.all(found.rms_after > 0.9 * NOISE_NM)
    assert found.rms_before[1] > 5.0 * found.rms_after[1]


def test_load_data_of_the_right_mass_and_a_wrong_centre_are_found_by_their_moment(
    motion: tuple[RobotModel, FloatArray, FloatArray, FloatArray],
) -> None:
    """3 kg at z 0.1 m from the flange, and load data that say y 0.1 m: (0, -0.3, 0.3) kg m and no weight."""
    robot, *states = motion
    real, told = (np.array([0.0, 0.0, 0.226]), np.array([0.0, 0.1, 0.126]))
    wrong = point_load(robot, 3.0, real, tuple(states)) - point_load(robot, 3.0, told, tuple(states))
    found = unknown_load(robot, *states, disturbance(states[1], np.random.default_rng(11)) - wrong)
    assert found is not None
    assert not found.weighs
    deviation = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(np.array([found.mass, *found.moment]) - [0.0, 0.0, -0.3, 0.3]) < 4.0 * deviation)
    assert deviation.max() < 0.02


@pytest.mark.parametrize("seed", range(5))
def test_friction_offsets_and_noise_are_no_load(
    motion: tuple[RobotModel, FloatArray, FloatArray, FloatArray], seed: int
) -> None:
    robot, *states = motion
    assert unknown_load(robot, *states, disturbance(states[1], np.random.default_rng(seed))) is None


def test_a_push_on_one_joint_is_no_load(motion: tuple[RobotModel, FloatArray, FloatArray, FloatArray]) -> None:
    """8 Nm on A2 alone for a third of the motion: what somebody does who leans on the arm."""
    robot, *states = motion
    external = disturbance(states[1], np.random.default_rng(3))
    external[200:500, 1] += 8.0
    assert unknown_load(robot, *states, external) is None


def test_a_few_samples_say_nothing(motion: tuple[RobotModel, FloatArray, FloatArray, FloatArray]) -> None:
    robot, *states = motion
    short = [state[:50] for state in states]
    assert unknown_load(robot, *short, -point_load(robot, 3.0, np.array([0.0, 0.0, 0.2]), tuple(short))) is None


def test_a_real_cabinet_that_was_not_told_its_tool_is_found_out() -> None:
    """The external torque of this recording is by itself a load of 0.79 to 0.83 kg (docs/real-recordings.md)."""
    robot = load_robot(recording_file("med7dock.urdf"))
    with np.load(recording_file("lbrmed7.npz")) as recording:
        q, external = recording["q"], recording["tau_ext"]
    dq = np.gradient(q, 0.01, axis=0)
    found = unknown_load(robot, q, dq, np.gradient(dq, 0.01, axis=0), external)
    assert found is not None
    assert found.mass == pytest.approx(0.81, abs=0.03)
    assert found.rms_after[1] < 0.4 * found.rms_before[1]
