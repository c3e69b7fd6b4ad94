"""Motions for the tests of the effects, and the Pinocchio model that is their truth. No test in here."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio

from identification.base_parameters import BaseRegressor
from identification.excitation import Trajectory, default_trajectory
from identification.mismatch.motion import Motion
from identification.physical_parameters import PhysicalParameters
from identification.robots import RobotModel, robot_from_urdf

FloatArray = npt.NDArray[np.float64]

SLIDING = """<robot name="sliding">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/>
  <joint name="1" type="revolute"><axis xyz="0 1 0"/><origin xyz="0 0 0.3" rpy="0.2 0.1 0"/>
    <parent link="base"/><child link="a"/><limit lower="-3" upper="3" velocity="9" effort="9"/></joint>
  <joint name="2" type="prismatic"><axis xyz="-1 0 0"/><origin xyz="0.1 0.2 0.3" rpy="0 0.5 0"/>
    <parent link="a"/><child link="b"/><limit lower="-3" upper="3" velocity="9" effort="9"/></joint>
  <joint name="3" type="revolute"><axis xyz="1 1 0"/><origin xyz="0.1 0 0.3" rpy="1 0 0"/>
    <parent link="b"/><child link="c"/><limit lower="-3" upper="3" velocity="9" effort="9"/></joint>
</robot>"""


def sliding_robot() -> RobotModel:
    """A turning, a sliding and a turning joint, none along an axis of its parent."""
    return robot_from_urdf(SLIDING, source="sliding.urdf")


def random_links(n: int, seed: int) -> PhysicalParameters:
    """As many possible bodies with friction."""
    generator = np.random.default_rng(seed)
    roots = generator.normal(size=(n, 3, 3))
    second_moments = roots @ roots.transpose(0, 2, 1) * 0.02
    inertia = np.trace(second_moments, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second_moments
    return PhysicalParameters(
        generator.uniform(0.5, 5.0, n),
        generator.uniform(-0.2, 0.2, (n, 3)),
        inertia,
        generator.uniform(0.1, 0.5, n),
        generator.uniform(0.1, 0.5, n),
    )


def motion_of(
    robot: RobotModel,
    links: PhysicalParameters,
    *,
    trajectory: Trajectory | None = None,
    rate_hz: float = 100.0,
    seed: int = 1,
    periodic: bool = True,
    friction: bool = True,
) -> Motion:
    """The shipped excitation, or a random Fourier series of 10 s; torque by our regressor from the true parameters."""
    if trajectory is not None:
        time = np.arange(round(trajectory.period_s * rate_hz)) / rate_hz
        q, dq, ddq = trajectory.evaluate(time)
    else:
        time = np.arange(round(10.0 * rate_hz)) / rate_hz
        q, dq, ddq = _series(robot.n, time, seed)
    regressor = BaseRegressor(robot)
    full = regressor.full_from_physical(links)
    torque = regressor.matrix(q, dq, ddq) @ regressor.base_from_full(full)
    if not friction:
        torque = torque - links.viscous * dq - links.coulomb * np.sign(dq)
    return Motion(robot, time, q, dq, ddq, torque, full, periodic, np.zeros(1))


def shipped_motion(robot: RobotModel, links: PhysicalParameters, rate_hz: float = 100.0) -> Motion:
    """The shipped excitation of the iiwa 14."""
    return motion_of(robot, links, trajectory=default_trajectory("iiwa14"), rate_hz=rate_hz)


def pinocchio_model(robot: RobotModel, links: PhysicalParameters) -> pinocchio.Model:
    """The robot with these bodies."""
    model = robot.pinocchio_model.copy()
    for link in range(robot.n):
        model.inertias[link + 1] = pinocchio.Inertia(
            float(links.mass[link]), links.center_of_mass[link], links.inertia[link]
        )
    return model


def pinocchio_torque(model: pinocchio.Model, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """Recursive Newton-Euler, sample by sample, (S, n)."""
    data = model.createData()
    return np.array([pinocchio.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])


def _series(n: int, time: FloatArray, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    generator = np.random.default_rng(seed)
    w = 2.0 * np.pi * 0.1 * np.arange(1, 6)
    a, b = generator.normal(scale=0.3, size=(2, n, 5))
    sine, cosine = (function(w * time[:, None, None]) for function in (np.sin, np.cos))
    position = (a / w * sine - b / w * cosine).sum(axis=2) + generator.uniform(-0.3, 0.3, n)
    return position, (a * cosine + b * sine).sum(axis=2), (w * (b * cosine - a * sine)).sum(axis=2)
