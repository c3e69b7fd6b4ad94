"""Torque that is read late: a pure delay, or the lag of a filter of first or second order, on one joint or on all."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import CERTAIN, Columns, Effect, Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import deviation, joint_name, size_of
from identification.mismatch.effects.time_domain import filtered_lines, frequencies_of, torque_lines
from identification.mismatch.motion import Motion


class TorqueDelay(Effect):
    """c (τ̂(t − d) − τ̂(t)), or the same with a lag 1/(1 + d s/n)ⁿ of order n in place of the delay; c is 1 in truth.

    Not linearised: at 12 to 15 ms the linear column leaves a rest that looks like friction. On joint null all joints
    are late alike, which points at the acquisition; on one joint it is its drive or its filter. Lateness of a positive
    d means that torque is late against position.
    Usual: 1 to 20 ms. Looks like: presliding_hysteresis, stribeck_friction, nonlinear_viscous_friction. Source:
    acquisition and filter lag, own model; effect on fits: Swevers et al., IEEE Trans. Robot. Autom. 13, 1997.
    """

    name = "torque_delay"
    units = ("1",)
    separating_experiment = (
        "Repeat the motion at another speed: the phase of a delay grows in proportion to frequency; pre-sliding "
        "follows the distance since the reversal."
    )

    def places(self, motion: Motion) -> Sequence[Place]:
        """All joints together, and each alone."""
        return (Place(), *(Place(joint=joint + 1) for joint in range(motion.n)))

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """The delay d, and whether it is a lag (1, 2: its order) or a pure delay (0). Negative: position is late."""
        return (
            ShapeParameter("delay", "s", (0.002, 0.005, 0.012, 0.03), 0.0003, 0.1),
            ShapeParameter("lag", "", (0.0, 1.0, 2.0), 0.0, 2.0, True, False),
        )

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Late torque minus torque."""
        joints = tuple(range(motion.n)) if place.joint is None else (place.joint - 1,)
        delay, order = shape["delay"], round(shape["lag"])
        s = frequencies_of(motion)
        late = (1.0 + delay / order * s) ** -order if order > 0 else np.exp(-delay * s)
        change = filtered_lines(motion, torque_lines(motion)[:, list(joints)], late - 1.0)
        return Columns(joints, change[..., None]) if change.any() else None

    def is_impossible(self, coefficients: FloatArray, std: FloatArray | None = None) -> bool:
        """Whether c is surely nearer to 0 or 2 than to 1: then a part of the torque is late, and the rest is not."""
        return std is not None and bool(abs(coefficients[0] - 1.0) - CERTAIN * std[0] > 0.5)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Delay c · d: for short delays only that product shows, as c and d trade; for long ones c is 1."""
        delay, share = float(estimate.shape["delay"]), float(estimate.coefficients[0])
        std = delay * deviation(estimate, 0)
        if "delay" in estimate.shape_covariance:
            trade = 2.0 * share * delay * float(estimate.shape_covariance["delay"][0])
            std = math.sqrt(max(0.0, std**2 + (share * estimate.shape_std["delay"]) ** 2 + trade))
        return (
            Parameter("delay", 1000.0 * share * delay, 1000.0 * std, "ms"),
            Parameter("lag", float(estimate.shape["lag"]), math.nan, "order of the lag, 0 = pure delay"),
        )

    def sentence(self, estimate: Estimate) -> str:
        """How late, and of which kind."""
        delay, lag = self.parameters(estimate)
        kind = {
            0: "as by a pure delay",
            1: "as behind a first-order filter of that time constant",
            2: "as behind two first-order filters of half that time constant each",
        }[round(lag.value)]
        cause = "the acquisition" if estimate.place.joint is None else "this joint's drive or sensor"
        early = delay.value < 0.0
        size = size_of(replace(delay, value=abs(delay.value)))
        return (
            f"{joint_name(estimate)}'s torque is {'early' if early else 'late'} against its position by {size}, "
            f"{kind}; look at {cause}."
        )
