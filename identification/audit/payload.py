"""The mass, centre and inertia of a tool, from recordings without and with it.

Both are explained by one arm, τ = Y δ, and those with the tool by ten parameters of a body on the last link besides;
friction and offsets may differ between the two as from day to day, and the scale of all torques. Pure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from identification.arrays import BoolArray, FloatArray
from identification.audit.audit import STILL_ITS_OWN
from identification.audit.basis import root_of
from identification.audit.colour import Colour, colour_of
from identification.audit.columns import INERTIAL, PARAMETERS, SYMBOLS, Geometry, SetUp
from identification.audit.comparison import ALL, LEAST_GAIN, PARTS, as_friction_turns_over
from identification.audit.difference import Number, numbers_of
from identification.audit.evidence import Products, log_evidence, posterior, products_of
from identification.audit.given import DAILY_FRICTION, DAILY_OFFSET, DRIVE, WIDEST, Sizes, sizes_of, wide_open
from identification.audit.hypotheses import LOAD_SIZES
from identification.audit.mount import misplaced
from identification.audit.otherwise import CHANGING, FILTERED, other_reading
from identification.audit.rows import Rows, rows_of
from identification.audit.scales import factor_of, weighted_by_odds
from identification.audit.signs import require_stated_signs
from identification.errors import EstimationError, RecordingError
from identification.fitting.agreement import serial_numbers
from identification.fitting.drives import CLEAR
from identification.fitting.processing import SMALLEST_MOTION
from identification.mismatch.settings import CAPTURE
from identification.physical_parameters import symmetric
from identification.recordings.independence import refuse_repeated
from identification.recordings.recording import Recording
from identification.robots.flange import Flange
from identification.robots.model import RobotModel, refuse_followers

TOOLS_REACH_M = 1.0
"""Half of an interval that is wider says nothing of where a load sits."""
_TURNS = 6
_LOAD_DATA = ("M", "X", "Y", "Z", "A", "B", "C", "JX", "JY", "JZ")
_INERTIA = ("xx", "yy", "zz", "xy", "xz", "yz")


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A load: mass kg, center (3) m, inertia about its centre (6) kg m², xx yy zz xy xz yz.

    frame: which one it is in, in words: the flange's where the robot has one, else the last link's. rms_before,
    rms_after: (n,) Nm of the recordings with it, without and with the body. seconds: of motion, the shorter side's.
    torque_ratio: of the same torque as it reads with the load to without, of ratio_joint (from 0) or of all (None).
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
    torque_ratio: Number
    ratio_joint: int | None

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
    Raises RecordingError for recordings at rest or too short, for one that is given twice, for one whose torque has the
    wrong sign, for one that has to be read otherwise (`other_reading`) and for those of two arms, EstimationError where
    no load can be seen, it is beyond reason, or one does not describe them.
    """
    refuse_followers(robot, "weigh a load on")
    _refuse_two_serial_numbers([*without, *with_load])
    last = Flange(robot.n - 1, np.eye(3), np.zeros(3))
    flange = robot.flange if robot.flange is not None and robot.flange.link == last.link else last
    frame = "the flange" if flange is not last else f"link {robot.n}, whose frame ends the arm's description"
    runs = [_of_moving_joints(rows_of(recordings)) for recordings in (without, with_load)]
    refuse_repeated([*without, *with_load])
    require_stated_signs([*without, *with_load], robot, "no load can be weighed with it")
    _refuse_misread([*without, *with_load], robot)
    sizes = sizes_of(robot, runs[0])
    turning = as_friction_turns_over([Geometry(robot, rows) for rows in runs], SetUp.of(robot), sizes)
    runs = [each.rows for each in turning]
    columns = [_columns(robot, rows, loaded) for loaded, rows in enumerate(runs)]
    width = _prior(sizes, robot.n, [last.link], _widest(sizes))
    products, weight, every = _fitted(runs, columns, width, sizes)
    own = _body_on(last.link, robot.n)
    found = weighted_by_odds(products, weight, width, np.arange(own.start, own.stop))
    values, covariance = found.values, found.covariance
    bare, *rms = _left(runs, every, found.likeliest, own)
    if abs(values[0]) > _widest(sizes):
        raise EstimationError(
            f"The recordings differ by {values[0]:.0f} kg on the last link, which no such arm carries: they are of "
            "different arms, or torque is not in Nm."
        )
    left, load = (float(np.linalg.norm(bare)), float(np.linalg.norm(rms[1]))), float(np.linalg.norm(rms[0]))
    alone = [_left_alone(*side, width, sizes.first_noise) for side in zip(runs, columns, strict=True)]
    # Of exact recordings what the rows are known to is left, and how much of it is no other cause.
    least = float(np.linalg.norm(sizes.least_noise))
    _refuse_undescribed(max(left[0], least), max(left[1], least), load, robot.torque_unit)
    _refuse_two_arms(left, np.maximum(alone, least), load, robot)
    _refuse_elsewhere(runs, columns, sizes, robot)
    if abs(values[0]) < CLEAR * float(np.sqrt(covariance[0, 0])):
        raise EstimationError(
            f"No load can be seen: {values[0]:z.2f} ± {1.96 * float(np.sqrt(covariance[0, 0])):.2f} kg. Record a "
            "motion that turns the wrist through its range, without and with the tool."
        )
    seconds = min(sum(item.duration_s for item in side) for side in (without, with_load))
    numbers = _in_frame(values, covariance, lambda body: _physical(body, flange))
    return Body(frame, numbers[0], numbers[1:4], numbers[4:], rms[0], rms[1], seconds, found.ratio, found.joint)


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


def _refuse_two_serial_numbers(recordings: Sequence[Recording]) -> None:
    if len(arms := serial_numbers(recordings)) > 1:
        raise RecordingError(
            f"The logs are of {len(arms)} arms (serial numbers {', '.join(arms)}), which differ by more than a tool: "
            "record one arm without and with it."
        )


def _refuse_two_arms(left: Sequence[float], alone: FloatArray, load: float, robot: RobotModel) -> None:
    """Two arms of as many joints leave much of both sides, so neither stands out: an arm for each side leaves little.

    left, alone: RMS of the side without and with the tool, all joints together, beside one arm and load, and beside an
    arm of its own. load: as above.
    """
    for side, both, own in zip(("without", "with"), left, alone, strict=True):
        if both >= max(STILL_ITS_OWN * own, CAPTURE * load):
            raise EstimationError(
                f"One load does not describe the difference: beside one arm {both:.3g} {robot.torque_unit} RMS stay of "
                f"the recordings {side} the tool (all joints together), beside an arm of their own {own:.3g}. "
                "Something changed while they were recorded, such as a tool picked up or put down, the two sides are "
                "of different arms, or something other than the tool differs. `iiwa-ident compare` says what."
            )


def _refuse_misread(recordings: Sequence[Recording], robot: RobotModel) -> None:
    """Torques under other joints or in scales of their own make another load as exact as the true one. What else a
    recording may be leaves much of the load, or widens its interval.
    """
    for recording in recordings:
        read = other_reading(recording, robot)
        scales = read.sentence if read is not None and read.kind not in (*CHANGING, FILTERED) else ""
        if said := misplaced([recording], robot) or scales:
            raise RecordingError.at(
                recording.source.path, f"as it stands, no load can be weighed with it. {said.rstrip('.')}.", field="tau"
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


def _of_moving_joints(rows: Rows) -> Rows:
    """Without a joint that never moves: of its weight friction holds any share, another one in each run."""
    return replace(rows, used=rows.used & (np.ptp(rows.position, axis=0) >= SMALLEST_MOTION))


def _columns(robot: RobotModel, rows: Rows, loaded: int) -> FloatArray:
    """(R, n, 28 n): the arm, a body on each link, what friction and offset differ by, and room for the joints' scales.

    All but the arm's are of the loaded run only.
    """
    n = robot.n
    arm = Geometry(robot, rows).columns(np.array(robot.gravity))
    bodies = arm.reshape(*arm.shape[:2], n, PARAMETERS)[..., :INERTIAL].reshape(*arm.shape[:2], INERTIAL * n)
    drives = [PARAMETERS * joint + SYMBOLS.index(symbol) for joint in range(n) for symbol in ("FV", "FS", "OFF")]
    return np.concatenate([arm, loaded * bodies, loaded * arm[..., drives], np.zeros((*arm.shape[:2], n))], axis=2)


def _body_on(link: int, n: int) -> slice:
    """Columns of the body on a link, from 0."""
    return slice(PARAMETERS * n + INERTIAL * link, PARAMETERS * n + INERTIAL * (link + 1))


def _prior(sizes: Sizes, n: int, links: Sequence[int], mass_kg: float) -> FloatArray:
    """(28 n,) standard deviations of all columns' prior where bodies are on these links only.

    Torques are taken to differ from day to day by no larger share than friction does.
    """
    length = float(sizes.length.max())
    bodies = np.zeros((n, INERTIAL))
    bodies[list(links)] = mass_kg * np.array([1.0, *3 * [length], *6 * [length**2]])
    table = sizes.each.reshape(n, PARAMETERS)
    daily = np.column_stack(
        [DAILY_FRICTION * table[:, INERTIAL : INERTIAL + 2], DAILY_OFFSET / DRIVE * table[:, INERTIAL + 2]]
    )
    return np.concatenate([wide_open(sizes), bodies.ravel(), daily.ravel(), np.full(n, DAILY_FRICTION)])


def _widest(sizes: Sizes) -> float:
    """kg, the largest load."""
    return WIDEST * float(sizes.mass.mean())


def _fitted(runs: Sequence[Rows], columns: Sequence[FloatArray], width: FloatArray, sizes: Sizes) -> tuple[
    Products, FloatArray, FloatArray
]:  # fmt: skip
    """The products of an estimate weighted by what it leaves itself beside one scale for all joints, its weights (n,),
    and the columns of all rows with those of the scales. width: as `_prior` gives it.

    The loaded runs' torque of a joint is (1 + s) times the model's, so its scale's column is what the model predicts.
    """
    torque, used, before, block = (
        np.concatenate([getattr(rows, name) for rows in runs]) for name in ("torque", "used", "before", "block")
    )
    every, colour, count = np.concatenate(columns), Colour.white(sizes.first_noise), len(runs[0].used)
    n, live = torque.shape[1], np.flatnonzero(width > 0.0)
    joints = np.arange(n)
    for turn in range(_TURNS):
        weight = 1.0 / colour.std**2
        white = colour.innovations(every, before), colour.innovations(torque, before)
        products = products_of(*white, used, block % PARTS, PARTS)
        estimate = posterior(*products.summed(ALL, weight), factor_of(width, np.ones(n)))
        left = np.where(used, torque - every @ estimate.values, 0.0)
        # What the first estimate is uncertain by follows from a guess at the noise.
        spread = estimate.covariance[np.ix_(live, live)] if turn else np.zeros((len(live), len(live)))
        colour = colour_of(left, used, every[..., live] @ root_of(spread, width[live]))
        colour = replace(colour, std=np.maximum(colour.std, sizes.least_noise))
        every[count:, joints, joints - n] = every[count:, :, :-n] @ estimate.values[:-n]
    return products, weight, every


def _left(runs: Sequence[Rows], every: FloatArray, values: FloatArray, own: slice) -> list[tuple[float, ...]]:
    """(n,) RMS that values of all columns leave: of the runs without a load; of those with it without and with it."""
    count, loaded = len(runs[0].used), runs[1].used
    left = np.concatenate([rows.torque for rows in runs]) - every @ values
    body = every[count:, :, own] @ values[own]
    sides = ((left[:count], runs[0].used), (left[count:] + body, loaded), (left[count:], loaded))
    return [_rms(np.where(used, each, 0.0), used) for each, used in sides]


def _refuse_elsewhere(runs: Sequence[Rows], columns: Sequence[FloatArray], sizes: Sizes, robot: RobotModel) -> None:
    """What hangs on another link has a mass, a centre and intervals at the flange, too: those of no body. The same
    where it hangs there besides the tool. Both are asked beside no scale and one of all torques, in the noise that
    bodies on all links leave: what one at the flange alone leaves has in it what is asked for.
    """
    n, last, mass = robot.n, robot.n - 1, LOAD_SIZES * float(sizes.mass.mean())
    products, weight, _ = _fitted(runs, columns, _prior(sizes, n, range(n), mass), sizes)
    gram, right = products.summed(ALL, weight)

    def gained(links: list[int], scales: FloatArray) -> float:
        width = _prior(sizes, n, links, mass)
        return max(log_evidence(gram, right, factor_of(width, joints)) for joints in scales)

    none_or_all = np.array([np.zeros(n), np.ones(n)])
    own = max(gained([], none_or_all), gained([last], np.vstack([none_or_all, np.eye(n)])))
    for other, said in (([], "do not differ by a load at the flange: one"), ([last], "differ by more: a second load")):
        nats = np.array([gained([link, *other], none_or_all) for link in range(last)])
        if nats.max(initial=-np.inf) > own + LEAST_GAIN:
            links = " or ".join(str(link + 1) for link in np.flatnonzero(nats > nats.max() - LEAST_GAIN))
            raise EstimationError(
                f"The recordings {said} on link {links} explains them far better. Let nothing but the tool differ "
                "between them; `iiwa-ident compare` asks for other causes."
            )


def _left_alone(rows: Rows, columns: FloatArray, width: FloatArray, std: FloatArray) -> float:
    """RMS of all joints together that the arm leaves of one side where it is fitted to that side only."""
    arm = slice(0, PARAMETERS * len(std))
    products = products_of(columns[..., arm], rows.torque, rows.used, rows.block % PARTS, PARTS)
    values = posterior(*products.summed(ALL, 1.0 / std**2), width[arm]).values
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
