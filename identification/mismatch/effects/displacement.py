"""The torque that a joint's displacement makes: of a known one, and of the wind-up of a spring behind the motor.

The rigid-body quantities are those of `dynamics`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import direction_of, width_of
from identification.mismatch.effects.displaced_torque import change_of_own_torque, change_of_torque
from identification.mismatch.effects.dynamics import inertia_felt, rigid_torque, torque_derivatives
from identification.mismatch.effects.own_joint import friction_sign
from identification.mismatch.effects.time_domain import filtered, frequencies_of, time_derivative
from identification.mismatch.motion import Motion
from identification.remembered import once_per_object

_BELOW_RESONANCE, _TOO_NEAR = 0.5, 0.7
"""Frequencies, as shares of a spring's resonance, up to which a motor's motion tells its link's, and from which not."""
_SPRING_TURNS = 4
"""Turns in which the torque in a spring and its wind-up agree; each gains a factor of four at worst."""
_SETTLED = 1e-4
"""Step of the wind-up, as a share of its largest, that ends these turns."""
_STRIDES, _COARSEST_HZ, _PRODUCTS = (4, 2), 240.0, 3
"""Coarser grids that are tried, the slowest, and how many times faster than the motion its torque may be."""
_BEYOND = 1e-6
"""Share of a torque that a coarser grid may lose; of the motion's acceleration, the square."""


@once_per_object
def friction_of(motion: Motion) -> FloatArray:
    """Viscous (Nm s/rad) and Coulomb (Nm) friction of the nominal model at each joint, (n, 2)."""
    rest = motion.torque - rigid_torque(motion).torque
    result = np.zeros((motion.n, 2))
    for joint in range(motion.n):
        velocity, acceleration = motion.velocity[:, joint], motion.acceleration[:, joint]
        # A nominal model may hold the motor's inertia and a constant torque too.
        columns = np.stack([velocity, friction_sign(motion, joint), acceleration, np.ones(motion.samples)], axis=1)
        result[joint] = np.linalg.lstsq(columns, rest[:, joint])[0][:2]
    return result


def torque_of_displacement(motion: Motion, joint: int, displacement: FloatArray, size: float = 0.0) -> FloatArray:
    """Torque on all joints, (S, n), per unit of the size c when a joint's true position is the measured one plus c h.

    With the velocity and the acceleration of the displacement h (S,). The chord (ID(q + c h) − ID(q)) / c; at c = 0
    its limit ∂τ/∂q h + ∂τ/∂q̇ ḣ + ∂τ/∂q̈ ḧ. Base parameters take up nearly all of the first order, so that of what is
    left the second is no small part.
    """
    if size == 0.0:
        return np.concatenate(list(torque_of_small(motion, joint, displacement[:, None])), axis=1)
    rate = time_derivative(motion, displacement)
    growth = time_derivative(motion, rate)
    return change_of_torque(motion, joint, size * displacement, size * rate, size * growth) / size


def torque_of_small(motion: Motion, joint: int, displacements: FloatArray) -> Iterator[FloatArray]:
    """Torque on each of all joints in turn, (S, m) Nm, of each of some displacements (S, m) rad of one, to first order.

    That on all joints together is too large for a processor's memory near by.
    """
    rate = time_derivative(motion, displacements)
    growth = time_derivative(motion, rate)
    derivatives = torque_derivatives(motion, joint)
    for place in range(motion.n):
        torque = derivatives.position[:, place, None] * displacements
        torque += derivatives.velocity[:, place, None] * rate
        torque += derivatives.acceleration[:, place, None] * growth
        yield torque


def torque_behind_spring(
    motion: Motion,
    joint: int,
    wind_up: Callable[[FloatArray], FloatArray],
    compliance: float,
    *,
    carries_friction: bool = True,
) -> FloatArray:
    """Torque on all joints, (S, n), per unit of the compliance c when a joint's motion is measured before a spring.

    wind_up: u(τ) (S,) Nm, with the link at q − c u(τ_j(link)). The chord; at c = 0 its limit, without friction, whose
    jumps have none. The torque in the spring is that of the link's own motion. carries_friction: whether the joint's
    friction acts behind the spring. The wind-up is found by iteration, which converges below the resonance of link and
    spring: there q = (1 − ω²/ω_r²) link. Towards the resonance q vanishes however the link moves, and beyond it
    friction that turns round and the sensor's noise are all that q shows. So the link's motion is taken from the part
    of q that lies below; what q has above is wind-up.
    """
    if compliance == 0.0:
        return torque_of_displacement(motion, joint, -wind_up(rigid_torque(motion).torque[:, joint]))
    if not carries_friction:
        for grid in _coarse_grids(motion):
            change = _wound_up(grid, joint, wind_up, compliance, (0.0, 0.0))
            if _is_smooth(change):
                return _refined(change, motion.samples)
    viscous, coulomb = friction_of(motion)[joint] if carries_friction else (0.0, 0.0)
    return _wound_up(motion, joint, wind_up, compliance, (float(viscous), float(coulomb)))


def _wound_up(
    motion: Motion,
    joint: int,
    wind_up: Callable[[FloatArray], FloatArray],
    compliance: float,
    behind: tuple[float, float],
) -> FloatArray:
    """`torque_behind_spring` with this much viscous and Coulomb friction behind the spring."""
    rigid, (viscous, coulomb) = rigid_torque(motion).torque, behind
    width = width_of(motion.coulomb_velocity, joint)

    def friction(velocity: FloatArray) -> FloatArray:
        return np.asarray(viscous * velocity + coulomb * direction_of(velocity, width))

    measured_friction = friction(motion.velocity[:, joint])
    load = rigid[:, joint] + measured_friction
    inertia = inertia_felt(motion, joint)[:, joint]
    slowest, typical = (np.sqrt(abs(compliance) * max(float(value), 1e-9)) for value in (inertia.max(), inertia.mean()))

    frequency = np.abs(frequencies_of(motion))
    nearness = np.clip((slowest * frequency - _BELOW_RESONANCE) / (_TOO_NEAR - _BELOW_RESONANCE), 0.0, 1.0)
    share = np.cos(0.5 * np.pi * nearness) ** 2 + 0.0j
    magnified = 1.0 / (1.0 - share * (typical * frequency) ** 2)
    fast = filtered(motion, motion.position[:, joint], share - 1.0)
    displacement = np.zeros_like(load)
    for _ in range(_SPRING_TURNS):
        short = filtered(motion, -compliance * wind_up(load), share) + fast - displacement
        displacement += filtered(motion, short, magnified)
        rate = time_derivative(motion, displacement)
        moved = displacement, rate, time_derivative(motion, rate)
        turning = friction(motion.velocity[:, joint] + rate)
        load = rigid[:, joint] + change_of_own_torque(motion, joint, *moved) + turning
        if np.abs(short).max() <= _SETTLED * np.abs(displacement).max():
            break
    difference = change_of_torque(motion, joint, *moved)
    difference[:, joint] += turning - measured_friction
    return np.asarray(difference / compliance)


def _refined(values: FloatArray, samples: int) -> FloatArray:
    """Values (S', n) of a coarse grid on one of so many samples, by their Fourier coefficients."""
    lines = np.fft.rfft(np.ascontiguousarray(values.T)) * (samples / len(values))
    return np.asarray(np.fft.irfft(lines, n=samples)).T


def _is_smooth(values: FloatArray) -> bool:
    """Whether values (S', n) hold nothing in the upper quarter of what their grid can hold."""
    lines = np.abs(np.fft.rfft(values, axis=0))
    return bool(np.linalg.norm(lines[3 * len(lines) // 4 :]) <= _BEYOND * np.linalg.norm(lines))


@once_per_object
def _coarse_grids(motion: Motion) -> list[Motion]:
    """A periodic motion on every fourth and every second sample, as far as its products fit on these."""
    content = np.linalg.norm(np.fft.rfft(motion.acceleration, axis=0), axis=1)
    grids = []
    for stride in _STRIDES if motion.periodic else ():
        size = motion.samples // stride
        if motion.samples % (2 * stride) or size / (motion.samples * motion.sampling_period_s) < _COARSEST_HZ:
            continue
        if np.linalg.norm(content[size // 2 // _PRODUCTS :]) > _BEYOND**2 * np.linalg.norm(content):
            continue
        parts = (motion.time, motion.position, motion.velocity, motion.acceleration, motion.torque)
        time, position, velocity, acceleration, torque = (part[::stride] for part in parts)
        grids.append(
            replace(motion, time=time, position=position, velocity=velocity, acceleration=acceleration, torque=torque)
        )
    return grids
