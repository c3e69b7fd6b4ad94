"""External contact: something pushes against a link for a while, in one period or in several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from identification.mismatch.effects.base import Columns, Effect, Estimate, Parameter, Place, ShapeParameter
from identification.mismatch.effects.enveloped import EnvelopedEffect, record_time
from identification.mismatch.motion import Motion
from identification.regressor import rigid_body_columns

FloatArray = npt.NDArray[np.float64]

EQUATION = "J_l(q)^T F p((t - t0)/D), p(u) = sin(pi u^a)^s"


class ExternalContact(EnvelopedEffect):
    """A force F of fixed direction in the base frame on link l during a window: J_l(q)ᵀ F · p((t − t₀)/D).

    Parameters: F (3) in N; start t₀ and duration D in s; the profile p(u) = sin(π u^a)^s, of height 1, runs from a
    plateau (s → 0) over half a sine (1) to a bell (3), its peak early (a < 1) or late. The force acts at the next
    joint's origin unless point_x_m, point_y_m, point_z_m (link frame) say otherwise. Seen: joints up to l, not beyond.
    A contact that comes back in further periods has further shape parameters start_2_s, start_3_s … Looks like:
    payload_change if it lasts to the end. Source: τ = Jᵀ F; De Luca, Mattone, ICRA 2005 (isolation by zero pattern).
    """

    name: ClassVar[str] = "external_contact"
    code: ClassVar[str] = "contact"
    equation: ClassVar[str] = EQUATION
    source: ClassVar[str] = "De Luca & Mattone, ICRA 2005"
    units: ClassVar[tuple[str, ...]] = ("N", "N", "N")
    plausible: ClassVar[str] = "2 to 50 N for 0.1 to 3 s"
    look_alikes: ClassVar[tuple[str, ...]] = ("payload_change",)
    separating_experiment: ClassVar[str] = "Clear the space around the robot, dress pack included, and record again."

    def places(self, motion: Motion) -> Sequence[Place]:
        """Every link."""
        return tuple(Place(link=link + 1) for link in range(motion.n))

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """Window and profile."""
        del place
        last = float(motion.start_s[-1] + motion.time[-1])
        longest = 0.4 * float(motion.time[-1])
        return (
            ShapeParameter("start_s", "s", tuple(motion.start_s), 0.0, last, logarithmic=False),
            ShapeParameter("duration_s", "s", (0.2, 0.5, 1.2), 0.05, longest),
            *PROFILE,
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
        starts = [value for name, value in shape.items() if name.startswith("start_")]
        return np.asarray(sum(profile(time, start, shape) for start in starts), dtype=np.float64)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Force and window."""
        return force_parameters(estimate)

    def sentence(self, estimate: Estimate) -> str:
        """One sentence for the operator."""
        starts = sorted(value for name, value in estimate.shape.items() if name.startswith("start_"))
        force = float(np.linalg.norm(estimate.coefficients))
        where = ", ".join(f"{start:.4g}" for start in starts)
        return (
            f"Something pushes against link {estimate.place.link} with up to {force:.3g} N for "
            f"{estimate.shape['duration_s']:.3g} s at {where} s."
        )


class RepeatedContact(Effect):
    """The same contact in every period: it repeats with the motion and stands in the mean of the periods.

    As `ExternalContact`, with start_s counted from the start of the period.
    """

    name: ClassVar[str] = "external_contact"
    code: ClassVar[str] = "contact"
    equation: ClassVar[str] = EQUATION
    source: ClassVar[str] = ExternalContact.source
    units: ClassVar[tuple[str, ...]] = ExternalContact.units
    plausible: ClassVar[str] = ExternalContact.plausible
    look_alikes: ClassVar[tuple[str, ...]] = ("cable_spring", "position_dependent_torque")
    separating_experiment: ClassVar[str] = ExternalContact.separating_experiment

    def places(self, motion: Motion) -> Sequence[Place]:
        """Every link."""
        return tuple(Place(link=link + 1) for link in range(motion.n))

    def shape_parameters(self, motion: Motion, place: Place) -> tuple[ShapeParameter, ...]:
        """Window and profile within the period."""
        del place
        last = float(motion.time[-1])
        grid = tuple(float(value) for value in np.arange(0.0, last, 0.25))
        return (
            ShapeParameter("start_s", "s", grid, 0.0, last, logarithmic=False),
            ShapeParameter("duration_s", "s", (0.2, 0.5, 1.2), 0.05, 0.4 * last),
            *PROFILE,
        )

    def columns(self, motion: Motion, place: Place, shape: Mapping[str, float]) -> Columns | None:
        """Torque of unit forces times the profile; a periodic window wraps around."""
        assert place.link is not None
        upstream = motion.robot.kinematics.upstream(place.link - 1)
        since = motion.time - shape["start_s"]
        if motion.periodic:
            since = since % (motion.samples * motion.sampling_period_s)
        factor = profile(since, 0.0, shape)
        touched = factor > 0.0
        values = np.zeros((motion.samples, len(upstream), 3))
        forces = unit_forces(motion, motion.position[touched], place.link) @ point_weights(motion, place.link, shape)
        values[touched] = factor[touched, None, None] * forces[:, list(upstream)]
        return Columns(upstream, values)

    def parameters(self, estimate: Estimate) -> tuple[Parameter, ...]:
        """Force and window."""
        return force_parameters(estimate)

    def sentence(self, estimate: Estimate) -> str:
        """One sentence for the operator."""
        return (
            f"In every period something pushes against link {estimate.place.link} with up to "
            f"{float(np.linalg.norm(estimate.coefficients)):.3g} N for {estimate.shape['duration_s']:.3g} s, "
            f"{estimate.shape['start_s']:.3g} s after the period begins."
        )


PROFILE = (
    ShapeParameter("sharpness", "", (1.0,), 0.05, 4.0),
    ShapeParameter("skew", "", (1.0,), 0.3, 3.0),
)


def profile(time: FloatArray, start_s: float, shape: Mapping[str, float]) -> FloatArray:
    """sin(π u^a)^s of u = (t − start)/duration, 0 outside the window. Same shape as time."""
    u = (time - start_s) / shape["duration_s"]
    inside = (u > 0.0) & (u < 1.0)
    result = np.zeros_like(u)
    result[inside] = np.sin(np.pi * u[inside] ** shape.get("skew", 1.0)) ** shape.get("sharpness", 1.0)
    return result


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


def force_parameters(estimate: Estimate) -> tuple[Parameter, ...]:
    """Size and components of the force, start and duration."""
    force, covariance = estimate.coefficients, estimate.covariance
    size = float(np.linalg.norm(force))
    along = force / size if size > 0.0 else np.zeros(3)
    std = np.sqrt(np.diag(covariance))
    shape, shape_std = estimate.shape, estimate.shape_std
    return (
        Parameter("force", size, float(np.sqrt(along @ covariance @ along)), "N"),
        *(Parameter(f"force_{axis}", float(force[i]), float(std[i]), "N") for i, axis in enumerate("xyz")),
        Parameter("start", shape["start_s"], shape_std.get("start_s", np.nan), "s"),
        Parameter("duration", shape["duration_s"], shape_std.get("duration_s", np.nan), "s"),
    )
