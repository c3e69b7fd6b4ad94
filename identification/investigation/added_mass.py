"""A known mass that an operator fastened to the flange: its torque, taken out of a recording and put into a forecast.

Without it the recording is one of the same arm as before, so that all recordings share their parameters; what grows
with torque (a gain of the sensor) has grown with the mass, and shows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from identification.arrays import FloatArray
from identification.errors import RecordingError
from identification.mismatch.motion import Motion
from identification.recordings.recording import Recording
from identification.regressor import rigid_body_columns
from identification.robots import RobotModel
from identification.robots.flange import IIWA_FLANGE
from identification.signals.periodic import PeriodicSettings, smooth_motion
from identification.signals.periods import average_periods, period_table


@dataclass(frozen=True, slots=True)
class AddedMass:
    """A point mass on the flange. mass_kg; place_m: (3,) m in the flange's frame."""

    mass_kg: float
    place_m: tuple[float, float, float]

    @classmethod
    def parse(cls, text: str) -> AddedMass:
        """From KG@X,Y,Z. Raises ValueError for anything else, and for a mass that is not positive."""
        mass, _, place = text.partition("@")
        x, y, z = (float(part) for part in place.split(","))
        found = cls(float(mass), (x, y, z))
        if not (found.mass_kg > 0.0 and np.all(np.isfinite([found.mass_kg, x, y, z]))):
            raise ValueError(text)
        return found

    def parameters(self) -> FloatArray:
        """(10,) parameters of eq. (3) about the last link's frame: M, MX, MY, MZ, XX, XY, XZ, YY, YZ, ZZ."""
        x, y, z = IIWA_FLANGE.origin + IIWA_FLANGE.rotation @ np.array(self.place_m)
        inertia = [y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y]
        return self.mass_kg * np.array([1.0, x, y, z, *inertia])

    def torque(
        self, robot: RobotModel, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """(S, n) Nm that the mass adds along a motion, eq. (1) sign."""
        wanted: list[tuple[int, ...]] = [()] * (robot.n - 1) + [tuple(range(10))]
        result = np.empty_like(position)
        parameters = self.parameters()
        for rows, columns in rigid_body_columns(robot, position, velocity, acceleration, wanted):
            result[rows] = np.einsum("pns,p->sn", columns, parameters)
        return result

    def carried(self, motion: Motion) -> Motion:
        """The motion as effects see it that act on torque: with that of the mass."""
        torque = self.torque(motion.robot, motion.position, motion.velocity, motion.acceleration)
        return replace(motion, torque=motion.torque + torque)


def without_added_mass(recording: Recording, robot: RobotModel, added: AddedMass) -> Recording:
    """The recording with the torque of a known mass taken out, period by period alike.

    Raises RecordingError for a recording without periods.
    """
    return less_torque(recording, lambda *states: added.torque(robot, *states))


def less_torque(
    recording: Recording, torque_along: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
) -> Recording:
    """The recording less a torque. torque_along: of q, q̇, q̈ (S, n) of a period, (S, n) Nm.

    Raises RecordingError for a recording without periods.
    """
    if recording.sample_in_period is None:
        raise RecordingError(
            f"{recording.source.path} has no periods: a known torque cannot be taken out of it",
            file=recording.source.path,
        )
    average = average_periods(period_table(recording))
    along = torque_along(*smooth_motion(average, PeriodicSettings()))[:: average.finer.factor]
    place = recording.sample_in_period
    inside = (place >= 0) & (place < len(along))
    torque = recording.torque.copy()
    torque[inside] -= along[place[inside]]
    return replace(recording, torque=torque)
