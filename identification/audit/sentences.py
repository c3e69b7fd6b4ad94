"""The numbers and the sentence of each kind of difference. Pure."""

from __future__ import annotations

from math import acos, degrees

import numpy as np

from identification.arrays import FloatArray
from identification.audit.columns import HEAVY, PARAMETERS, SYMBOLS, SetUp, across
from identification.audit.difference import Difference, Number, by_so_much, numbers_of, with_interval
from identification.audit.hypotheses import Hypothesis
from identification.audit.numbers import Found
from identification.audit.shown import Step
from identification.robots.joint_units import for_prismatic
from identification.robots.model import RobotModel

_BODY = ("mass", "first_moment_x", "first_moment_y", "first_moment_z", "XX", "XY", "XZ", "YY", "YZ", "ZZ")
_BODY_UNITS = ("kg", *3 * ("kg m",), *6 * ("kg m^2",))
_FRICTION = {"FV": ("viscous", "Nm s/rad"), "FS": ("coulomb", "Nm"), "OFF": ("offset", "Nm"),
             "IA": ("rotor_inertia", "kg m^2")}  # fmt: skip
DATA_FAULTS = ("wrong_time_base", "inverted_torque_sign", "wrong_unit", "wrong_joint_order")


def difference_of(step: Step, found: Found, first: SetUp, last: SetUp, source: str, robot: RobotModel) -> Difference:
    """What a step says, with its numbers. first, last: the set-up before and after the whole search."""
    hypothesis = step.hypothesis
    std = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    joint, link, joints = _from_one(hypothesis.joint), _from_one(hypothesis.link), tuple[int, ...]()
    slides = joint is not None and not robot.kinematics.revolute[joint - 1]
    torque = "force" if slides else "torque"
    match hypothesis.effect:
        case "payload":
            numbers, text = _load(found, std, robot, link or 0)
        case "link_parameters":
            numbers = _body(hypothesis, found.values, std)
            text = f"The body of link {link} is another than {source} says"
        case "friction_change":
            numbers = _drive(hypothesis, found.values, std, slides)
            text = f"The friction of joint {joint} is another, by {by_so_much(numbers)}"
        case "torque_offset":
            numbers = _drive(hypothesis, found.values, std, slides)
            text = f"Joint {joint} has a constant {torque} of {with_interval(numbers[0])} besides"
        case "rotor_inertia" if joint is None:
            numbers, joints = _rotors(hypothesis, found.values, std, robot)
            each = ", ".join(with_interval(item) for item in numbers)
            those, are = ("those of joints", "are") if len(joints) > 1 else ("that of joint", "is")
            text = f"{source} has no rotor inertias: {those} {', '.join(map(str, joints))} {are} {each}"
        case "rotor_inertia":
            numbers = _drive(hypothesis, found.values, std, slides)
            text = f"The rotor inertia of joint {joint} is larger by {with_interval(numbers[0])}"
            if numbers[0].value < 0.0:
                text = f"The rotor inertia of joint {joint} is smaller: {with_interval(numbers[0])}"
        case "torque_sensor_gain":
            gain, alike = 1.0 + float(found.values[0]), len(first.zeros) if joint is None else 1
            # From run to run the scales scatter; that of all torques is the mean of the joints'.
            numbers = (Number("gain", gain, float(np.hypot(std[0], found.scale * gain / np.sqrt(alike))), ""),)
            where = "every joint" if joint is None else f"joint {joint}"
            text = f"The {torque} of {where} is {with_interval(numbers[0])} of what {source} expects"
            if joint is None:
                text += " (all torques or all masses: the rows cannot tell)"
        case "joint_zero_offset":
            value = last.zeros[(joint or 1) - 1] - first.zeros[(joint or 1) - 1] + float(found.values[0])
            numbers = (Number("offset", value, float(std[0]), "m" if slides else "rad"),)
            text = f"The zero of joint {joint} is off: its true position is {with_interval(numbers[0])} larger"
        case "torque_delay":
            value = last.delay_s - first.delay_s + float(found.values[0])
            numbers = (Number("delay", value, float(std[0]), "s"),)
            text = f"The torque is {'late' if value > 0 else 'early'} by {with_interval(numbers[0], 1e3, 'ms')}"
        case "wrong_time_base":
            ratio = last.ratio / first.ratio * float(np.exp(found.values[0]))
            numbers = (Number("ratio", ratio, ratio * float(std[0]), ""),)
            text = f"The clock is wrong: true rate over stated rate is {with_interval(numbers[0])}"
        case _:
            numbers, text = _tilt(found, first, last)
    others = tuple(
        (item.effect, _from_one(item.joint if item.link is None else item.link)) for item in step.alternatives
    )
    if others:
        text += ", or as likely " + ", or ".join(_in_words(effect, place, robot.n) for effect, place in others)
    sentence = f"{text}: {100.0 * step.explained:.0f} % of the difference to {source}."
    against = "recording" if hypothesis.effect in DATA_FAULTS else "model"
    return Difference(
        hypothesis.effect, joint, link, numbers, step.explained, step.gain, against, sentence, others, joints
    )


def _in_words(effect: str, place: int | None, last: int) -> str:
    match effect:
        case "payload":
            return "a load on the flange" if place == last else f"a load on link {place}"
        case "link_parameters":
            return f"another body of link {place}"
        case _:
            return effect.replace("_", " ") + ("" if place is None else f" of joint {place}")


def _from_one(place: int | None) -> int | None:
    return None if place is None else place + 1


def turned_signs(signs: FloatArray, share: float, gain: float, source: str) -> Difference:
    """Torques that are read with the wrong sign."""
    joints = [int(joint) + 1 for joint in np.flatnonzero(signs < 0.0)]
    which = "every joint" if len(joints) == len(signs) else "joint " + ", ".join(map(str, joints))
    return Difference(
        "inverted_torque_sign", joints[0] if len(joints) == 1 else None, None, (), share, gain, "recording",
        f"The torque of {which} has the wrong sign: turned, {100.0 * share:.0f} % of the difference to {source} goes.",
        joints=tuple(joints),
    )  # fmt: skip


def _load(found: Found, std: FloatArray, robot: RobotModel, link: int) -> tuple[tuple[Number, ...], str]:
    flange = robot.flange if robot.flange is not None and robot.flange.link + 1 == link else None
    mass = float(found.values[0])
    spread = float(np.hypot(std[0], found.scale * mass))
    numbers = [Number("mass", mass, spread, "kg")]
    where = "the flange" if link == robot.n else f"link {link}"
    text = f"A load of {with_interval(numbers[0])} on {where}"
    if mass < 0.0:
        text = f"{with_interval(Number('mass', -mass, spread, 'kg'))} less on {where}: a load was taken off"
    places = {int(column) % PARAMETERS: row for row, column in enumerate(found.hypothesis.columns)}
    if all(axis in places for axis in (1, 2, 3)) and mass != 0.0:
        rows = [places[axis] for axis in (1, 2, 3)]
        center = found.values[rows] / mass
        slopes = np.zeros((3, len(found.values)))
        slopes[range(3), rows], slopes[:, 0] = 1.0 / mass, -center / mass
        frame = f"in the frame of link {link}"
        if flange is not None:
            center, slopes, frame = flange.point(center), flange.rotation.T @ slopes, "from the flange"
        deviations = np.sqrt(np.maximum(np.diag(slopes @ found.covariance @ slopes.T), 0.0))
        numbers += numbers_of([f"com_{axis}" for axis in "xyz"], center, deviations, 3 * ["m"])
        text += f", centre ({', '.join(f'{round(1e3 * value)}' for value in center)}) mm {frame}"
    for place, row in places.items():
        if place >= HEAVY:
            numbers.append(Number(_BODY[place], float(found.values[row]), float(std[row]), "kg m^2"))
    return tuple(numbers), text


def _body(hypothesis: Hypothesis, values: FloatArray, std: FloatArray) -> tuple[Number, ...]:
    places = [int(column) % PARAMETERS for column in hypothesis.columns]
    return numbers_of([_BODY[place] for place in places], values, std, [_BODY_UNITS[place] for place in places])


def _drive(hypothesis: Hypothesis, values: FloatArray, std: FloatArray, slides: bool) -> tuple[Number, ...]:
    names, units = zip(*(_FRICTION[SYMBOLS[int(column) % PARAMETERS]] for column in hypothesis.columns), strict=True)
    return numbers_of(names, values, std, list(map(for_prismatic, units)) if slides else units)


def _rotors(
    hypothesis: Hypothesis, values: FloatArray, std: FloatArray, robot: RobotModel
) -> tuple[tuple[Number, ...], tuple[int, ...]]:
    """Those that are more than their own uncertainty, with their joints."""
    joints = [int(column) // PARAMETERS for column in hypothesis.columns]
    seen = [row for row in range(len(joints)) if abs(values[row]) > 1.96 * std[row]]
    unit = _FRICTION["IA"][1]
    units = [unit if robot.kinematics.revolute[joints[row]] else for_prismatic(unit) for row in seen]
    names = [f"rotor_inertia_{joints[row] + 1}" for row in seen]
    return numbers_of(names, values[seen], std[seen], units), tuple(joints[row] + 1 for row in seen)


def _tilt(found: Found, first: SetUp, last: SetUp) -> tuple[tuple[Number, ...], str]:
    size = float(np.linalg.norm(last.gravity))
    frame = across(last.gravity)
    gravity = last.gravity + size * found.values @ frame
    gravity *= size / np.linalg.norm(gravity)
    angle = acos(float(np.clip(gravity @ first.gravity / size**2, -1.0, 1.0)))
    spread = size**2 * frame.T @ found.covariance @ frame
    towards = first.gravity - gravity * float(first.gravity @ gravity) / size**2
    length = float(np.linalg.norm(towards))
    slope = towards / length / size if length > 1e-9 else frame[0] / size
    std = float(np.sqrt(max(0.0, float(slope @ spread @ slope))))
    deviations = np.sqrt(np.maximum(np.diag(spread), 0.0))
    numbers = (
        Number("angle", angle, std, "rad"),
        *numbers_of([f"gravity_{axis}" for axis in "xyz"], gravity, deviations, 3 * ["m/s^2"]),
    )
    text = (
        f"The base is turned by {with_interval(numbers[0], degrees(1.0), '°').replace(' °', '°')}: gravity is "
        f"({', '.join(f'{value:z.2f}' for value in gravity)}) m/s² in its frame"
    )
    return numbers, text
