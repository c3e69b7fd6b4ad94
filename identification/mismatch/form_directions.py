"""Directions in which the exact form of a named effect may be wrong.

The library's curve is one of many that a friction, a spring or a sensor may have. What another curve of the same effect
would leave lies along smooth functions of the effect's own coordinate, along its torque with a coefficient that varies
with the state, along its nonlinear parameters, and along the same effect at others (several hysteresis elements, a
filter of higher order). A weaker effect beside it that shows off these directions is no rest
of the stronger one's form. Called by the search when it prunes; names nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from identification.mismatch.effects.base import ShapeParameter
from identification.mismatch.extension import extend
from identification.mismatch.form import hats
from identification.mismatch.library import EffectRows, Library
from identification.mismatch.localisation import travel_since_reversal
from identification.mismatch.motion import Motion
from identification.mismatch.problem import Problem, extended, off, spread
from identification.mismatch.refinement import Member, score_of

FloatArray = npt.NDArray[np.float64]

KNOTS = 12
"""Hat functions of the effect's own coordinate."""
OWN_COORDINATE = 0.9
"""Share of an effect's energy that functions of a coordinate must hold for it to be the effect's own."""
ALIKE = 0.02
"""Difference of such shares that does not count."""
STEP = 1e-2
"""Step of a nonlinear parameter, as a share of it (of its range where that is linear)."""


def score_off_forms(
    nominal: Problem, rest: Problem, library: Library, members: Sequence[Member], index: int, stronger: Sequence[int]
) -> float:
    """Score of one member with every form that some stronger ones may have fitted along.

    nominal: the problem of the base parameters alone. rest: with all members but this one fitted.
    """
    coefficients = extend(nominal, members).coefficients
    problem = rest
    for place in stronger:
        rows = form_directions(library, members[place], coefficients[place])
        problem = extended(problem, off(problem.basis, spread(problem, members[place].rows.joints, rows)))
    return score_of(problem, members[index])


def form_directions(library: Library, member: Member, coefficients: FloatArray) -> FloatArray:
    """Rows (len(joints), R, m) of what another form of a member may add; coefficients: (m,) of all its columns."""
    joints = list(member.rows.joints)
    kind: int | None = None
    blocks = []
    for evidence in library.evidences:
        motion = evidence.motion
        torque = np.zeros((motion.samples, len(joints)))
        columns = member.effect.columns(motion, member.place, member.shape)
        if columns is not None:
            torque[:, [joints.index(joint) for joint in columns.joints]] = columns.values @ coefficients
        if np.allclose(torque, torque[0]):
            return np.zeros((len(joints), member.rows.rows.shape[1], 0))  # a constant has no other form
        directions = _varied(motion, joints, torque)
        if len(joints) == 1:
            spaces = _curves(motion, joints[0])
            kind = _own_coordinate(spaces, torque[:, 0]) if kind is None else kind
            directions = np.concatenate([directions, spaces[kind][:, None]], axis=2)
        blocks.append(evidence.project(directions))
    found = [np.concatenate(blocks).transpose(1, 0, 2)]
    grid = (library.rows(member.effect, member.place, shape) for shape in library.grid(member.effect, member.place))
    found += [other.rows for other in grid if other is not None and other.rows.shape == member.rows.rows.shape]
    for parameter in member.effect.shape_parameters(library.evidences[0].motion, member.place):
        other = None if parameter.integer else _beside(library, member, parameter)
        if other is not None:
            found.append(((other.rows - member.rows.rows) @ coefficients)[..., None])
    return np.concatenate(found, axis=2)


def _varied(motion: Motion, joints: Sequence[int], torque: FloatArray) -> FloatArray:
    """(S, len(joints), m) the torque times what its coefficient may vary with, and its change in time."""
    rate = np.gradient(torque, axis=0)
    states = (motion.position, motion.velocity, np.abs(motion.velocity), np.abs(motion.torque))
    varied = [torque * state[:, list(joints)] for state in states]
    varied += [torque * motion.position[:, list(joints)] ** 2, torque * np.abs(torque)]
    return np.stack([*varied, rate, np.gradient(rate, axis=0)], axis=2)


def _curves(motion: Motion, joint: int) -> tuple[FloatArray, ...]:
    """Spaces (S, m) of smooth functions of one coordinate, the same in both directions of motion or opposite."""
    velocity, torque = motion.velocity[:, joint], motion.torque[:, joint]
    travel = travel_since_reversal(velocity, motion.sampling_period_s)
    position, speed, way = (
        hats(values, KNOTS) for values in (motion.position[:, joint], np.abs(velocity), np.abs(travel))
    )
    load = hats(np.abs(torque), KNOTS)
    heading = np.sign(velocity)[:, None]
    opposite = [heading * space for space in (position, speed, load, way)]
    return (position, speed, hats(torque, KNOTS), *opposite, np.zeros((motion.samples, 0)))


def _own_coordinate(spaces: Sequence[FloatArray], torque: FloatArray) -> int:
    """The simplest space that holds as much of a torque (S,) as any does; the last (empty) one if none holds most."""
    energy = max(float(torque @ torque), 1e-300)
    shares = []
    for space in spaces:
        left = torque - space @ np.linalg.lstsq(space, torque, rcond=1e-10)[0] if space.size else torque
        shares.append(1.0 - float(left @ left) / energy)
    best = max(shares)
    if best < OWN_COORDINATE:
        return len(spaces) - 1
    return next(place for place, share in enumerate(shares) if share > best - ALIKE)


def _beside(library: Library, member: Member, parameter: ShapeParameter) -> EffectRows | None:
    """The member's rows with one nonlinear parameter a little off."""
    value = member.shape[parameter.name]
    step = STEP * (value if parameter.logarithmic else parameter.upper - parameter.lower)
    moved = value - step if value + step > parameter.upper else value + step
    shape = tuple((name, moved if name == parameter.name else old) for name, old in member.rows.shape)
    return library.rows(member.effect, member.place, shape)
