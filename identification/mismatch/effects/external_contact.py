"""External contact: something pushes against a link for a while, in one period or in several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.describe import linear, shaped
from identification.mismatch.effects.enveloped import EnvelopedEffect, record_time
from identification.mismatch.motion import Motion
from identification.regressor import rigid_body_columns

BEYOND_LINK_M = 0.13
"""How far a link's surface may be from the line between the origins of its joints."""
TOOL_M = 0.3
"""How far what the last link carries may reach."""


class ExternalContact(EnvelopedEffect):
    """A force F of fixed direction in the base frame on link l during a window: −J_l(q)ᵀ F · p((t − t₀)/D).

    Parameters: F (3) in N; start t₀ and duration D in s; the profile p(u) = sin(π u^a)^s, of height 1, runs from a
    plateau (s → 0) over half a sine (1) to a bell (3), its peak early (a < 1) or late; bend_0, bend_1 … bend it further
    (logarithm of a factor at BENDS, lines between, the largest value 1 again). The force acts at the next
    joint's origin unless point_x_m, point_y_m, point_z_m (link frame) say otherwise. Seen: joints up to l, not beyond.
    A contact that comes back in further periods has further shape parameters start_2_s, start_3_s …; one that comes
    with every period has period_s, start_s being counted from the start of the period. largest_link: where the torque
    does not tell on which link it is, the last one possible. Looks like: payload_change if it lasts to the end; in
    every period cable_spring, position_dependent_torque. Source: τ = Jᵀ F; De Luca, Mattone, ICRA 2005 (isolation by
    zero pattern).
    Usual: 2 to 50 N for 0.1 to 3 s.
    """

    name: ClassVar[str] = "external_contact"
    units: ClassVar[tuple[str, ...]] = ("N", "N", "N")
    separating_experiment: ClassVar[str] = "Clear the space around the robot, dress pack included, and record again."

    def places(self, motion: Motion) -> Sequence[Place]:
        """Every link."""
        return tuple(Place(link=link + 1) for link in range(motion.n))

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """Window, profile and point."""
        assert place.link is not None
        last = float(motion.start_s[-1] + motion.time[-1])
        longest = 0.4 * float(motion.time[-1])
        usual = point_weights(motion, place.link, {})[1:]
        lower, upper = reach_of(motion, place.link)
        return (
            ShapeParameter("start_s", "s", tuple(motion.start_s), 0.0, last, logarithmic=False),
            ShapeParameter("duration_s", "s", (0.2, 0.5, 1.2), 0.05, longest),
            *PROFILE,
            *(
                ShapeParameter(f"point_{axis}_m", "m", (float(at),), float(low), float(high), logarithmic=False)
                for axis, at, low, high in zip("xyz", usual, lower, upper, strict=True)
            ),
        )

    def repeated_columns(
        self, motion: Motion, place: Place, shape: Mapping[str, float]
    ) -> tuple[tuple[int, ...], FloatArray] | None:
        """Joint torques of unit forces along the base frame's axes."""
        assert place.link is not None
        upstream = motion.robot.kinematics.upstream(place.link - 1)
        values = unit_forces(motion, motion.position, place.link) @ point_weights(motion, place.link, shape)
        return upstream, values[:, list(upstream)]

    def envelope(self, motion: Motion, shape: Mapping[str, float]) -> FloatArray:
        """The profile at every start."""
        time = record_time(motion)
        if "period_s" in shape:
            return profile((time - shape["start_s"]) % shape["period_s"], 0.0, shape)
        starts = [value for name, value in shape.items() if name.startswith("start_")]
        return np.asarray(sum(profile(time, start, shape) for start in starts), dtype=np.float64)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Force and window."""
        return force_parameters(estimate)

    def sentence(self, estimate: Estimate) -> str:
        """One sentence for the operator."""
        shape, link = estimate.shape, estimate.place.link
        force = float(np.linalg.norm(estimate.coefficients))
        where = f"link {link}"
        if "largest_link" in shape:
            where += f" (or one beyond it, up to link {shape['largest_link']:.0f}: the torque does not tell)"
        what = f"omething pushes against {where} with up to {force:.3g} N for {shape['duration_s']:.3g} s"
        if "period_s" in shape:
            return (
                f"In every period s{what}, {shape['start_s']:.3g} s after the period begins. A held-out recording has "
                "its own contacts and cannot confirm this one."
            )
        starts = sorted(value for name, value in shape.items() if name.startswith("start_"))
        return f"S{what} at " + ", ".join(f"{start:.4g}" for start in starts) + " s."


PROFILE = (ShapeParameter("sharpness", "", (1.0,), 0.05, 4.0), ShapeParameter("skew", "", (1.0,), 0.3, 3.0))


BENDS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95, 0.98, 1.0)
"""Shares of the window at which a profile may be bent."""


def profile(time: FloatArray, start_s: float, shape: Mapping[str, float]) -> FloatArray:
    """sin(π u^a)^s of u = (t − start)/duration, bent where the shape says so, 0 outside the window; shape of time."""
    u = (time - start_s) / shape["duration_s"]
    inside = (u > 0.0) & (u < 1.0)
    result = np.zeros_like(u)
    bends = [shape[f"bend_{number}"] for number in range(len(BENDS)) if f"bend_{number}" in shape]

    def bent(share: FloatArray) -> FloatArray:
        plain = np.sin(np.pi * share ** shape.get("skew", 1.0)) ** shape.get("sharpness", 1.0)
        return plain if not bends else plain * np.exp(np.interp(share, BENDS, bends))

    result[inside] = bent(u[inside])
    return result if not bends else result / float(bent(_SHARES).max())


_SHARES = np.linspace(0.002, 0.998, 499)


def unit_forces(motion: Motion, position: FloatArray, link: int) -> FloatArray:
    """Joint torques of unit forces along each base axis on `link` (from 1), at its origin and per metre beside it.

    position: (S, n). Returns (S, n, 3, 4): direction of the force; origin, then x, y, z of the point in the link frame.
    The torque of a force at the point p is the product with (1, p). The sign is that of the measured torque, which has
    to hold against the force: a unit mass at rest under a gravity of +1 along the axis is held like that.
    """
    wanted = [(0, 1, 2, 3) if other == link - 1 else () for other in range(motion.n)]
    still = np.zeros_like(position)
    values = np.zeros((len(position), motion.n, 3, 4))
    for direction in range(3):
        pulled = replace(motion.robot, gravity=np.eye(3)[direction])
        for rows, columns in rigid_body_columns(pulled, position, still, still, wanted):
            values[rows, :, direction] = columns.transpose(2, 1, 0)
    return values


def point_weights(motion: Motion, link: int, shape: Mapping[str, float]) -> FloatArray:
    """(1, p) for the point p (link frame, m) of a shape; without one, the origin of the joint that `link` carries."""
    kinematics = motion.robot.kinematics
    child = next((joint for joint in range(motion.n) if kinematics.parent[joint] == link - 1), None)
    usual = np.zeros(3) if child is None else kinematics.translation[child]
    names = ("point_x_m", "point_y_m", "point_z_m")
    return np.array([1.0, *(shape.get(name, float(usual[i])) for i, name in enumerate(names))])


def reach_of(motion: Motion, link: int) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bound (3,) m, in the link's frame, of the points at which something may push against a link."""
    kinematics = motion.robot.kinematics
    children = [joint for joint in range(motion.n) if kinematics.parent[joint] == link - 1]
    origins = np.array([np.zeros(3), *(kinematics.translation[joint] for joint in children)])
    beyond = BEYOND_LINK_M if children else TOOL_M
    return origins.min(axis=0) - beyond, origins.max(axis=0) + beyond


def force_parameters(estimate: Estimate) -> tuple[Parameter, ...]:
    """Size and components of the force, start and duration."""
    force, covariance = estimate.coefficients, estimate.covariance
    size = float(np.linalg.norm(force))
    along = force / size if size > 0.0 else np.zeros(3)
    return (
        Parameter("force", size, float(np.sqrt(along @ covariance @ along)), "N"),
        *(linear(f"force_{axis}", estimate, "N", index=index) for index, axis in enumerate("xyz")),
        shaped("start_s", estimate, "s", called="start"),
        shaped("duration_s", estimate, "s", called="duration"),
    )
