"""Base parameters: the smallest set of combinations of dynamic parameters that determines every torque (section 2.3).

Here: which parameters a robot's motion can tell apart, how the others are grouped into them (π_b = K π), their names
in Khalil's form and units, and the fast regressor of just these columns. Not here: estimating values (`estimators`).
Excitation design, fits and diagnosis all build on `BaseRegressor`.

The grouping is numeric: columns of the regressor at random states are taken in link order, and a column is kept if it
is independent of those kept before it. For the iiwa 14 this picks the paper's 43 inertial representatives, and K
equals eq. (6) (with XX_5 for the misprinted XZ_5 in XXR_5) to rounding.

Order of preference: inertial parameters of all links first, then FV, FS, OFF, IA. So a rotor inertia that no motion
can tell from a link inertia (joint 1 of a robot on a fixed base) has no entry of its own: it is grouped into ZZR_1.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from identification.arrays import FloatArray, IntArray
from identification.regressor import INERTIAL_SYMBOLS, fill_rigid_body_columns, rigid_body_columns, torque_regressor
from identification.robots.model import RobotModel

if TYPE_CHECKING:
    from identification.physical_parameters import PhysicalParameters

_INERTIAL_COUNT = len(INERTIAL_SYMBOLS)
_INERTIAL_UNITS = ("kg",) + 3 * ("kg m",) + 6 * ("kg m^2",)
_EXTRA_UNITS = {"FV": "Nm s/rad", "FS": "Nm", "IA": "kg m^2", "OFF": "Nm"}
_EXTRA_UNITS_PRISMATIC = {"FV": "N s/m", "FS": "N", "IA": "kg", "OFF": "N"}

# Table 2 writes ZZR_7 for a parameter that nothing is grouped into.
_PAPER_NAMES: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {"iiwa14": {"ZZ_7": "ZZR_7"}, "iiwa7": {"ZZ_7": "ZZR_7"}}
)

_GROUPING_SEED = 20170711
_INDEPENDENCE_TOLERANCE = 1e-8
_COEFFICIENT_TOLERANCE = 1e-10


Widths = float | tuple[float, ...]
"""Velocity over which Coulomb friction turns over, rad/s (m/s): of all joints, or of each. 0: sign(q̇)."""
WIDTH = "coulomb_velocity"


@dataclass(frozen=True, slots=True)
class RegressorOptions:
    """Which effects stand beside the rigid body, each as one parameter per joint.

    viscous: FV_i, friction per velocity. coulomb: FS_i, times sign(q̇_i). rotor_inertia: IA_i, the drive's inertia seen
    at the joint; wanted where torque is measured on the motor side. offset: OFF_i, a constant torque. coulomb_velocity:
    rad/s (m/s) over which Coulomb friction turns over, times tanh(q̇_i/v) then; 0: sign(q̇_i), eq. (1). One for all
    joints, or one for each.
    """

    viscous: bool = True
    coulomb: bool = True
    rotor_inertia: bool = False
    offset: bool = False
    coulomb_velocity: Widths = 0.0

    @property
    def symbols(self) -> tuple[str, ...]:
        """Symbols of the chosen effects in the order of the columns: FV, FS, IA, OFF."""
        chosen = (("FV", self.viscous), ("FS", self.coulomb), ("IA", self.rotor_inertia), ("OFF", self.offset))
        return tuple(symbol for symbol, wanted in chosen if wanted)

    @property
    def turns_gently(self) -> bool:
        """Whether Coulomb friction of any joint turns over gently."""
        return bool(np.any(np.asarray(self.coulomb_velocity) > 0.0))

    def to_json(self) -> dict[str, Any]:
        """Every option by name, as plain JSON types."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> RegressorOptions:
        """The options a file notes; one that an older file does not name has its default.

        Raises TypeError or ValueError for a value that is none, such as a width below zero.
        """
        known = cls().to_json()
        chosen = {name: type(default)(data[name]) for name, default in known.items() if name in data and name != WIDTH}
        return cls(**chosen, coulomb_velocity=widths_of(data.get(WIDTH, 0.0)))

    def __post_init__(self) -> None:
        widths = np.asarray(self.coulomb_velocity)
        if not np.all((widths >= 0.0) & (widths < np.inf)):
            raise ValueError(f"{WIDTH} is {self.coulomb_velocity}; it must be a number from 0 on")


class BaseRegressor:
    """The regressor of a robot's base parameters, τ = Y_b(q, q̇, q̈) π_b, with their names, units and origin.

    names: p names; those of the iiwa 14 are Table 2's, in its order (per link inertial parameters, then FV, FS, and
    IA, OFF where chosen). An R before the index marks a parameter that others are grouped into. units: p units.
    full_names: names of all dynamic parameters, eq. (3), per link. regrouping: (p, full) matrix K with π_b = K π.
    kept: (p,) positions in full_names of the parameters that represent their group; K[:, kept] is the identity.
    """

    def __init__(self, robot: RobotModel, options: RegressorOptions | None = None) -> None:
        self.robot = robot
        self.options = options if options is not None else RegressorOptions()
        symbols = self.options.symbols
        self.full_names = tuple(
            f"{symbol}_{link}" for link in range(1, robot.n + 1) for symbol in INERTIAL_SYMBOLS + symbols
        )
        kept, regrouping = _group(robot, symbols)
        self.kept: IntArray = kept
        self.regrouping: FloatArray = regrouping
        for array in (self.kept, self.regrouping):
            array.setflags(write=False)
        self.names = self._base_names()
        self.units = tuple(self._unit(int(position)) for position in kept)
        self._stride = _INERTIAL_COUNT + len(symbols)
        links, entries = kept // self._stride, kept % self._stride
        self._wanted = [entries[(links == link) & (entries < _INERTIAL_COUNT)].tolist() for link in range(robot.n)]
        self._inertial_columns = np.flatnonzero(entries < _INERTIAL_COUNT)
        self._firsts = np.searchsorted(links, range(robot.n)).tolist()
        # (column, symbol, joint) of every parameter that is not inertial
        self._extra_columns = [
            (int(column), symbols[int(entries[column]) - _INERTIAL_COUNT], int(links[column]))
            for column in np.flatnonzero(entries >= _INERTIAL_COUNT)
        ]

    @cached_property
    def ungrouping(self) -> FloatArray:
        """(full, p) matrix that gives the smallest dynamic parameters of base parameters."""
        return np.asarray(np.linalg.pinv(self.regrouping), dtype=np.float64)

    @property
    def size(self) -> int:
        """Number p of base parameters."""
        return len(self.names)

    def position_of(self, name: str) -> int:
        """Column of a parameter; `ZZ_7` and `ZZR_7` are the same. Raises KeyError for a name this robot has not."""
        if name in self.names:
            return self.names.index(name)
        plain = [plain_name(own) for own in self.names]
        if plain_name(name) in plain:
            return plain.index(plain_name(name))
        raise KeyError(f"{self.robot.name} has no base parameter {name}; it has {', '.join(self.names)}")

    def matrix(self, q: FloatArray, dq: FloatArray, ddq: FloatArray, direction: FloatArray | None = None) -> FloatArray:
        """Regressor of the base parameters. q, dq, ddq: (S, n) rad, rad/s, rad/s². Returns (S, n, p).

        direction: (S, n), what Coulomb friction is proportional to; None: `direction_of` the velocity.
        """
        if direction is None:
            direction = direction_of(dq, self.options.coulomb_velocity)
        result = np.zeros((len(q), self.robot.n, self.size))
        for rows, columns in rigid_body_columns(self.robot, q, dq, ddq, self._wanted):
            result[rows, :, self._inertial_columns] = columns.transpose(2, 1, 0)
        for column, symbol, joint in self._extra_columns:
            result[:, joint, column] = _extra_values(symbol, joint, dq, ddq, direction)
        return result

    def torque(
        self, values: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray, direction: FloatArray | None = None
    ) -> FloatArray:
        """Torque (S, n) Nm of base parameters (p,), `matrix` times them without the matrix, which takes longer to write
        than to compute. The rest as there.
        """
        if direction is None:
            direction = direction_of(dq, self.options.coulomb_velocity)
        result = np.empty((len(q), self.robot.n))
        for rows, columns in rigid_body_columns(self.robot, q, dq, ddq, self._wanted):
            result[rows] = np.tensordot(values[self._inertial_columns], columns, 1).T
        for column, symbol, joint in self._extra_columns:
            result[:, joint] += values[column] * _extra_values(symbol, joint, dq, ddq, direction)
        return result

    def stacked(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> tuple[FloatArray, IntArray]:
        """The observation matrix (8) joint by joint: ((n S, p) column-major, joint of each row counted from 0).

        Row joint · S + sample belongs to `torque.T.ravel()`. Twice as fast as `matrix`, which has to transpose, and in
        the order of memory that LAPACK works on without a copy.
        """
        samples = len(q)
        columns = np.zeros((self.size, self.robot.n, samples))
        direction = direction_of(dq, self.options.coulomb_velocity)
        fill_rigid_body_columns(self.robot, (q, dq, ddq), self._wanted, self._firsts, columns)
        for column, symbol, joint in self._extra_columns:
            columns[column, joint] = _extra_values(symbol, joint, dq, ddq, direction)
        return columns.reshape(self.size, -1).T, np.repeat(np.arange(self.robot.n), samples)

    def joint_columns(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> list[tuple[FloatArray, IntArray]]:
        """Per joint the columns that can be other than zero: (array (m, S), positions (m,) among the base parameters).

        A third of the memory of `stacked`, and nothing is written or looked through in vain: what a fit reads.
        """
        if self.robot.mimics:  # a leader's torque depends on the links beyond its followers too
            matrix, every = self.matrix(q, dq, ddq), np.arange(self.size)
            return [(np.ascontiguousarray(matrix[:, joint].T), every) for joint in range(self.robot.n)]
        inertial = self._inertial_columns
        own = [[extra for extra in self._extra_columns if extra[2] == joint] for joint in range(self.robot.n)]
        # A joint's torque depends on the links beyond it: of its first columns nothing is written. Where the arm
        # branches, nothing is written of the links on other branches either, and these are zero.
        branches = bool(np.any(self.robot.kinematics.parent != np.arange(-1, self.robot.n - 1)))
        packed = (np.zeros if branches else np.empty)((self.robot.n, len(inertial) + max(map(len, own)), len(q)))
        firsts = np.searchsorted(inertial, self._firsts).tolist()
        fill_rigid_body_columns(self.robot, (q, dq, ddq), self._wanted, firsts, packed.transpose(1, 0, 2))
        direction, result = direction_of(dq, self.options.coulomb_velocity), []
        for joint, (first, extras) in enumerate(zip(firsts, own, strict=True)):
            for place, (_, symbol, _) in enumerate(extras, start=len(inertial)):
                packed[joint, place] = _extra_values(symbol, joint, dq, ddq, direction)
            positions = np.concatenate([inertial[first:], [column for column, _, _ in extras]])
            result.append((packed[joint, first : len(inertial) + len(extras)], positions.astype(np.int64)))
        return result

    def base_from_full(self, full: FloatArray) -> FloatArray:
        """π_b = K π, eq. (6) for the iiwa. full: (full,) in the order of full_names. Returns (p,)."""
        return np.asarray(self.regrouping @ full, dtype=np.float64)

    def base_from_physical(self, physical: PhysicalParameters) -> FloatArray:
        """The base parameters of a set of physical parameters, eqs. (4) and (6); drives and offsets count as zero."""
        return self.base_from_full(self.full_from_physical(physical))

    def base_from_other(self, other: BaseRegressor, values: FloatArray) -> FloatArray:
        """Base parameters (p,) of the same arm, given those of a regressor that has other effects beside its links.

        Effects that this one has not are dropped, and those that the other has not are zero. Which parameters are
        grouped depends on the effects: on a lift a rotor's inertia and a constant force make up a mass.
        """
        known = {other.full_names[place]: value for place, value in zip(other.kept, values, strict=True)}
        return self.base_from_full(np.array([known.get(name, 0.0) for name in self.full_names]))

    def full_from_physical(self, physical: PhysicalParameters) -> FloatArray:
        """The dynamic parameters π of a set of physical parameters, eq. (4), in the order of full_names."""
        symbols = self.options.symbols
        table = np.zeros((self.robot.n, _INERTIAL_COUNT + len(symbols)))
        table[:, :_INERTIAL_COUNT] = physical.dynamic_parameters()
        if "FV" in symbols:
            table[:, _INERTIAL_COUNT + symbols.index("FV")] = physical.viscous
        if "FS" in symbols:
            table[:, _INERTIAL_COUNT + symbols.index("FS")] = physical.coulomb
        return table.ravel()

    def extra_of(self, full: FloatArray, symbol: str) -> FloatArray:
        """Entries FV, FS, IA or OFF of all joints (n,) in dynamic parameters (full,); 0 if not among the options."""
        symbols = self.options.symbols
        if symbol not in symbols:
            return np.zeros(self.robot.n)
        return full.reshape(self.robot.n, -1)[:, _INERTIAL_COUNT + symbols.index(symbol)].copy()

    def _base_names(self) -> tuple[str, ...]:
        paper_names = _PAPER_NAMES.get(self.robot.name, {})
        names = []
        for row, position in zip(self.regrouping, self.kept, strict=True):
            name = self.full_names[position]
            if np.count_nonzero(row) > 1:
                symbol, index = name.rsplit("_", 1)
                name = f"{symbol}R_{index}"
            names.append(paper_names.get(name, name))
        return tuple(names)

    def _unit(self, position: int) -> str:
        link, entry = divmod(position, _INERTIAL_COUNT + len(self.options.symbols))
        if entry < _INERTIAL_COUNT:
            return _INERTIAL_UNITS[entry]
        units = _EXTRA_UNITS if self.robot.kinematics.revolute[link] else _EXTRA_UNITS_PRISMATIC
        return units[self.options.symbols[entry - _INERTIAL_COUNT]]


def plain_name(name: str) -> str:
    """The name without the mark of a regrouped parameter."""
    return re.sub(r"^(M|MX|MY|MZ|XX|XY|XZ|YY|YZ|ZZ|FV|FS|IA|OFF)R_", r"\1_", name)


def direction_of(velocity: FloatArray, coulomb_velocity: Widths) -> FloatArray:
    """What Coulomb friction is proportional to: sign(q̇), 0 at rest, or tanh(q̇/v) where v > 0 is given, rad/s.

    velocity: (..., n) of all joints, or of any shape where one width is given.
    """
    widths = np.asarray(coulomb_velocity)
    sharp = widths == 0.0
    if sharp.all():
        return np.sign(velocity)
    return np.asarray(np.where(sharp, np.sign(velocity), np.tanh(velocity / np.where(sharp, 1.0, widths))))


def width_of(coulomb_velocity: Widths, joint: int) -> float:
    """The width of one joint (from 0)."""
    return coulomb_velocity[joint] if isinstance(coulomb_velocity, tuple) else coulomb_velocity


def widths_of(values: ArrayLike) -> Widths:
    """Widths (n,) as the options hold them: one number where all are the same. Raises TypeError, ValueError."""
    widths = np.asarray(values, dtype=np.float64)
    if widths.ndim > 1 or not widths.size:
        raise ValueError(f"{WIDTH} is {values!r}; it is one number, or one for each joint")
    every = tuple(np.atleast_1d(widths).tolist())
    return every[0] if len(set(every)) == 1 else every


def told_widths(coulomb_velocity: Widths, robot: RobotModel) -> str:
    """Such as "±9.8 mrad/s" or, of an arm with a lift, "±9.8 mrad/s and ±2.1 mm/s"."""
    widths = np.broadcast_to(coulomb_velocity, robot.n)
    revolute = robot.kinematics.revolute
    told = [
        f"±{1e3 * width:.1f} {unit}"
        for unit, own in (("mrad/s", revolute), ("mm/s", ~revolute))
        for width in np.unique(widths[own & (widths > 0.0)])
    ]
    return " and ".join(told)


def _extra_values(
    symbol: str, joint: int, dq: FloatArray, ddq: FloatArray, direction: FloatArray
) -> FloatArray | float:
    """The one non-zero entry per sample of a friction, drive or offset column."""
    match symbol:
        case "FV":
            return dq[:, joint]
        case "FS":
            return direction[:, joint]
        case "IA":
            return ddq[:, joint]
        case _:
            return 1.0


def _group(robot: RobotModel, symbols: tuple[str, ...]) -> tuple[IntArray, FloatArray]:
    """Positions of the kept parameters in full order, sorted, and the regrouping matrix K (p, full)."""
    generator = np.random.default_rng(_GROUPING_SEED)
    stride = _INERTIAL_COUNT + len(symbols)
    samples = 30 + 4 * stride
    q = generator.uniform(-np.pi, np.pi, (samples, robot.n))
    dq = generator.uniform(-2.0, 2.0, (samples, robot.n))
    ddq = generator.uniform(-4.0, 4.0, (samples, robot.n))
    for follower, leader, multiplier, offset in robot.followers:
        q[:, follower] = multiplier * q[:, leader] + offset
        dq[:, follower], ddq[:, follower] = multiplier * dq[:, leader], multiplier * ddq[:, leader]
    full = np.zeros((samples, robot.n, robot.n, stride))
    full[..., :_INERTIAL_COUNT] = torque_regressor(robot, q, dq, ddq).reshape(samples, robot.n, robot.n, -1)
    for place, symbol in enumerate(symbols, start=_INERTIAL_COUNT):
        for joint in robot.driven:  # friction and rotor of a joint that follows are part of its leader's
            full[:, joint, joint, place] = _extra_values(symbol, joint, dq, ddq, np.sign(dq))
    columns = full.reshape(samples * robot.n, robot.n * stride)
    kept = independent_columns(columns, _order_of_preference(robot.n, symbols))
    coefficients = np.asarray(np.linalg.lstsq(columns[:, kept], columns, rcond=None)[0], dtype=np.float64)
    coefficients[np.abs(coefficients) < _COEFFICIENT_TOLERANCE] = 0.0
    coefficients[:, kept] = np.eye(len(kept))
    return kept, coefficients


def _order_of_preference(n: int, symbols: tuple[str, ...]) -> IntArray:
    """Positions in full order: inertial parameters link by link, then FV, FS, OFF, and IA last."""
    stride = _INERTIAL_COUNT + len(symbols)
    positions = np.arange(n * stride).reshape(n, stride)
    extras = sorted(range(len(symbols)), key=lambda place: ("FV", "FS", "OFF", "IA").index(symbols[place]))
    parts = [positions[:, :_INERTIAL_COUNT].ravel(), *(positions[:, _INERTIAL_COUNT + place] for place in extras)]
    return np.concatenate(parts).astype(np.int64)


def independent_columns(columns: FloatArray, order: IntArray) -> IntArray:
    """The columns, tried in `order`, that are independent of those kept before: an unpivoted QR that skips the rest.

    columns: (rows, count). Returns the kept positions, sorted. A column whose norm is below 1e-10 of the largest is
    dropped before anything is normalised: MZ_2 of the iiwa is rounding noise, which normalised looks independent.
    """
    norms = np.linalg.norm(columns, axis=0)
    floor = 1e-10 * norms.max(initial=0.0)
    basis = np.empty((columns.shape[0], columns.shape[1]), order="F")
    kept: list[int] = []
    for position in order:
        if norms[position] <= floor:
            continue
        residual = columns[:, position] / norms[position]
        for _ in range(2):  # orthogonalising twice leaves rounding errors only
            residual = residual - basis[:, : len(kept)] @ (basis[:, : len(kept)].T @ residual)
        length = float(np.linalg.norm(residual))
        if length > _INDEPENDENCE_TOLERANCE:
            basis[:, len(kept)] = residual / length
            kept.append(int(position))
    return np.array(sorted(kept), dtype=np.int64)
