"""A recording of a real arm cut in two: the model is of its first half, and its second half is given a fault."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio

from identification.audit import Audit, audit
from identification.audit.between import model_of
from identification.model_file import Model
from identification.recordings import Recording
from identification.robots import RobotModel

FloatArray = np.ndarray


@dataclass(frozen=True)
class Bench:
    """A second half without a fault, and the model of the first."""

    robot: RobotModel
    model: Model
    recording: Recording

    @classmethod
    def of_halves(cls, recording: Recording, robot: RobotModel) -> Bench:
        """A recording cut in the middle of its time."""
        middle = 0.5 * float(recording.time[-1])
        first, second = recording.rows(recording.time < middle), recording.rows(recording.time >= middle)
        return cls(robot, model_of(first, robot), replace(second, time=second.time - second.time[0]))

    def asked(self, recording: Recording) -> Audit:
        return audit([recording], self.robot, self.model)

    def with_torque(self, torque: FloatArray) -> Audit:
        return self.asked(replace(self.recording, torque=torque))

    def late(self, delay_s: float) -> FloatArray:
        """(S, n) Nm: the torque as it was so long ago."""
        time = self.recording.time
        return np.column_stack([np.interp(time - delay_s, time, column) for column in self.recording.torque.T])


def names(found: Audit) -> list[tuple[str, int | None, int | None]]:
    return [(item.effect, item.joint, item.link) for item in found.differences]


def torque_of_load(
    robot: RobotModel, recording: Recording, mass: float, center: FloatArray, link: int | None = None
) -> FloatArray:
    """(S, n) Nm by Pinocchio of a body on a link (default: the last) of an arm that weighs nothing else."""
    model = robot.pinocchio_model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pinocchio.Inertia.Zero()
    inertia = 0.4 * mass * 0.05**2 * np.eye(3)
    model.appendBodyToJoint(link or robot.n, pinocchio.Inertia(mass, center, inertia), pinocchio.SE3.Identity())
    data = model.createData()
    velocity = np.gradient(recording.position, recording.sampling_period_s, axis=0)
    smooth = np.apply_along_axis(lambda values: np.convolve(values, np.ones(5) / 5.0, "same"), 0, velocity)
    acceleration = np.gradient(smooth, recording.sampling_period_s, axis=0)
    states = zip(recording.position, velocity, acceleration, strict=True)
    return np.array([pinocchio.rnea(model, data, *state) for state in states])


def torque_of_lean(robot: RobotModel, recording: Recording, angle: float) -> FloatArray:
    """(S, n) Nm by Pinocchio that the weight of the arm changes by where its base leans; links of 5 kg each."""
    model = robot.pinocchio_model.copy()
    for joint in range(1, model.njoints):
        model.inertias[joint] = pinocchio.Inertia(5.0, np.array([0.0, 0.0, 0.1]), 0.01 * np.eye(3))
    data = model.createData()

    def weight(lean: float) -> FloatArray:
        model.gravity.linear = 9.81 * np.array([np.sin(lean), 0.0, -np.cos(lean)])
        return np.array([pinocchio.computeGeneralizedGravity(model, data, q).copy() for q in recording.position])

    return np.asarray(weight(angle) - weight(0.0))
