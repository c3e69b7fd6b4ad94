"""A simulated arm beside a recording, or beside the plan where there is none: the data of the paper's Fig. 4.

Three torques on the same rows and through the same filter: measured, inverse dynamics of the measured motion, and
simulated. Here: which motion is followed and what is compared. Not here: the simulation (`simulate`) and drawing
(`figure`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio
from scipy.interpolate import CubicHermiteSpline

from identification.arrays import BoolArray, FloatArray
from identification.excitation import Trajectory
from identification.export.parameters import ModelParameters
from identification.fitting.delay import earlier
from identification.fitting.processing import process
from identification.fitting.rms import RmsRow, RmsTable, rms_of_rows
from identification.fitting.settings import FitSettings
from identification.json_values import json_list
from identification.recordings import Recording
from identification.robots import RobotModel
from identification.signals.processed import ProcessedSignals
from identification.simulation.controllers import Controller
from identification.simulation.dynamics import ExtraTorque
from identification.simulation.simulate import SimulationResult, SimulationSettings, simulate

LONGEST_STEP_S = 0.001
LEAD_IN_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class SampledMotion:
    """A motion known at the samples of a uniform grid: cubic Hermite interpolation through positions and velocities.

    time: (S,) s from 0. position, velocity: (S, n). period_s: length; a periodic motion is repeated for all times.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    period_s: float
    periodic: bool

    def evaluate(self, time_s: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """q, q̇, q̈ at the given times, each (S, n); beyond its ends, a motion that is not periodic stands still."""
        wanted = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        time, position, velocity = self.time, self.position, self.velocity
        if self.periodic:
            time = np.append(time, self.period_s)
            position, velocity = (np.vstack([values, values[:1]]) for values in (position, velocity))
            wanted = np.mod(wanted, self.period_s)
        inside = np.clip(wanted, time[0], time[-1])
        spline = CubicHermiteSpline(time, position, velocity, axis=0)
        moving = (inside == wanted)[:, None]
        return spline(inside), spline(inside, 1) * moving, spline(inside, 2) * moving


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Series of one simulation beside its recording; measured ones are None where only a plan was followed.

    time: (S,) s and positions (S, n) rad. torque_time: (E,) s and torques (E, n) Nm, all three through the recording's
    filter; inverse_dynamics_torque is of the measured motion, of the planned one without a recording. compared: (E, n)
    the rows that count. noise_floor_nm: (n,), nan where unknown. sentences: what was followed, by what, with what.
    """

    time: FloatArray
    reference_position: FloatArray
    simulated_position: FloatArray
    measured_position: FloatArray | None
    torque_time: FloatArray
    simulated_torque: FloatArray
    inverse_dynamics_torque: FloatArray
    measured_torque: FloatArray | None
    compared: BoolArray
    noise_floor_nm: FloatArray
    result: SimulationResult
    sentences: tuple[str, ...]

    def torque_rms(self) -> RmsTable:
        """RMS of the differences of each two of the torques per joint, Nm."""
        measured, modelled, simulated = self.measured_torque, self.inverse_dynamics_torque, self.simulated_torque
        pairs = [("inverse dynamics minus simulated", modelled, simulated)]
        if measured is not None:
            pairs = [
                ("measured minus inverse dynamics", measured, modelled),
                ("measured minus simulated", measured, simulated),
                *pairs,
            ]
        unknown = np.full_like(self.noise_floor_nm, np.nan)
        return RmsTable(
            tuple(
                RmsRow(
                    label,
                    self._rms(first - second),
                    self._rms(first),
                    self.noise_floor_nm if first is measured else unknown,
                )
                for label, first, second in pairs
            )
        )

    def position_rms(self) -> dict[str, FloatArray]:
        """(n,) RMS of position differences per joint, rad (m): simulated against commanded and against measured."""
        simulated = self.simulated_position
        result = {"simulated minus commanded": rms_of_rows(simulated - self.reference_position)}
        if self.measured_position is not None:
            result["simulated minus measured"] = rms_of_rows(simulated - self.measured_position)
            result["measured minus commanded"] = rms_of_rows(self.measured_position - self.reference_position)
        return result

    def to_json(self) -> dict[str, Any]:
        """The summary as plain JSON types."""
        return {
            "format": "iiwa-ident/simulation/1",
            "duration_s": float(self.time[-1] - self.time[0]),
            "position_rms": {name: json_list(values) for name, values in self.position_rms().items()},
            "torque_rms": self.torque_rms().to_json(),
            "noise_floor_nm": json_list(self.noise_floor_nm),
            "notes": list(self.sentences),
        }

    def series(self) -> dict[str, FloatArray]:
        """All series by name, for a file."""
        named = {
            "time": self.time,
            "reference_position": self.reference_position,
            "simulated_position": self.simulated_position,
            "measured_position": self.measured_position,
            "torque_time": self.torque_time,
            "measured_torque": self.measured_torque,
            "inverse_dynamics_torque": self.inverse_dynamics_torque,
            "simulated_torque": self.simulated_torque,
        }
        return {name: values for name, values in named.items() if values is not None}

    def _rms(self, difference: FloatArray) -> FloatArray:
        return rms_of_rows(np.where(self.compared, difference, np.nan))


def compare_with_recording(
    recording: Recording,
    robot: RobotModel,
    parameters: ModelParameters,
    controller: Controller,
    settings: SimulationSettings,
    *,
    extra_torque: ExtraTorque | None = None,
    fitted: FitSettings | None = None,
    torque_shift: FloatArray | None = None,
) -> Comparison:
    """Simulate the commanded motion of a recording and compare with what was measured.

    A periodic recording: one period after 2 s of the end of the one before, against the mean period. Else: the
    longest stretch without a gap. A recording without commands is followed along its measured motion. duration_s,
    lead_in_s and step_s of the settings are set here. fitted: how the model's fit processed its recordings, sign of the
    torque included. torque_shift: (n,) s by which it took the torque earlier. Raises RecordingError as the fit does.
    """
    fitted = FitSettings() if fitted is None else fitted
    measured = _longest(process(recording, robot, fitted).stretches)
    if torque_shift is not None and torque_shift.any():
        measured = earlier(measured, torque_shift)
    sentences = []
    commanded = measured
    command = recording.command_position
    if command is not None and np.isfinite(command).all():
        commanded = _longest(process(replace(recording, position=command), robot, fitted).stretches)
        sentences.append("Followed: the recording's commanded motion.")
    if command is None or commanded.time.shape != measured.time.shape:
        commanded = measured
        sentences.append("Followed: the measured motion, since the recording holds no usable commanded one.")
    periodic = measured.pipeline != "aperiodic"
    sampling = float(measured.time[1] - measured.time[0])
    time = measured.time - measured.time[0]
    length = len(time) * sampling if periodic else float(time[-1])
    motion = SampledMotion(time, commanded.position, commanded.velocity, length, periodic)
    stride = max(1, math.ceil(sampling / LONGEST_STEP_S - 1e-9))
    result = simulate(
        robot,
        parameters.physical,
        motion,
        controller,
        extra_torque=extra_torque,
        settings=replace(
            settings,
            duration_s=len(time) * sampling,
            lead_in_s=round(min(LEAD_IN_S, length) / sampling) * sampling if periodic else 0.0,
            step_s=sampling / stride,
        ),
    )
    rows = slice(0, len(time) * stride, stride)
    modelled = inverse_dynamics(
        robot, parameters, measured.position, measured.velocity, measured.acceleration, settings
    )
    return Comparison(
        time=time,
        reference_position=commanded.position,
        simulated_position=result.position[rows],
        measured_position=measured.position,
        torque_time=measured.evaluation_time - measured.time[0],
        simulated_torque=measured.evaluate(result.torque[rows]),
        inverse_dynamics_torque=measured.evaluate(modelled),
        measured_torque=measured.evaluate(measured.torque),
        compared=measured.evaluated,
        noise_floor_nm=measured.noise_floor_nm,
        result=result,
        sentences=(*sentences, controller.sentence(), *filter(None, [result.chatter])),
    )


def compare_with_plan(
    trajectory: Trajectory,
    robot: RobotModel,
    parameters: ModelParameters,
    controller: Controller,
    settings: SimulationSettings,
    *,
    extra_torque: ExtraTorque | None = None,
) -> Comparison:
    """Simulate one period of a planned motion and compare with the inverse dynamics of the plan."""
    lead_in = min(LEAD_IN_S, trajectory.period_s)
    settings = replace(settings, duration_s=trajectory.period_s, lead_in_s=lead_in, step_s=LONGEST_STEP_S)
    result = simulate(robot, parameters.physical, trajectory, controller, extra_torque=extra_torque, settings=settings)
    planned = trajectory.evaluate(result.time)
    return Comparison(
        time=result.time,
        reference_position=result.reference_position,
        simulated_position=result.position,
        measured_position=None,
        torque_time=result.time,
        simulated_torque=result.torque,
        inverse_dynamics_torque=inverse_dynamics(robot, parameters, *planned, settings),
        measured_torque=None,
        compared=np.ones(result.torque.shape, dtype=np.bool_),
        noise_floor_nm=np.full(robot.n, np.nan),
        result=result,
        sentences=("Followed: the planned motion.", controller.sentence(), *filter(None, [result.chatter])),
    )


def inverse_dynamics(
    robot: RobotModel,
    parameters: ModelParameters,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    settings: SimulationSettings,
) -> FloatArray:
    """(S, n) Nm: eq. (1) along a motion (S, n) each, as the robot's sensor would show it, without effects."""
    model = parameters.pinocchio_model(robot)
    motor = np.zeros(robot.n) if settings.motor_inertia is None else settings.motor_inertia
    model.armature = np.where(settings.motor_inertia_in_torque, motor, 0.0)
    data = model.createData()
    rigid = np.array([pinocchio.rnea(model, data, *row) for row in zip(position, velocity, acceleration, strict=True)])
    friction = parameters.friction(velocity, settings.coulomb_velocity)
    return np.asarray(rigid + friction + parameters.offset, dtype=np.float64)


def _longest(stretches: tuple[ProcessedSignals, ...]) -> ProcessedSignals:
    return max(stretches, key=lambda stretch: len(stretch.time))
