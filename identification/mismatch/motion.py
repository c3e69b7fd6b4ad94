"""The motion of one stretch of a recording, and everything an effect may look at. No noise and no rows here."""

from __future__ import annotations

import math
from dataclasses import dataclass

from identification.arrays import FloatArray
from identification.base_parameters import Widths, direction_of
from identification.robots import RobotModel


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Motion:
    """One stretch on a uniform time grid: the mean period of a periodic recording, or one gap-free stretch.

    time: (S,) s from the start of the stretch. position, velocity, acceleration: (S, n) rad, rad/s, rad/s² (m for
    prismatic joints), smooth. torque: (S, n) Nm, the nominal model's fitted torque, sign of eq. (1) — never the
    measured one, whose noise would leak into the columns. full_parameters: (full,) dynamic parameters in the order of
    `BaseRegressor.full_names` without friction columns of the effect library, whose inverse dynamics is `torque`
    (the minimum-norm ones where the motion does not determine them). periodic: whether the stretch wraps around; then
    states with memory start in their periodic steady state. start_s: (K,) times at which the K periods of the
    recording began, s from its first sample; (1,) for a stretch that is not periodic.
    coulomb_velocity: of the nominal model's Coulomb friction
    (`base_parameters.direction_of`), rad/s. thinned_direction: (S, n) direction of motion brought from a faster rate to
    this grid, as the measured torque was; None where the grid is that of the recording. compared_hz: highest frequency
    of the torque that is compared; beyond it nothing is seen.
    """

    robot: RobotModel
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    full_parameters: FloatArray
    periodic: bool
    start_s: FloatArray
    coulomb_velocity: Widths = 0.0
    thinned_direction: FloatArray | None = None
    compared_hz: float = math.inf

    @property
    def direction(self) -> FloatArray:
        """(S, n), what dry friction is proportional to.

        It jumps between two samples. Taken from the velocities of a coarse grid the jump would be late by up to half a
        step, and the torque, which was measured on a finer one, would show that as misfit.
        """
        if self.thinned_direction is not None:
            return self.thinned_direction
        return direction_of(self.velocity, self.coulomb_velocity)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.position.shape[1])

    @property
    def samples(self) -> int:
        """Number of samples S."""
        return int(self.time.shape[0])

    @property
    def sampling_period_s(self) -> float:
        """Distance of the samples, s."""
        return float(self.time[1] - self.time[0])
