"""Are these seconds, radians and newton metres? Stated units are turned to SI, and what cannot be in SI is refused.

Nothing is converted on a suspicion: the error says what the numbers look like, and the unit can be stated (in the file
as `q_unit`, `t_unit`, `dq_unit`, `tau_unit`, or with `import --unit q=deg`). Pure functions of arrays.
What no plausibility can tell (a small motion in degrees) shows in the fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.errors import RecordingError
from identification.recordings.recording import Finding, Recording
from identification.recordings.table import RawTable
from identification.recordings.velocities import LEAST_CORRELATION, unlike_velocities
from identification.robots.model import RobotModel

_DEGREE = math.pi / 180.0
UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    "q": {"rad": 1.0, "m": 1.0, "deg": _DEGREE, "mm": 1e-3},
    "dq": {"rad/s": 1.0, "m/s": 1.0, "deg/s": _DEGREE, "mm/s": 1e-3},
    "tau": {"Nm": 1.0, "N": 1.0, "mNm": 1e-3, "A": 1.0},
}
"""Quantity → unit → factor to SI. Currents (A) stay currents; the fit says what to do with them."""
_OF_ONE_KIND = {"deg": "rad", "deg/s": "rad/s", "mm": "m", "mm/s": "m/s"}
"""Units of turning joints only, or of sliding ones only, and what such joints have in SI."""
_OF_SLIDING = ("m", "mm", "m/s", "mm/s")

SLOWEST_SAMPLING_S = 1.0
SLOW_SAMPLING_S = 0.1
STANDING_RAD_S = 0.02
WHOLE_TURNS = 2.0
OVER_LIMIT = 1.0
"""Beyond its limits by this share of a joint's range, a position is in another unit; less may be another robot."""
OVER_EFFORT = 3.0
RATIO_TOLERANCE = 0.15
SHORTEST_M = 0.3
"""Between the first axis and the last: what is smaller is a device of its own kind, whose torques nobody foretells."""
LIGHTEST, HEAVIEST = 0.1, 2000.0
"""kg/m³, see `wrong_torque_unit`: 35 times below and 9 times above what arms have; a wrong prefix is 1000."""


def unknown_unit(quantity: str, unit: str) -> str:
    """Why a quantity cannot be in that unit, with what is known; empty where it can.

    Of an arm with turning and sliding joints it may be two with a comma, one for each kind: deg,mm.
    """
    units = unit.split(",")
    one_for_each = len(units) == 1 or sorted(each in _OF_SLIDING for each in units) == [False, True]
    if one_for_each and all(each in UNITS.get(quantity, {}) for each in units):
        return ""
    known = ", ".join(UNITS.get(quantity, {})) or f"only those of {', '.join(UNITS)}"
    return f"the unit of {quantity} is '{unit}'; known are {known}"


def in_si(table: RawTable, robot: RobotModel | None) -> RawTable:
    """The table in s, rad (m), rad/s (m/s), Nm (N) by its units; degrees turn revolute joints only, millimetres
    prismatic ones only. Raises RecordingError for a unit that is not known, and for one of these where no robot says
    which joints turn.
    """
    units = table.units
    for quantity, unit in units.items():
        what = unknown_unit(quantity, unit)
        if robot is None and not _OF_ONE_KIND.keys().isdisjoint(unit.split(",")):
            what = f"{quantity} is in {unit}, and which of its joints turn is not known: say so with --robot"
        if what:
            raise RecordingError.named(table.path, what, field=f"{quantity}_unit")
    revolute = (
        np.ones(table.position.shape[1], dtype=np.bool_)
        if robot is None
        else robot.kinematics.revolute[list(robot.driven)]
    )
    angle, speed = (_factors(quantity, units, revolute) for quantity in ("q", "dq"))
    optional = {
        name: _times(values, angle) if name in ("command_position", "link_position") else values
        for name, values in table.optional.items()
    }
    if "velocity" in optional:
        optional["velocity"] = _times(optional["velocity"], speed if "dq" in units else angle)
    torque = UNITS["tau"][units.get("tau", "Nm")]
    if "external_torque" in optional:
        optional["external_torque"] = _times(optional["external_torque"], torque)
    return replace(
        table,
        time=_times(table.time, UNITS["t"][units.get("t", "s")]),
        position=_times(table.position, angle),
        torque=_times(table.torque, torque),
        optional=optional,
        units=units,
        torque_unit="A" if units.get("tau") == "A" else "Nm",
    )


def _times(values: FloatArray, factor: FloatArray | float) -> FloatArray:
    return values if np.all(factor == 1.0) else values * factor


def _factors(quantity: str, units: dict[str, str], revolute: BoolArray) -> FloatArray:
    factors = np.ones(revolute.size)
    for unit in units[quantity].split(",") if quantity in units else ():
        factors[~revolute if unit in _OF_SLIDING else revolute] = UNITS[quantity][unit]
    return factors


def check_units(recording: Recording, robot: RobotModel | None) -> Recording:
    """The recording with findings on what is unlikely. Units that were stated are believed.

    Raises RecordingError naming every quantity that cannot be in SI, with the unit it looks like.
    """
    stated = recording.units_stated
    revolute = np.ones(recording.n, dtype=np.bool_) if robot is None else robot.kinematics.revolute
    suspicions: list[tuple[str, str, str]] = []
    angle = 1.0
    if "q" not in stated and (found := _position(recording, robot, revolute)):
        suspicions.append(("q", *found))
        angle = _DEGREE if "deg" in found[0].split(",") else 1.0
    if "t" not in stated and (time := _time(recording, revolute, angle)):
        suspicions.append(("t", *time))
    if "tau" not in stated and (torque := _torque(recording, robot)):
        suspicions.append(("tau", *torque))
    ratios = _velocity_ratios(recording)
    typical = float(np.nanmedian(ratios[revolute])) if np.isfinite(ratios[revolute]).any() else math.nan
    if not suspicions and math.isfinite(typical):
        suspicions += _by_ratio(typical, stated)
    if suspicions:
        said = "; ".join(sentence for _, _, sentence in suspicions if sentence)
        options = " ".join(f"--unit {quantity}={unit}" for quantity, unit, _ in suspicions)
        right = " ".join(f"--unit {quantity}={_si_of(quantity, unit)}" for quantity, unit, _ in suspicions)
        raise RecordingError.named(
            recording.source.path,
            f"{said}. Import it with {options}, or with {right} if that is right",
            field=suspicions[0][0],
        )
    notes = _outside_limits(recording, robot)
    notes += [
        f"joint {joint + 1}: the recorded velocity is {ratios[joint]:.3g} times the derivative of the position"
        for joint in np.flatnonzero(np.abs(ratios - 1.0) > RATIO_TOLERANCE)
    ]
    report = recording.report
    added = [Finding.of_all("unlikely_value", report.rows_read, note) for note in notes]
    added = [item for item in (*added, *unlike_velocities(recording)) if item not in report.findings]
    findings = tuple(sorted((*report.findings, *added), key=lambda finding: finding.first_row))
    return replace(recording, report=replace(report, findings=findings)) if added else recording


def _si_of(quantity: str, unit: str) -> str:
    return ",".join(_OF_ONE_KIND.get(each, next(iter(UNITS[quantity]))) for each in unit.split(","))


def _known_limits(robot: RobotModel | None, n: int) -> tuple[FloatArray, FloatArray]:
    """Position limits; infinite where the description has none, or an empty range, which means the same."""
    if robot is None:
        return np.full(n, -np.inf), np.full(n, np.inf)
    known = robot.position_lower < robot.position_upper
    return np.where(known, robot.position_lower, -np.inf), np.where(known, robot.position_upper, np.inf)


def _beyond(position: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """(n,) by how much of its range each joint leaves its limits; 0 inside, and where no limits are known."""
    if np.all(position.min(axis=0) >= lower) and np.all(position.max(axis=0) <= upper):
        return np.zeros(len(lower))
    span = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    low, high = np.percentile(position, [1.0, 99.0], axis=0)
    return np.asarray(np.maximum(0.0, np.maximum(high - upper, lower - low)) / span, dtype=np.float64)


def _position(recording: Recording, robot: RobotModel | None, revolute: BoolArray) -> tuple[str, str] | None:
    lower, upper = _known_limits(robot, recording.n)
    over = _beyond(recording.position, lower, upper)
    found: dict[str, str] = {}
    for unit, factor, which in (("deg", _DEGREE, revolute), ("mm", 1e-3, ~revolute)):
        wrong = which & (over > OVER_LIMIT)
        if not wrong.any():
            continue
        inside = _beyond(np.where(which, factor, 1.0) * recording.position, lower, upper)
        if not np.any(inside[which] > OVER_LIMIT):
            joint = int(np.argmax(np.where(which, over, 0.0)))
            reach = float(np.abs(recording.position[:, joint]).max())
            found[unit] = (
                f"joint {joint + 1} reaches {reach:.4g}, which no {_OF_ONE_KIND[unit]} of this robot are "
                f"({lower[joint]:.3g} to {upper[joint]:.3g}): q looks like {'degrees' if unit == 'deg' else 'mm'}"
            )
    if found:
        return ",".join(found), "; ".join(found.values())
    free = revolute & ~np.isfinite(upper)
    reach = np.abs(recording.position).max(axis=0)
    many = free & (reach > 2.0 * math.pi * WHOLE_TURNS)
    if free.sum() >= 3 and many.sum() >= 0.5 * free.sum():
        joint = int(np.argmax(np.where(free, reach, 0.0)))
        return "deg", f"joint {joint + 1} reaches {reach[joint]:.4g}, whole turns in rad: q looks like degrees"
    return None


def _time(recording: Recording, revolute: BoolArray, angle: float) -> tuple[str, str] | None:
    step = recording.sampling_period_s
    if step < SLOW_SAMPLING_S:
        return None
    speed = angle * _speed(recording)
    quickest = float(speed[revolute].max()) if revolute.any() else float(speed.max())
    if step < SLOWEST_SAMPLING_S and quickest >= STANDING_RAD_S:
        return None
    unit = next(
        (unit for unit, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)) if step * factor < SLOW_SAMPLING_S), "ns"
    )
    words = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
    return (
        unit,
        f"rows are {step:.4g} s apart and no joint turns faster than {quickest:.2g} rad/s: t looks like {words[unit]}",
    )


def _torque(recording: Recording, robot: RobotModel | None) -> tuple[str, str] | None:
    if robot is None or recording.torque_unit != "Nm":
        return None
    size = np.sqrt(np.mean(recording.torque**2, axis=0))
    limit = np.where(robot.effort > 0.0, robot.effort, np.inf)
    joint = int(np.argmax(size / limit))
    unit = robot.units[joint]
    beyond = size[joint] > OVER_EFFORT * limit[joint]
    if beyond and np.any(1e-3 * size > limit):
        raise _of_no_unit(recording, joint, f"the joint can bear {limit[joint]:.4g} {unit}", unit)
    if wrong_torque_unit(1e-3 * float(np.abs(recording.torque).max()), robot, gravity_acts=False):
        worst = int(np.argmax(np.abs(recording.torque).max(axis=0)))
        raise _of_no_unit(recording, worst, "no arm of that size bears a thousandth of it", robot.units[worst])
    if not beyond:
        return None
    return "mNm", (
        f"joint {joint + 1} has {size[joint]:.4g} {unit} RMS and can bear {limit[joint]:.4g}: tau looks like mNm"
    )


def _of_no_unit(recording: Recording, joint: int, why: str, unit: str) -> RecordingError:
    """Of torques that are too large also in the smallest unit."""
    torque = recording.torque[:, joint]
    row = int(np.argmax(np.abs(torque)))
    return RecordingError.named(
        recording.source.path,
        f"the torque of joint {joint + 1} is {torque[row]:.4g} {unit} at {recording.time[row]:.4g} s, and {why}: rows "
        "are damaged, or tau is no torque. Leave such rows out, or import it with --unit tau=Nm if that is right",
        field="tau",
        joint=joint + 1,
    )


def _speed(recording: Recording) -> FloatArray:
    """(n,) 99th percentile of |Δq/Δt|, rad/s (m/s)."""
    rate = np.abs(np.diff(recording.position, axis=0)) / np.diff(recording.time)[:, None]
    return np.asarray(np.percentile(rate, 99.0, axis=0), dtype=np.float64)


def _velocity_ratios(recording: Recording) -> FloatArray:
    """(n,) recorded velocity over the derivative of the position; nan where there is none, or the two are unlike."""
    ratios = np.full(recording.n, np.nan)
    if recording.velocity is None:
        return ratios
    span = (recording.time[2:] - recording.time[:-2])[:, None]
    derived = (recording.position[2:] - recording.position[:-2]) / span
    for joint in range(recording.n):
        given = recording.velocity[1:-1, joint]
        rows = np.isfinite(given)
        a, b = given[rows], derived[rows, joint]
        size = float(np.linalg.norm(a) * np.linalg.norm(b))
        if size > 0.0 and abs(float(a @ b)) >= LEAST_CORRELATION * size:
            ratios[joint] = float(np.linalg.norm(a) / np.linalg.norm(b)) * float(np.sign(a @ b))
    return ratios


def _by_ratio(ratio: float, stated: Sequence[str]) -> list[tuple[str, str, str]]:
    """What units would make the recorded velocity the derivative of the position."""
    explanations: list[tuple[float, tuple[tuple[str, str], ...]]] = [
        (1.0 / _DEGREE, (("dq", "deg/s"),)),
        (_DEGREE, (("q", "deg"), ("dq", "rad/s"))),
    ]
    for unit in ("ms", "us", "ns"):
        factor = 1.0 / UNITS["t"][unit]
        explanations += [
            (factor, (("t", unit),)),
            (factor * _DEGREE, (("t", unit), ("q", "deg"), ("dq", "rad/s"))),
            (factor / _DEGREE, (("t", unit), ("dq", "deg/s"))),
        ]
    for value, units in explanations:
        if abs(ratio / value - 1.0) < RATIO_TOLERANCE and not any(quantity in stated for quantity, _ in units):
            looks = " and ".join(f"{quantity} in {unit}" for quantity, unit in units)
            sentence = f"the recorded velocity is {ratio:.4g} times the derivative of the position, as with {looks}"
            return [(quantity, unit, sentence if place == 0 else "") for place, (quantity, unit) in enumerate(units)]
    return []


def _outside_limits(recording: Recording, robot: RobotModel | None) -> list[str]:
    lower, upper = _known_limits(robot, recording.n)
    notes = []
    for joint in np.flatnonzero(_beyond(recording.position, lower, upper) > 0.0):
        reach = recording.position[:, joint]
        unit = "rad" if robot is None or robot.kinematics.revolute[joint] else "m"
        notes.append(
            f"joint {joint + 1} moves from {reach.min():.4g} to {reach.max():.4g} {unit}, its limits are "
            f"{lower[joint]:.4g} and {upper[joint]:.4g}: is this the right robot, joint and unit?"
        )
    return notes


def wrong_torque_unit(torque: float, robot: RobotModel, *, gravity_acts: bool) -> str:
    """Why the largest torque of a motion cannot be in Nm, with the unit they may be in; empty where they can.

    Arms of one build are alike in torque / (9.81 m/s² · length⁴), 3.5 to 230 kg/m³ for five arms of 0.45 to 3.1 m.
    """
    kinematics = robot.kinematics
    offsets = np.linalg.norm(kinematics.translation, axis=1)
    length = float(max(offsets[list(kinematics.upstream(link)[1:])].sum() for link in range(robot.n)))
    if length < SHORTEST_M or not kinematics.revolute.all():
        return ""
    said = f"The torques reach {torque:.3g} Nm, which would hold {torque / (9.81 * length):.2g} kg at {length:.2g} m"
    if gravity_acts and torque < LIGHTEST * 9.81 * length**4:
        return (
            f"{said}: too little behind the gears of an arm of that size. So are torques before them and currents: "
            "multiply each joint's by its gear ratio and torque constant. Are they in kNm?"
        )
    return f"{said}: too much for an arm of that size. Are they in mNm?" * (torque > HEAVIEST * 9.81 * length**4)
