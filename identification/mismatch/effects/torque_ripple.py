"""Torque that repeats with every turn of the motor: gear error and ripple of the wave generator."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import harmonic, joint_name, shaped, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect, joint_index
from identification.mismatch.motion import Motion

# Ratios of harmonic drives in arms and their doubles (the wave generator has two lobes); the iiwa's is about 160.
USUAL_ORDERS = (50.0, 80.0, 100.0, 120.0, 160.0, 200.0, 240.0, 320.0)
# Around the iiwa's two orders the grid covers this many orders to either side: a ratio is rarely a round number.
NEIGHBOURHOOD = 1.6
# Strain wave gears begin at a ratio of 30 and ripple twice per turn of the wave generator, motors more often still.
LOWEST_ORDER = 45.0


class TorqueRipple(OwnJointEffect):
    """a sin(N q) + b cos(N q) with N near the gear ratio or twice it: a chirp up to N q̇/2π, 25 to 50 Hz on an iiwa.

    Nothing else looks like it, and nothing of it is absorbed; but it needs torque lines up to 60 Hz. A share w of the
    amplitude may grow with the load: the columns are weighed with 1 − w + w |τ̂|/rms(τ̂); w = 0 unless that
    explains clearly more.
    Usual: 0.05 to 0.3 % of full scale, 0.02 to 0.5 Nm. Source: Taghirad, Bélanger, harmonic drives, 1998; Godler et
    al.; Chawda, Niemeyer, IROS 2017.
    """

    name = "torque_ripple"
    sees_torque = True
    units = ("Nm", "Nm")
    separating_experiment = "None needed; record torque with at least 60 Hz of bandwidth."
    revolute_only = True

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The order N per turn of the joint, and the share w of the amplitude that grows with the load.

        Two orders decorrelate when they differ by 2π over the joint's range; half of that are told apart.
        """
        travel = max(float(np.ptp(motion.position[:, joint_index(place)])), 1e-3)
        step = math.pi / travel
        steps = min(int(NEIGHBOURHOOD / step), 4)
        near = {
            centre + k * NEIGHBOURHOOD / max(steps, 1) for centre in (160.0, 320.0) for k in range(-steps, steps + 1)
        }
        return (
            ShapeParameter(
                "order", "per turn", tuple(sorted(near | set(USUAL_ORDERS))), LOWEST_ORDER, 500.0, apart=step
            ),
            ShapeParameter("load_share", "1", (0.0,), 0.0, 1.0, logarithmic=False, textbook=0.0),
        )

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """Sine and cosine of N q, weighed with the load where it has a share."""
        angle = shape["order"] * motion.position[:, joint]
        waves = np.column_stack([np.sin(angle), np.cos(angle)])
        share, load = shape["load_share"], np.abs(motion.torque[:, joint])
        level = float(np.sqrt(np.mean(load**2)))
        return waves if share == 0.0 or level == 0.0 else waves * (1.0 - share + share * load / level)[:, None]

    def phase(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> FloatArray:
        """N q."""
        return np.asarray(shape["order"] * motion.position[:, joint_index(place)], dtype=np.float64)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Amplitude, phase φ of A sin(N q + φ), order, share of the amplitude that grows with the load."""
        return (
            *harmonic(estimate),
            shaped("order", estimate, "per turn"),
            shaped("load_share", estimate, "1"),
        )

    def sentence(self, estimate: Estimate) -> str:
        """How large, how often per turn."""
        amplitude, _, order, _ = self.parameters(estimate)
        return (
            f"{joint_name(estimate)} shows torque ripple of {size_of(amplitude)} that repeats {order.value:.1f} times "
            "per turn of the joint, as the gear's teeth or the motor's poles do."
        )
