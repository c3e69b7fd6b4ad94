"""What a joint's torque may depend on, without a form: a basis of functions for each class of dependence.

The functions are fixed by the ranges of the motions at hand, fitted and held out: within them their prior says how fast
a torque may change from where it was seen. Any other motion gets the same functions, faded to zero beyond. A class's
columns are scaled so that independent weights of variance v give a torque of mean square v on the motions at hand. No
measured torque is seen here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from identification.arrays import FloatArray
from identification.base_parameters import direction_of, width_of
from identification.mismatch.unknown.functions import responses, smooth_table, stops, tabulated, warped
from identification.mismatch.unknown.inputs import Inputs

SMOOTH, FINE, FINEST = (0.5, 9), (0.125, 27), (0.03125, 108)
"""Length of a function of position, in half ranges, and how many functions of that length there are."""
SPEED, LOAD = (0.3, 11), (0.5, 7)
STOP_WIDTHS = np.geomspace(0.001, 0.3, 8)
"""Widths of stop operators of position, in half ranges."""
LOAD_STOP_WIDTHS = np.geomspace(0.01, 0.3, 4)
LAGS_S = np.geomspace(0.002, 0.2, 5)
LATE = 4
"""Functions of speed that friction which follows late is made of."""
RESONANCES_HZ = np.geomspace(3.0, 35.0, 11)
DAMPING = 0.1
NOTHING = 1e-18
"""Mean square below which functions of an input that does not move are none."""
STATE_ORDER, STATE = 6, 96
"""Functions of one variable and how many products of them make a smooth function of the state of a joint."""

Part = tuple[FloatArray, FloatArray]
"""Functions (S, m) before they are centred and scaled, and their fade (S,)."""
Functions = Callable[[Inputs, int], Part]
"""Those of a joint (from 0) on a motion."""


@dataclass(frozen=True, slots=True)
class OfOther:
    """The functions that `of_one` makes of a joint, of that `offset` further out (0: its own); none where none is."""

    of_one: Functions
    offset: int

    def __call__(self, inputs: Inputs, joint: int) -> Part:
        """Those on a motion, asked for a joint (from 0)."""
        other = joint + self.offset
        if 0 <= other < inputs.motion.n:
            return self.of_one(inputs, other)
        return np.zeros((inputs.motion.samples, 1)), np.ones(inputs.motion.samples)


@dataclass(frozen=True, slots=True)
class DependenceClass:
    """One class of dependence. name: contract §6. words: for a sentence, after "a torque that".

    groups: functions of a joint (from 0), each group with a variance of its own. further: groups that are asked only on
    joints that these leave more than noise, of one joint each. coordinate: the input over which the class has a
    curve, "" where it has none. shared: the functions in `groups` are the same for all joints. background: stands for
    whatever is smooth; it is part of the model and the rival of every particular class, and nothing is said of it.
    described: names that describe the class completely. within: class whose functions hold these; where both stand on a
    joint they are one.
    """

    name: str
    words: str
    groups: tuple[Functions, ...]
    coordinate: str = ""
    shared: bool = False
    background: bool = False
    described: tuple[str, ...] = ()
    within: str = ""
    further: tuple[OfOther, ...] = ()

    def functions(self, group: int) -> Functions:
        """Those of a group; the further ones are numbered behind the others."""
        every: tuple[Functions, ...] = (*self.groups, *self.further)
        return every[group]


def _constant(inputs: Inputs, joint: int) -> Part:
    del joint
    ones = np.ones(len(inputs.position))
    return ones[:, None], ones


def _bent(place: FloatArray, kind: tuple[float, int]) -> FloatArray:
    """Functions (S, m) of one length of a place (S,), without their constant and straight parts."""
    return tabulated(smooth_table(*kind, ("one", "linear")), place)


def _position_smooth(inputs: Inputs, joint: int) -> Part:
    place = inputs.position[:, joint]
    return np.column_stack([np.clip(place, -1, 1), _bent(place, SMOOTH)]), inputs.inside("position")[:, joint]


def _position_narrow(kind: tuple[float, int]) -> Functions:
    def columns(inputs: Inputs, joint: int) -> Part:
        return _bent(inputs.position[:, joint], kind), inputs.inside("position")[:, joint]

    return columns


def _by_direction(of_position: Functions) -> Functions:
    """The same functions of the position, turned round with the direction of motion."""

    def columns(inputs: Inputs, joint: int) -> Part:
        values, inside = of_position(inputs, joint)
        return values * inputs.direction[:, joint, None], inside

    return columns


def _by_load(of_position: Functions) -> Functions:
    """The same functions of the position, as large as the load."""

    def columns(inputs: Inputs, joint: int) -> Part:
        values, inside = of_position(inputs, joint)
        load = np.clip(inputs.load[:, joint, None], -1, 1)
        return values * load, inputs.inside("load")[:, joint] * inside

    return columns


_position_fine, _position_finest = _position_narrow(FINE), _position_narrow(FINEST)


def _velocity_either_way(inputs: Inputs, joint: int) -> Part:
    speed = _speed(inputs, joint)
    return np.concatenate([_of_speed(speed), speed[:, None]], axis=1), inputs.inside("velocity")[:, joint]


def _velocity_one_way(inputs: Inputs, joint: int) -> Part:
    return _of_speed(_speed(inputs, joint)) * inputs.direction[:, joint, None], inputs.inside("velocity")[:, joint]


def _velocity_late(inputs: Inputs, joint: int) -> Part:
    """What friction adds that follows its own velocity late, by a lag or near a delay (Hess and Soom 1990)."""
    direction = inputs.direction[:, joint, None]
    friction = np.concatenate([direction, _of_speed(_speed(inputs, joint), LATE) * direction], axis=1)
    return inputs.late(friction, LAGS_S, poles=2), inputs.inside("velocity")[:, joint]


def _speed_late(inputs: Inputs, joint: int) -> Part:
    """What friction adds that turns round at once, its size as the speed was before (Armstrong-Hélouvry 1991)."""
    speed, direction = _speed(inputs, joint), inputs.direction[:, joint, None]
    now, before = _of_speed(speed, LATE), speed[:, None] - inputs.late(speed[:, None], LAGS_S)
    values = np.concatenate([(_of_speed(late, LATE) - now) * direction for late in before.T], axis=1)
    return values, inputs.inside("velocity")[:, joint]


def _speed(inputs: Inputs, joint: int) -> FloatArray:
    """(S,) speed as a share of the largest."""
    return np.minimum(np.abs(inputs.velocity[:, joint]), 1.0)


def _of_speed(speed: FloatArray, most: int = SPEED[1]) -> FloatArray:
    """Functions (S, m ≤ most) of a speed (S,), a share of the largest."""
    return tabulated(smooth_table(SPEED[0], most, ("one", "sinh")), 2.0 * warped(speed) - 1.0)


def load_functions(name: str) -> tuple[Functions, Functions]:
    """Smooth and narrow functions of a joint's load. name: "load" of the rigid links, or "torque", friction and all."""

    def smooth(inputs: Inputs, joint: int) -> Part:
        place = getattr(inputs, name)[:, joint]
        return np.column_stack([np.clip(place, -1, 1), _bent(place, LOAD)]), inputs.inside(name)[:, joint]

    def fine(inputs: Inputs, joint: int) -> Part:
        return _bent(getattr(inputs, name)[:, joint], FINE), inputs.inside(name)[:, joint]

    return smooth, fine


_load, _load_fine = load_functions("torque")


def _load_by_direction(inputs: Inputs, joint: int) -> Part:
    table = smooth_table(*LOAD, ("one",))
    values = tabulated(table, inputs.load[:, joint]) * inputs.direction[:, joint, None]
    return values, inputs.inside("load")[:, joint]


def _load_by_position(inputs: Inputs, joint: int) -> Part:
    load, position = (np.clip(values[:, joint], -1, 1) for values in (inputs.load, inputs.position))
    values = np.stack([load**i * position**k for i in (1, 2, 3) for k in (1, 2, 3)], axis=1)
    return values, inputs.inside("load")[:, joint] * inputs.inside("position")[:, joint]


def _path_memory(inputs: Inputs, joint: int) -> Part:
    values = stops(inputs.position[:, joint], STOP_WIDTHS, periodic=inputs.motion.periodic)
    return values, inputs.inside("position")[:, joint]


def _load_memory(inputs: Inputs, joint: int) -> Part:
    values = stops(inputs.torque[:, joint], LOAD_STOP_WIDTHS, periodic=inputs.motion.periodic)
    return values, inputs.inside("torque")[:, joint]


def _configuration(inputs: Inputs, joint: int) -> Part:
    del joint
    return inputs.waves, inputs.all_inside


def _state(inputs: Inputs, joint: int) -> Part:
    """Products of smooth functions of own position, own speed and the positions of all other joints.

    The leading ones of a covariance whose length is one half range in the joint's own state and two in the rest.
    """
    others = [other for other in range(inputs.motion.n) if other != joint]
    places = [("position", joint, 1.0), ("velocity", joint, 1.0), *(("position", other, 2.0) for other in others)]
    tables = [smooth_table(length, STATE_ORDER, ()) for *_, length in places]
    single = [inputs.smooth(*place, STATE_ORDER) for place in places]
    # Products that begin alike share their beginning.
    known: dict[tuple[int, ...], FloatArray] = {(): np.ones(inputs.motion.samples)}
    orders = _leading(tuple(tuple(np.linalg.norm(table, axis=0).tolist()) for table in tables))
    for order in orders:
        for length, number in enumerate(order, start=1):
            if order[:length] not in known:
                known[order[:length]] = known[order[: length - 1]] * single[length - 1][number]
    inside = inputs.all_inside * inputs.inside("velocity")[:, joint]
    return np.stack([known[order] for order in orders], axis=1), inside


@lru_cache(maxsize=16)
def _leading(sizes: tuple[tuple[float, ...], ...]) -> tuple[tuple[int, ...], ...]:
    """The STATE largest products of one function of each variable, but for the constant one, as their numbers."""
    found: list[tuple[tuple[int, ...], float]] = [((), 1.0)]
    for own in sizes:
        grown = [((*order, number), size * value) for order, size in found for number, value in enumerate(own)]
        # The rest of a product is its first functions, the largest.
        found = sorted(grown, key=lambda item: (-item[1], item[0]))[: STATE + 1]
    return tuple(order for order, _ in found if any(order))[:STATE]


def _dynamics(name: str) -> Functions:
    def columns(inputs: Inputs, joint: int) -> Part:
        values = responses(
            getattr(inputs, name)[:, joint],
            inputs.motion.sampling_period_s,
            periodic=inputs.motion.periodic,
            lags_s=LAGS_S if name == "torque" else LAGS_S[:1],
            resonances_hz=RESONANCES_HZ,
            damping=DAMPING,
        )
        return values, inputs.inside(name)[:, joint]

    return columns


def _other_torques(inputs: Inputs, joint: int) -> Part:
    load = np.delete(np.clip(inputs.torque, -1, 1), joint, axis=1)
    bending = inputs.moments[:, joint] / np.maximum(inputs.ranges.bending[joint], 1e-9)
    return np.concatenate([load, load**2, bending], axis=1), inputs.inside("torque").prod(axis=1)


def _other_motion(inputs: Inputs, joint: int) -> Part:
    """Speeds, accelerations and directions of the others; products with its own, and which way both turn together."""
    velocity, acceleration, direction = (
        np.delete(np.clip(values, -1, 1), joint, axis=1)
        for values in (inputs.velocity, inputs.acceleration, inputs.direction)
    )
    both = velocity * np.clip(inputs.velocity[:, joint, None], -1, 1)
    own, others = inputs.motion.velocity[:, joint, None], np.delete(inputs.motion.velocity, joint, axis=1)
    width = width_of(inputs.motion.coulomb_velocity, joint)
    turning = [direction_of(others + sign * own, width) for sign in (1.0, -1.0)]
    values = np.concatenate([velocity, acceleration, both, direction, *turning], axis=1)
    return values, inputs.inside("velocity").prod(axis=1)


FARTHEST = 8
"""Joints from one to another of which functions are asked alone."""


def _of_one(functions: Functions) -> tuple[OfOther, ...]:
    """The same functions of one other joint each, in the order of how much further out it is."""
    return tuple(OfOther(functions, offset) for offset in (*range(-FARTHEST, 0), *range(1, FARTHEST + 1)))


def _velocity_and_friction(inputs: Inputs, joint: int) -> Part:
    """Functions of a velocity, and the jump at standstill: of the joint's own it is one of the base parameters."""
    either, inside = _velocity_either_way(inputs, joint)
    direction = inputs.direction[:, joint, None]
    return np.concatenate([either, direction, _velocity_one_way(inputs, joint)[0]], axis=1), inside


TOLD_BY_NOISE = (_velocity_late, _speed_late)
"""Groups that are asked only where the noise is measured: what they describe nearly is what others describe.

Friction that follows late is all but what builds up over travel. Stretches without periods choose the one or the other
by chance.
"""

CLASSES: tuple[DependenceClass, ...] = (
    DependenceClass(
        "constant", "is constant", (_constant,), described=("torque_offset", "torque_sensor_drift"),
        within="own_position",
    ),
    DependenceClass(
        "own_position", "depends on its own position", (_position_smooth, _position_fine), "position",
        further=(OfOther(_position_finest, 0),),
    ),
    DependenceClass(
        "own_position_by_direction", "depends on its own position and turns round with its direction of motion",
        (_by_direction(_position_smooth), _by_direction(_position_fine)), "position",
        further=(OfOther(_by_direction(_position_finest), 0),),
    ),
    DependenceClass(
        "own_velocity", "depends on its own velocity",
        (_velocity_either_way, _velocity_one_way, _velocity_late, _speed_late), "velocity",
    ),
    DependenceClass("own_load", "depends on its own load", (_load, _load_fine), "torque"),
    DependenceClass(
        "own_load_by_direction", "depends on its own load and turns round with its direction of motion",
        (_load_by_direction,), "load",
    ),
    DependenceClass(
        "own_load_by_position", "depends on its own load and position together",
        (_load_by_position, _by_load(_position_fine)), further=(OfOther(_by_load(_position_finest), 0),),
    ),
    DependenceClass(
        "path_memory", "depends on where its path last turned round", (_path_memory,),
        described=("presliding_hysteresis",),
    ),
    DependenceClass("load_memory", "depends on where its load last turned round", (_load_memory,)),
    DependenceClass(
        "configuration", "depends on the configuration of the arm", (_configuration,), shared=True,
        further=(*_of_one(_position_smooth), *_of_one(_position_fine)),
    ),
    DependenceClass("state", "depends on the state of the joint and of its neighbours", (_state,), background=True),
    DependenceClass("torque_dynamics", "follows its own torque late, or rings with it", (_dynamics("torque"),)),
    DependenceClass(
        "acceleration_dynamics", "follows its own acceleration late, or rings with it", (_dynamics("acceleration"),)
    ),
    DependenceClass(
        "other_torques", "depends on the torques of other joints", (_other_torques,),
        further=(*_of_one(_load), *_of_one(_load_fine)),
    ),
    DependenceClass(
        "other_motion", "depends on the motion of other joints", (_other_motion,),
        further=_of_one(_velocity_and_friction),
    ),
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """The functions of one group of one class on one joint, centred and scaled on all motions.

    number: of the class in CLASSES. group: which group of it. joint: from 0. centre: (m,). scale: one number.
    """

    number: int
    group: int
    joint: int
    centre: FloatArray
    scale: float

    @classmethod
    def of(cls, number: int, group: int, joint: int, motions: Sequence[Part]) -> Basis:
        """The basis whose unit weights give a torque of mean square one, and mean zero, on some motions.

        motions: what the functions are on each of them.
        """
        if CLASSES[number].name == "constant":
            return cls(number, group, joint, np.zeros(1), 1.0)
        samples = sum(len(values) for values, _ in motions)
        centre = sum(values.sum(axis=0) for values, _ in motions) / samples
        square = sum(float(np.vdot(values, values)) for values, _ in motions) / samples - float(centre @ centre)
        return cls(number, group, joint, centre, 1.0 / np.sqrt(square) if square > NOTHING else 0.0)

    def columns(self, inputs: Inputs) -> FloatArray:
        """(S, m) torque of each unit weight on a motion."""
        return self.scaled(CLASSES[self.number].functions(self.group)(inputs, self.joint))

    def scaled(self, part: Part) -> FloatArray:
        """(S, m) torque of each unit weight, from what the functions are on a motion."""
        values, inside = part
        result = values - self.centre
        result *= (self.scale * inside)[:, None]
        return result
