"""The mass, centre and inertia of a tool, from recordings without and with it.

Both are explained by one arm, τ = Y δ, and those with the tool by ten parameters of a body on the last link besides;
friction and offsets may differ between the two as from day to day. Pure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from identification.arrays import BoolArray, FloatArray
from identification.audit.audit import STILL_ITS_OWN
from identification.audit.colour import Colour, colour_of
from identification.audit.columns import INERTIAL, PARAMETERS, SYMBOLS, Geometry
from identification.audit.comparison import ALL, PARTS
from identification.audit.difference import Number, numbers_of
from identification.audit.evidence import Estimate, Products, as_they_scatter, posterior, products_of
from identification.audit.given import DAILY_FRICTION, DAILY_OFFSET, DRIVE, WEIGHS, WIDEST, Sizes, sizes_of, wide_open
from identification.audit.rows import Rows, rows_of
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import EstimationError, RecordingError
from identification.mismatch.data_faults.torque_signs import signs_of
from identification.mismatch.settings import CAPTURE
from identification.physical_parameters import symmetric
from identification.recordings.independence import refuse_repeated
from identification.recordings.recording import Recording
from identification.robots.flange import Flange
from identification.robots.model import RobotModel, refuse_followers

TOOLS_REACH_M = 1.0
"""Half of an interval that is wider says nothing of where a load sits."""
_TURNS = 3
_LOAD_DATA = ("M", "X", "Y", "Z", "A", "B", "C", "JX", "JY", "JZ")
_INERTIA = ("xx", "yy", "zz", "xy", "xz", "yz")


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A load: mass kg, center (3) m, inertia about its centre (6) kg m², xx yy zz xy xz yz.

    frame: which one it is in, in words: the flange's where the robot has one, else the last link's. rms_before,
    rms_after: (n,) Nm of the recordings with it, without and with the body. seconds: of motion, the shorter side's.
    What these motions leave open has no value: an arm whose joints are all parallel never shows where along them a load
    sits.
    """

    frame: str
    mass: Number
    center: tuple[Number, ...]
    inertia: tuple[Number, ...]
    rms_before: tuple[float, ...]
    rms_after: tuple[float, ...]
    seconds: float

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of numbers whose interval says nothing: wider than tools reach, or than the inertia of such a one."""
        largest = [*3 * [TOOLS_REACH_M], *6 * [abs(self.mass.value) * TOOLS_REACH_M**2]]
        numbers = (*self.center, *self.inertia)
        return tuple(item.name for item, limit in zip(numbers, largest, strict=True) if half_interval(item) > limit)

    def seconds_for(self, center_m: float) -> float:
        """How long either motion has to be for the coordinates of the centre to be known within ± center_m, 95 %.

        By noise that averages out: σ goes with one over the root of the time. Of those that the motion determines;
        infinite where it determines none.
        """
        known = [half_interval(item) for item in self.center if item.name not in self.undetermined]
        return self.seconds * (max(known, default=np.inf) / center_m) ** 2


def weigh(robot: RobotModel, without: Sequence[Recording], with_load: Sequence[Recording]) -> Body:
    """The body on the last link that only the second recordings have.

    In the flange's frame where the robot has one on its last link, else in that link's.
    Raises RecordingError for recordings at rest or too short, for one that is given twice and for one whose torque has
    the wrong sign, EstimationError where no load can be seen, it is beyond reason, or one does not describe them.
    """
    refuse_followers(robot, "weigh a load on")
    last = Flange(robot.n - 1, np.eye(3), np.zeros(3))
    flange = robot.flange if robot.flange is not None and robot.flange.link == last.link else last
    frame = "the flange" if flange is not last else f"link {robot.n}, whose frame ends the arm's description"
    runs = [rows_of(recordings) for recordings in (without, with_load)]
    refuse_repeated([*without, *with_load])
    _refuse_turned([*without, *with_load], robot)
    sizes = sizes_of(robot, runs[0])
    columns = [_columns(robot, rows, loaded) for loaded, rows in enumerate(runs)]
    factor, width = _prior(sizes, robot.n)
    std = np.maximum(0.1 * sizes.torque, 1e-9)
    estimate, products, weight, rms, bare = _fitted(runs, columns, factor, std)
    own = slice(PARAMETERS * robot.n, PARAMETERS * robot.n + INERTIAL)
    without_one = np.array(
        [posterior(*products.summed([p for p in ALL if p != part], weight), factor).values[own] for part in ALL]
    )
    covariance = as_they_scatter(estimate.covariance[own, own], without_one)
    values = estimate.values[own]
    if abs(values[0]) > width:
        raise EstimationError(
            f"The recordings differ by {values[0]:.0f} kg on the last link, which no such arm carries: they are of "
            "different arms, or torque is not in Nm."
        )
    left, load = (bare, float(np.linalg.norm(rms[1]))), float(np.linalg.norm(rms[0]))
    _refuse_undescribed(*left, load, robot.torque_unit)
    _refuse_two_arms(left, [_left_alone(*side, factor, std) for side in zip(runs, columns, strict=True)], load, robot)
    if abs(values[0]) < WEIGHS * float(np.sqrt(covariance[0, 0])):
        raise EstimationError(
            f"No load can be seen: {values[0]:z.2f} ± {1.96 * float(np.sqrt(covariance[0, 0])):.2f} kg. Record a "
            "motion that turns the wrist through its range, without and with the tool."
        )
    seconds = min(sum(item.duration_s for item in side) for side in (without, with_load))
    numbers = _in_frame(values, covariance, lambda body: _physical(body, flange))
    return Body(frame, numbers[0], numbers[1:4], numbers[4:], *rms, seconds)


def _refuse_undescribed(without: float, with_load: float, load: float, unit: str) -> None:
    """One arm and one load leave of either side what they leave of the other: noise and friction are alike.

    without, with_load: what stays, RMS of all joints together. load: the same with the load left out, of which little
    may be something else.
    """
    if max(without, with_load) < max(STILL_ITS_OWN * min(without, with_load), CAPTURE * load):
        return
    side, most, least = ("with", with_load, without) if with_load > without else ("without", without, with_load)
    raise EstimationError(
        f"One load does not describe the recordings {side} the tool: {most:.3g} {unit} RMS stay of them (all joints "
        f"together), and {least:.3g} {unit} of the others. Something changed while they were recorded, such as a tool "
        "picked up or put down, or the two sides are of different arms. Record them again."
    )


def _refuse_two_arms(left: Sequence[float], alone: Sequence[float], load: float, robot: RobotModel) -> None:
    """Two arms of as many joints leave much of both sides, so neither stands out: an arm for each side leaves little.

    left, alone: RMS of the side without and with the tool, all joints together, beside one arm and load, and beside an
    arm of its own. load: as above.
    """
    for side, both, own in zip(("without", "with"), left, alone, strict=True):
        if both >= max(STILL_ITS_OWN * own, CAPTURE * load):
            raise EstimationError(
                f"One load does not describe the difference: beside one arm {both:.3g} {robot.torque_unit} RMS stay of "
                f"the recordings {side} the tool (all joints together), beside an arm of their own {own:.3g}. The two "
                "sides are of different arms, or something other than the tool differs. `iiwa-ident compare` says what."
            )


def _refuse_turned(recordings: Sequence[Recording], robot: RobotModel) -> None:
    """A torque with the wrong sign makes another load, or one that was taken off, as exact as the true one."""
    regressor = BaseRegressor(robot, RegressorOptions(rotor_inertia=True, offset=True))
    for recording, signs in zip(recordings, signs_of(recordings, regressor), strict=True):
        joints = [int(joint) + 1 for joint in np.flatnonzero(signs < 0.0)]
        if joints:
            which = "every joint" if len(joints) == robot.n else f"joint {', '.join(map(str, joints))}"
            raise RecordingError.at(
                recording.source.path,
                f"as it stands, no load can be weighed with it: with the torque of {which} turned it goes far better "
                "with one rigid body of positive inertia and friction. `iiwa-ident doctor --log` says what is wrong.",
                field="tau",
                joint=joints[0],
            )


def half_interval(item: Number) -> float:
    """Half of a number's 95 % interval, in its unit."""
    return 1.96 * item.std


def cabinet_load_data(body: Body) -> dict[str, float | None]:
    """M kg; X, Y, Z mm; A, B, C degrees of the principal axes (about z, y', x''); JX, JY, JZ kg m², as KUKA asks.

    Axes are turned only where a product of inertia shows and all are determined, and an inertia that does not show is
    that of a point. None for what the motions do not determine.
    """
    open_ones = _open_load_data(body.undetermined)
    mass, place = body.mass.value, [1e3 * item.value for item in body.center]
    moments, angles = np.zeros(3), np.zeros(3)
    if any(_shows(item) for item in body.inertia):
        xx, yy, zz, xy, xz, yz = (item.value for item in body.inertia)
        moments = np.array([xx, yy, zz])
        if any(_shows(item) for item in body.inertia[3:]) and not any(name in open_ones for name in _LOAD_DATA[4:]):
            principal, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
            # Each axis stands for the one that it is nearest to, so that the angles are small.
            _, order = linear_sum_assignment(-np.abs(axes))
            moments, axes = principal[order], axes[:, order] * np.sign(np.diag(axes[:, order]))
            axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
            angles = Rotation.from_matrix(axes).as_euler("ZYX", degrees=True)
    # A body that was taken off has these with the other sign; none has moments of both signs.
    moments = np.minimum(moments, 0.0) if mass < 0.0 else np.maximum(moments, 0.0)
    values = np.array([mass, *place, *angles, *moments]) + 0.0  # no zero with a sign
    return {name: None if name in open_ones else float(v) for name, v in zip(_LOAD_DATA, values, strict=True)}


def _open_load_data(undetermined: Sequence[str]) -> set[str]:
    """Of the load data, those that numbers rest on which are undetermined; axes rest on the products of inertia."""
    rests = {f"com_{axis}": axis.upper() for axis in "xyz"}
    rests |= {f"inertia_{axis}{axis}": f"J{axis.upper()}" for axis in "xyz"}
    products = {f"inertia_{entry}" for entry in _INERTIA[3:]}
    return {rests[name] for name in undetermined if name in rests} | set("ABC" if products & set(undetermined) else "")


def _shows(item: Number) -> bool:
    low, high = item.interval
    return not low <= 0.0 <= high


def _columns(robot: RobotModel, rows: Rows, loaded: int) -> FloatArray:
    """(R, n, K): the arm, the body, and what friction and offset differ by; the last two of the loaded run only."""
    arm = Geometry(robot, rows).columns(np.array(robot.gravity))
    last = arm[..., PARAMETERS * (robot.n - 1) : PARAMETERS * (robot.n - 1) + INERTIAL]
    drives = [PARAMETERS * joint + SYMBOLS.index(symbol) for joint in range(robot.n) for symbol in ("FV", "FS", "OFF")]
    return np.concatenate([arm, loaded * last, loaded * arm[..., drives]], axis=2)


def _prior(sizes: Sizes, n: int) -> tuple[FloatArray, float]:
    """The factor of all columns' prior, and the largest mass."""
    mass, length = WIDEST * float(sizes.mass.mean()), float(sizes.length.max())
    body = mass * np.array([1.0, *3 * [length], *6 * [length**2]])
    table = sizes.each.reshape(n, PARAMETERS)
    daily = np.column_stack(
        [DAILY_FRICTION * table[:, INERTIAL : INERTIAL + 2], DAILY_OFFSET / DRIVE * table[:, INERTIAL + 2]]
    )
    return block_diag(np.diag(wide_open(sizes)), np.diag(body), np.diag(daily.ravel())), mass


def _fitted(runs: Sequence[Rows], columns: Sequence[FloatArray], factor: FloatArray, std: FloatArray) -> tuple[
    Estimate, Products, FloatArray, tuple[tuple[float, ...], tuple[float, ...]], float
]:  # fmt: skip
    """The estimate weighted by what it leaves itself, its products and weights (n,), the loaded runs' RMS without and
    with the body, and what stays of the others, all joints together.
    """
    torque, used, before, block = (
        np.concatenate([getattr(rows, name) for rows in runs]) for name in ("torque", "used", "before", "block")
    )
    every, colour = np.concatenate(columns), Colour.white(std)
    for _ in range(_TURNS):
        weight = 1.0 / colour.std**2
        white = colour.innovations(every, before), colour.innovations(torque, before)
        products = products_of(*white, used, block % PARTS, PARTS)
        estimate = posterior(*products.summed(ALL, weight), factor)
        left = np.where(used, torque - every @ estimate.values, 0.0)
        colour = colour_of(left, used)
        colour = replace(colour, std=np.maximum(colour.std, 1e-9))
    own = slice(factor.shape[0] - 3 * len(std) - INERTIAL, factor.shape[0] - 3 * len(std))
    body = columns[1][..., own] @ estimate.values[own]
    count, loaded = len(runs[0].used), runs[1].used
    sides = ((left[:count], runs[0].used), (np.where(loaded, left[count:] + body, 0.0), loaded), (left[count:], loaded))
    bare, *rms = (_rms(*side) for side in sides)
    return estimate, products, weight, (rms[0], rms[1]), float(np.linalg.norm(bare))


def _left_alone(rows: Rows, columns: FloatArray, factor: FloatArray, std: FloatArray) -> float:
    """RMS of all joints together that the arm leaves of one side where it is fitted to that side only."""
    arm = slice(0, PARAMETERS * len(std))
    products = products_of(columns[..., arm], rows.torque, rows.used, rows.block % PARTS, PARTS)
    values = posterior(*products.summed(ALL, 1.0 / std**2), factor[arm, arm]).values
    left = np.where(rows.used, rows.torque - columns[..., arm] @ values, 0.0)
    return float(np.linalg.norm(_rms(left, rows.used)))


def _rms(left: FloatArray, used: BoolArray) -> tuple[float, ...]:
    """(n,) of what is left, which is zero where a row is not used."""
    return tuple(float(v) for v in np.sqrt((left**2).sum(axis=0) / np.maximum(used.sum(axis=0), 1)))


def _physical(body: FloatArray, flange: Flange) -> FloatArray:
    """(10,) mass, centre and inertia about it in the flange's frame, of parameters about the last link's origin."""
    mass = body[0]
    center = body[1:4] / mass
    about = symmetric(body[4:INERTIAL]) - mass * (center @ center * np.eye(3) - np.outer(center, center))
    about = flange.tensor(about)
    entries = about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.concatenate([[mass], flange.point(center), entries])


def _in_frame(values: FloatArray, covariance: FloatArray, form: Callable[[FloatArray], FloatArray]) -> tuple[
    Number, ...
]:  # fmt: skip
    """The numbers of a body with their deviations, linearised."""
    result = form(values)
    slopes = np.empty((len(result), len(values)))
    for column, deviation in enumerate(np.sqrt(np.diag(covariance))):
        step = np.zeros(len(values))
        step[column] = 1e-3 * deviation
        slopes[:, column] = (form(values + step) - form(values - step)) / (2e-3 * deviation)
    std = np.sqrt(np.maximum(np.diag(slopes @ covariance @ slopes.T), 0.0))
    names = ("mass", *(f"com_{axis}" for axis in "xyz"), *(f"inertia_{entry}" for entry in _INERTIA))
    units = ("kg", *3 * ("m",), *6 * ("kg m^2",))
    return numbers_of(names, result, std, units)
