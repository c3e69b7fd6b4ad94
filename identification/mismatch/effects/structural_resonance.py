"""A mode of the structure that rings after every jump of the torque."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import harmonic, joint_name, shaped, size_of
from identification.mismatch.effects.own_joint import OwnJointEffect
from identification.mismatch.effects.time_domain import filtered_lines, frequencies_of, torque_lines
from identification.mismatch.motion import Motion


class StructuralResonance(OwnJointEffect):
    """G(s) (c₁ + c₂ ω/s) τ̂_j, G = s²/(s² + 2 ζ ω s + ω²): a share of the torque passes through a weakly damped mode.

    Slow torque passes as it is; a friction reversal rings at ω. The second column is the same ringing turned by 90°, so
    that it need not be known what drives the mode (torque, its rate, or the jerk) nor what its damper acts against: on
    the ground, or on what drives it as in 1 − ω²/(s² + 2 ζ ω s + ω²). Torque at rest does not pass in either.
    Usual: 5 to 15 Hz, ζ 0.01 to 0.1, a few per cent of the torque. Looks like: presliding_hysteresis,
    stribeck_friction, torque_ripple. Source: Ohr et al., Identification of flexibility parameters of 6-axis industrial
    manipulators, ISMA 2006.
    """

    name = "structural_resonance"
    sees_torque = True
    units = ("1", "1")
    separating_experiment = "Tap the arm at rest, or sweep one joint with a small sine from 3 to 20 Hz."

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """Frequency, within what is compared, and damping ratio. Neighbours of the grid overlap at the wider damping.

        Of a mode beyond the compared band only its quasi-static foot would be seen, which is the torque smoothed or
        sharpened, as friction that turns over otherwise than the nominal model's is.
        """
        highest = min(0.4 / motion.sampling_period_s, motion.compared_hz)
        grid = tuple(float(f) for f in np.geomspace(4.0, 20.0, 16) if f < highest)
        return (
            ShapeParameter("frequency", "Hz", grid or (0.5 * highest,), min(2.0, 0.2 * highest), min(40.0, highest)),
            ShapeParameter("damping", "1", (0.02, 0.08), 0.003, 0.3),
        )

    def own_torque(self, motion: Motion, joint: int, shape: Mapping[str, float]) -> FloatArray:
        """The mode's answer to the nominal torque, and the same turned by 90°."""
        omega, damping = 2.0 * np.pi * shape["frequency"], shape["damping"]
        s, torque = frequencies_of(motion), torque_lines(motion)[:, joint]
        mode = s**2 + 2.0 * damping * omega * s + omega**2
        return np.column_stack([filtered_lines(motion, torque, part / mode) for part in (s**2, omega * s)])

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Frequency, damping, and the share of the torque that passes the mode, at resonance."""
        # At s = iω the second column is -i times the first.
        turn = np.diag([1.0, -1.0])
        seen = Estimate(
            estimate.place, estimate.shape, turn @ estimate.coefficients, turn @ estimate.covariance @ turn.T
        )
        share, phase = harmonic(seen, "%", scale=100.0, called="share_of_torque")
        return (share, shaped("frequency", estimate, "Hz"), shaped("damping", estimate, "1"), phase)

    def sentence(self, estimate: Estimate) -> str:
        """At what frequency it rings, how damped."""
        share, frequency, damping, _ = self.parameters(estimate)
        cycles = 1.0 / (2.0 * math.pi * damping.value)
        return (
            f"{joint_name(estimate)}'s torque rings at {size_of(frequency)} after each change of direction and dies "
            f"out within about {cycles:.0f} cycles ({size_of(share)} of the torque; structural resonance)."
        )
