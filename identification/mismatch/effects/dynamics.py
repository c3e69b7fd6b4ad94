"""Rigid-body quantities that several effects need and that depend on the motion alone, computed once per motion.

Newton-Euler in link frames, vectorised over the samples, linear in the dynamic parameters: it takes the minimum-norm
parameters of a fit, which no body need have (a mass of zero with a first moment), so that a library that wants bodies
cannot serve.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.motion import Motion
from identification.regressor import INERTIAL_SYMBOLS, skew
from identification.remembered import once_per_object
from identification.robots.model import Kinematics


class RigidTorque(NamedTuple):
    """torque: (S, n) Nm. moments: n of (3, S) Nm, what link i's parent exerts on it about joint i, in link i's frame.

    base_force, base_moment: (3, S) N and Nm about the origin of the base, what the ground exerts on it, in its frame.
    """

    torque: FloatArray
    moments: list[FloatArray]
    base_force: FloatArray
    base_moment: FloatArray


class TorqueDerivatives(NamedTuple):
    """Derivatives of the inverse dynamics by one joint's motion, (S, n): the torque of each joint."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


@once_per_object
def rigid_torque(motion: Motion) -> RigidTorque:
    """Torques and joint moments of the rigid links alone: no friction, smooth."""
    return chain_of(motion).backward(links_of(motion))


@once_per_object
def links_of(motion: Motion) -> list[_Link]:
    """State of every link."""
    return chain_of(motion).forward(motion.velocity, motion.acceleration, motion.robot.gravity)


@once_per_object
def bending_moments(motion: Motion) -> FloatArray:
    """Moments about the two directions `across` each joint's axis, (S, n, 2, 3) Nm.

    Last axis: by the fitted parameters; then per unit of the two parameters behind the joint that no joint torque tells
    from those before it: a first moment along the joint's own axis (1 kg m) and equal inertia about the two axes across
    it (1 kg m²). Both look the same whether link j or the link before carries them (Khalil's regrouping of MZ_j, YY_j).
    """
    result = np.empty((motion.samples, motion.n, 2, 3))
    for joint, link in enumerate(links_of(motion)):
        axis = motion.robot.kinematics.axis[joint][:, None]
        round_inertia = np.eye(3) - axis @ axis.T
        inertial = round_inertia @ link.alpha + _cross(link.omega, round_inertia @ link.omega)
        parts = (rigid_torque(motion).moments[joint], _cross(axis, link.linear), inertial)
        result[:, joint] = np.stack([(across(axis[:, 0]) @ part).T for part in parts], axis=-1)
    return result


@once_per_object
def torque_derivatives(motion: Motion, joint: int) -> TorqueDerivatives:
    """∂τ/∂q_j, ∂τ/∂q̇_j and ∂τ/∂q̈_j of the rigid links; joint: j, from 0.

    Exact in q̈; one-sided differences of step 1e-6 in q and q̇, error about 1e-6 of the derivative.
    """
    step, unit, chain = 1e-6, np.eye(motion.n)[joint], chain_of(motion)

    def by(changed: _Chain, velocity: FloatArray) -> FloatArray:
        links = changed.forward(velocity, motion.acceleration, motion.robot.gravity, joint, links_of(motion))
        return (changed.backward(links).torque - rigid_torque(motion).torque) / step

    return TorqueDerivatives(
        by(chain.moved(joint, step), motion.velocity),
        by(chain, motion.velocity + step * unit),
        inertia_felt(motion, joint),
    )


@once_per_object
def inertia_felt(motion: Motion, joint: int) -> FloatArray:
    """∂τ/∂q̈_j, (S, n): a column of the inertia matrix along the motion; joint: j, from 0."""
    chain = chain_of(motion)
    return chain.backward(chain.alone(joint, 0.0, 1.0)).torque


@once_per_object
def tilt_torques(motion: Motion) -> FloatArray:
    """Torque per rad of tilt of the base about its x, y and z axis, (S, n, 3) Nm/rad.

    A base turned by the small vector ε sees the gravity g − ε × g.
    """
    still = np.zeros_like(motion.velocity)
    chain = chain_of(motion)
    axes = np.eye(3)
    return np.stack(
        [chain.backward(chain.forward(still, still, -np.cross(axis, motion.robot.gravity))).torque for axis in axes],
        axis=-1,
    )


@once_per_object
def rotor_reactions(motion: Motion) -> FloatArray:
    """Torque at joint i per unit of N J_r of joint k's rotor, (S, n, n), last axis k; zero unless i is upstream of k.

    The rotor's spin N q̇_k about the axis z_k, which link k − 1 carries, has the angular momentum N J_r q̇_k z_k; joint i
    feels z_i · d/dt of it.
    """
    kinematics = motion.robot.kinematics
    axes, angular_velocity = chain_of(motion).axes_in_base(motion.velocity)
    result = np.zeros((motion.samples, motion.n, motion.n))
    for joint in range(motion.n):
        carrier = int(kinematics.parent[joint])
        if carrier < 0 or not kinematics.revolute[joint]:
            continue
        axis = axes[joint]
        turning = np.cross(angular_velocity[carrier], axis, axis=0)
        momentum_rate = axis * motion.acceleration[:, joint] + turning * motion.velocity[:, joint]
        for upstream in kinematics.upstream(carrier):
            if kinematics.revolute[upstream]:
                result[:, upstream, joint] = np.sum(axes[upstream] * momentum_rate, axis=0)
    return result


@once_per_object
def chain_of(motion: Motion) -> _Chain:
    """The joints' rotations."""
    return _Chain(motion)


def across(axis: FloatArray) -> FloatArray:
    """Two unit vectors across a unit vector, (2, 3) rows, x and y for z or −z (cyclic for the others)."""
    along = int(np.argmax(np.abs(axis)))
    first = np.eye(3)[(along + 1) % 3]
    first = first - (first @ axis) * axis
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    return np.stack([first, second if axis[along] > 0.0 else -second])


class _Link(NamedTuple):
    """Angular velocity and acceleration, acceleration of the origin less gravity; force and moment its body needs."""

    omega: FloatArray
    alpha: FloatArray
    linear: FloatArray
    force: FloatArray
    moment: FloatArray


class _Chain:
    """The joints' rotations along a motion; vectors are (3, S) in their link's frame."""

    def __init__(self, motion: Motion) -> None:
        self.kinematics = motion.robot.kinematics
        self.position = motion.position.T
        self.parameters = motion.full_parameters.reshape(motion.n, -1)[:, : len(INERTIAL_SYMBOLS)]
        self.bodies = [_body(own) for own in self.parameters]
        self.rotation = [_rotation(self.kinematics, joint, angle) for joint, angle in enumerate(self.position)]
        self.arm = [_arm(self.kinematics, joint, angle) for joint, angle in enumerate(self.position)]

    def moved(self, joint: int, step: float) -> _Chain:
        """The same with one joint's position changed throughout, by so many rad (m)."""
        chain = copy(self)
        position = self.position[joint] + step
        chain.rotation, chain.arm = list(self.rotation), list(self.arm)
        chain.rotation[joint] = _rotation(self.kinematics, joint, position)
        chain.arm[joint] = _arm(self.kinematics, joint, position)
        return chain

    def forward(
        self,
        velocity: FloatArray,
        acceleration: FloatArray,
        gravity: FloatArray,
        first: int = 0,
        reference: list[_Link] | None = None,
        base_turns: tuple[FloatArray, FloatArray] | None = None,
    ) -> list[_Link]:
        """State of every link. velocity, acceleration: (S, n). Links before `first` are taken from `reference`.

        gravity: (3,) or (3, S) in the frame of the base. base_turns: its angular velocity and acceleration (3, S).
        """
        kinematics = self.kinematics
        base = _base(gravity, velocity.shape[0], base_turns)
        links = [] if reference is None else reference[:first]
        for joint in range(len(links), kinematics.n):
            parent = int(kinematics.parent[joint])
            omega, alpha, linear = links[parent][:3] if parent >= 0 else base
            arm, axis = self.arm[joint], kinematics.axis[joint]
            linear = linear + _cross(alpha, arm) + _cross(omega, _cross(omega, arm))
            omega, alpha, linear = (_into(self.rotation[joint], vector) for vector in (omega, alpha, linear))
            rate, growth = axis[:, None] * velocity[:, joint], axis[:, None] * acceleration[:, joint]
            across = (skew(-axis) @ omega) * velocity[:, joint]
            if kinematics.revolute[joint]:
                alpha = alpha + across + growth
                omega = omega + rate
            else:
                linear = linear + 2.0 * across + growth
            mass, moment, both = self.bodies[joint]
            by_alpha, by_omega = both @ alpha, both @ omega
            force = mass * linear + by_alpha[3:] + _cross(omega, by_omega[3:])
            turning = by_alpha[:3] + _cross(omega, by_omega[:3]) + moment @ linear
            links.append(_Link(omega, alpha, linear, force, turning))
        return links

    def alone(self, joint: int, rate: float, growth: float) -> list[_Link]:
        """State of every link where one joint (from 0) moves at this rate and growth, all others rest, nothing weighs.

        Wherever that joint stands: its link's state is told in the link's own frame.
        """
        samples = self.position.shape[1]
        moving = np.tile(np.eye(self.kinematics.n)[joint], (samples, 1))
        at_rest = [_Link(*np.zeros((5, 3, samples)))] * joint
        return self.forward(rate * moving, growth * moving, np.zeros(3), joint, at_rest)

    def backward(self, links: list[_Link]) -> RigidTorque:
        """Torques and joint moments that give the links these states."""
        kinematics, samples = self.kinematics, links[0].force.shape[1]
        torque = np.empty((samples, kinematics.n))
        forces, moments = [link.force for link in links], [link.moment for link in links]
        base_force, base_moment = np.zeros((2, 3, samples))
        for joint in reversed(range(kinematics.n)):
            carried = moments[joint] if kinematics.revolute[joint] else forces[joint]
            torque[:, joint] = kinematics.axis[joint] @ carried
            parent = int(kinematics.parent[joint])
            force = _out_of(self.rotation[joint], forces[joint])
            turned = _out_of(self.rotation[joint], moments[joint]) + _cross(self.arm[joint], force)
            if parent >= 0:
                forces[parent] = forces[parent] + force
                moments[parent] = moments[parent] + turned
            else:
                base_force += force
                base_moment += turned
        return RigidTorque(torque, moments, base_force, base_moment)

    def axes_in_base(self, velocity: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
        """Joint axes and angular velocities of the links in the base frame, (3, S) each."""
        orientation: list[FloatArray] = []
        axes: list[FloatArray] = []
        spins: list[FloatArray] = []
        for joint in range(self.kinematics.n):
            parent = int(self.kinematics.parent[joint])
            turned = self.rotation[joint]
            if parent >= 0:
                turned = np.einsum("ijs,jks->iks", orientation[parent], turned)
            orientation.append(turned)
            axis = np.einsum("ijs,j->is", turned, self.kinematics.axis[joint])
            axes.append(axis)
            spin = spins[parent] if parent >= 0 else np.zeros_like(axis)
            spins.append(spin + axis * velocity[:, joint] if self.kinematics.revolute[joint] else spin)
        return axes, spins


def _base(
    gravity: FloatArray, samples: int, turns: tuple[FloatArray, FloatArray] | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A base whose origin rests; accelerating upwards stands for gravity."""
    omega, alpha = turns or (np.zeros((3, samples)),) * 2
    return omega, alpha, np.broadcast_to(-gravity.reshape(3, -1), (3, samples))


def _rotation(kinematics: Kinematics, joint: int, angle: FloatArray) -> FloatArray:
    """Rotation (3, 3, S) from the joint's frame to its parent's (Rodrigues' formula)."""
    placement = kinematics.rotation[joint]
    if not kinematics.revolute[joint]:
        return np.repeat(placement[:, :, None], angle.size, axis=2)
    turn = skew(kinematics.axis[joint])
    terms = (placement, placement @ turn, placement @ turn @ turn)
    return np.asarray(
        terms[0][..., None] + terms[1][..., None] * np.sin(angle) + terms[2][..., None] * (1.0 - np.cos(angle))
    )


def _arm(kinematics: Kinematics, joint: int, position: FloatArray) -> FloatArray:
    """Origin of the joint's frame in its parent's, (3, S) or (3, 1)."""
    offset = kinematics.translation[joint][:, None]
    if kinematics.revolute[joint]:
        return np.asarray(offset)
    slide = kinematics.rotation[joint] @ kinematics.axis[joint]
    return np.asarray(offset + slide[:, None] * position)


def _body(parameters: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Mass, the first moment's cross product (3, 3), and what turning asks for: the tensor about the frame's origin
    over minus that cross product (6, 3). From the order of eq. (3).
    """
    mass, mx, my, mz, xx, xy, xz, yy, yz, zz = parameters
    moment = skew(np.array([mx, my, mz]))
    return float(mass), moment, np.concatenate([[[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], -moment])


def _into(rotation: FloatArray, vector: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ijs,is->js", rotation, vector))


def _out_of(rotation: FloatArray, vector: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ijs,js->is", rotation, vector))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(3, S) of vectors, one of which may be the same at all samples, (3, 1)."""
    if b.shape[1] == 1:
        return skew(-b[:, 0]) @ a
    if a.shape[1] == 1:
        return skew(a[:, 0]) @ b
    result = np.empty((3, max(a.shape[1], b.shape[1])))
    for row, (i, j) in zip(result, ((1, 2), (2, 0), (0, 1)), strict=True):
        np.multiply(a[i], b[j], out=row)
        row -= a[j] * b[i]
    return result
