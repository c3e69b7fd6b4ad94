"""The torque regressor Y(q, q̇, q̈) of eq. (5) for many samples at once.

Here: rigid-body columns of the ten dynamic parameters of each link, eq. (3), computed with numpy over all samples in
chunks. Not here: columns of joint friction and drives, grouping to base parameters (`base_parameters`). Pinocchio
computes the same rigid-body columns one sample at a time; the tests hold the two together.

How it works: the unit twist (z, u) of every joint upstream of link j is carried along the chain to the origin of link
j's frame: z the axis, u the velocity it gives the origin (z = 0 and u the direction for a prismatic joint). The torque
that a moment n and a force f at that origin cause at joint k is z_k·n + u_k·f (the transposed Jacobian), and n and f of
a unit parameter are linear in ω ωᵀ, α and a: a constant table of 6 × 18 numbers per parameter. Angular velocity and
acceleration and the origin's acceleration are carried by the same rotation (recursion of Luh, Walker and Paul, 1980).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from identification.arrays import BoolArray, FloatArray
from identification.robots.model import Kinematics, RobotModel

INERTIAL_SYMBOLS = ("M", "MX", "MY", "MZ", "XX", "XY", "XZ", "YY", "YZ", "ZZ")
"""The inertial part of eq. (3), in the order of the regressor's columns."""

# Long enough that numpy's calls cost little, short enough that a link's arrays stay in a core's cache.
CHUNK = 2500
_FIRST_WITHOUT_FORCE = 4
_ALL_PARAMETERS = tuple(range(len(INERTIAL_SYMBOLS)))


def torque_regressor(robot: RobotModel, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """Rigid-body regressor Y, τ = Y · (π_1, …, π_n), with ten inertial parameters per link in the order of eq. (3).

    q, dq, ddq: (S, n) rad, rad/s, rad/s² (m for prismatic joints). Returns (S, n, 10 n), Nm per unit of the parameter.
    Link frames are the joint frames; the tensor entries are those about the frame's origin, eq. (4). Raises ValueError
    when the three arrays are not of one shape (S, n).
    """
    return _matrix_of(robot, q, dq, ddq, [_ALL_PARAMETERS] * robot.n)


def rigid_body_columns(
    robot: RobotModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, wanted: Sequence[Sequence[int]]
) -> Iterator[tuple[slice, FloatArray]]:
    """Chosen columns of the rigid-body regressor, chunk by chunk: (slice of samples, array (columns, n, samples)).

    wanted: per link the positions of the parameters in eq. (3), 0 (M) to 9 (ZZ), ascending. The array is reused by the
    next chunk: copy what is to be kept.
    """
    samples = _check_states(robot.n, q, dq, ddq)
    columns = np.zeros((sum(map(len, wanted)), robot.n, min(samples, CHUNK)))
    firsts = [0, *itertools.accumulate(map(len, wanted))][:-1]
    chain = _Chain(robot, wanted, firsts, min(samples, CHUNK))
    for rows in _chunks(samples):
        chunk = columns[..., : rows.stop - rows.start]
        chain.columns(q[rows], dq[rows], ddq[rows], chunk)
        yield rows, chunk


def link_columns(
    robot: RobotModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, link: int, entries: Sequence[int]
) -> FloatArray:
    """(S, n, len(entries)) torque per unit of some parameters of one link (from 0), by their positions in eq. (3)."""
    return _matrix_of(robot, q, dq, ddq, [entries if other == link else () for other in range(robot.n)])


def _matrix_of(
    robot: RobotModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, wanted: Sequence[Sequence[int]]
) -> FloatArray:
    """(S, n, columns) what `rigid_body_columns` gives, in one array."""
    result = np.empty((_check_states(robot.n, q, dq, ddq), robot.n, sum(map(len, wanted))))
    for rows, columns in rigid_body_columns(robot, q, dq, ddq, wanted):
        result[rows] = columns.transpose(2, 1, 0)
    return result


def fill_rigid_body_columns(
    robot: RobotModel,
    states: tuple[FloatArray, FloatArray, FloatArray],
    wanted: Sequence[Sequence[int]],
    firsts: Sequence[int],
    out: FloatArray,
) -> None:
    """Chosen columns written where they are to be kept, out (columns, n, S); not where a joint feels nothing of a link.

    states: q, q̇, q̈, each (S, n). wanted: as for `rigid_body_columns`. firsts: per link the place of its first column.
    """
    samples = _check_states(robot.n, *states)
    chain = _Chain(robot, wanted, firsts, min(samples, CHUNK))
    for rows in _chunks(samples):
        q, dq, ddq = (state[rows] for state in states)
        chain.columns(q, dq, ddq, out[..., rows])


def _chunks(samples: int) -> Iterator[slice]:
    for start in range(0, samples, CHUNK):
        yield slice(start, min(start + CHUNK, samples))


def _check_states(n: int, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> int:
    if q.ndim != 2 or q.shape[1] != n or q.shape != dq.shape or q.shape != ddq.shape:
        raise ValueError(
            f"positions, velocities and accelerations must all have shape (samples, {n}), "
            f"not {q.shape}, {dq.shape}, {ddq.shape}"
        )
    return len(q)


def _unit_wrenches() -> FloatArray:
    """Moment n and force f about a link's origin for unit parameters of eq. (3), as (10, 6, 18) times [ω ωᵀ, ω, α, a].

    f = m a + α × h + ω × (ω × h) and n = I α + ω × I ω + h × a, with h = (MX, MY, MZ) and I of eq. (4) about the
    origin; a is the origin's acceleration. ω ωᵀ are nine products, row by row; nothing depends on ω alone.
    """
    unit = np.eye(3)
    cross = np.array([[np.cross(unit[j], unit[k]) for k in range(3)] for j in range(3)]).transpose(2, 0, 1)
    table = np.zeros((10, 6, 18))
    products, _, alpha, linear = np.split(table, (9, 12, 15), axis=2)
    linear[0, 3:] = unit
    for i in range(3):
        h = unit[i]
        alpha[1 + i, 3:] = np.einsum("ijk,k->ij", cross, h)
        products[1 + i, 3:] = (np.einsum("ij,l->ijl", unit, h) - np.einsum("i,jl->ijl", h, unit)).reshape(3, 9)
        linear[1 + i, :3] = np.einsum("ijk,j->ik", cross, h)
    for parameter, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), start=4):
        tensor = np.zeros((3, 3))
        tensor[i, j] = tensor[j, i] = 1.0
        alpha[parameter, :3] = tensor
        products[parameter, :3] = np.einsum("ijk,kl->ijl", cross, tensor).reshape(3, 9)
    return table


_UNIT_WRENCHES = _unit_wrenches()


@dataclass(frozen=True, slots=True, eq=False)
class _Link:
    """What is constant about one link and its joint.

    turn: (9, 3) rotation from the parent's frame as a factor of (1, cos q, sin q), Rodrigues' formula. fixed: its rows
    with one entry that does not depend on q, as (row, column, entry). blocks: of the other rows, which entries, rows
    and columns, are not zero throughout. offset, slide: (3,) arm from the parent's origin, offset + slide · q; moved:
    its entries other than zero. revolute, axis: (3,) of the joint; twist: (6, 1) its z and u. coriolis: (3, 4) what
    (ω q̇, q̈) adds to the angular acceleration, prismatic: to the origin's. with_force, without_force: rows of the table
    of unit wrenches for the mass and first moments (6 k, 18) and for the tensor (3 m, 15), which causes no force and
    feels no a; own (k + m, 18): the power of all of them at the joint itself. columns, joints: where its columns go,
    joints from the base outwards, its own last; serial: whether these are the first ones.
    """

    parent: int
    turn: FloatArray
    fixed: tuple[tuple[int, int, float], ...]
    blocks: tuple[tuple[slice, slice], ...]
    offset: FloatArray
    slide: FloatArray
    moved: tuple[int, ...]
    revolute: bool
    axis: FloatArray
    twist: FloatArray
    coriolis: FloatArray
    with_force: FloatArray
    without_force: FloatArray
    own: FloatArray
    columns: slice
    joints: tuple[int, ...]
    serial: bool

    @classmethod
    def of(cls, kinematics: Kinematics, link: int, wanted: Sequence[int], first: int) -> _Link:
        axis, placement = kinematics.axis[link], kinematics.rotation[link]
        revolute = bool(kinematics.revolute[link])
        along, crossed = np.outer(axis, axis), skew(axis)
        if revolute:
            turn = np.stack([placement @ along, placement @ (np.eye(3) - along), placement @ crossed], axis=-1)
        else:
            turn = np.stack([placement, np.zeros((3, 3)), np.zeros((3, 3))], axis=-1)
        slide = np.zeros(3) if revolute else placement @ axis
        with_force = [parameter for parameter in wanted if parameter < _FIRST_WITHOUT_FORCE]
        without_force = list(wanted[len(with_force) :])
        turn = turn.transpose(1, 0, 2)
        used = np.asarray(turn.any(axis=-1))
        fixed = np.flatnonzero((used.sum(axis=1) == 1) & ~turn[..., 1:].any(axis=(1, 2)))
        single = [(int(row), int(np.flatnonzero(used[row])[0])) for row in fixed]
        upstream = kinematics.upstream(link)
        return cls(
            parent=int(kinematics.parent[link]),
            turn=turn.reshape(9, 3),
            fixed=tuple((row, column, float(turn[row, column, 0])) for row, column in single),
            blocks=_blocks(used, [row for row in range(3) if row not in fixed]),
            offset=kinematics.translation[link],
            slide=slide,
            moved=tuple(np.flatnonzero((kinematics.translation[link] != 0.0) | (slide != 0.0)).tolist()),
            revolute=revolute,
            axis=axis,
            twist=np.concatenate([axis, np.zeros(3)] if revolute else [np.zeros(3), axis])[:, None],
            # The axis turns with ω; a slide moves along it in a turning frame besides, Coriolis' factor of two.
            coriolis=np.column_stack([-crossed if revolute else -2.0 * crossed, axis]),
            with_force=_UNIT_WRENCHES[with_force].reshape(-1, 18),
            without_force=_UNIT_WRENCHES[without_force, :3, :15].reshape(-1, 15),
            own=np.einsum("mct,c->mt", _UNIT_WRENCHES[list(wanted)].reshape(-1, 2, 3, 18)[:, int(not revolute)], axis),
            columns=slice(first, first + len(wanted)),
            joints=upstream,
            serial=upstream == tuple(range(len(upstream))),
        )


@lru_cache(maxsize=32)
def _links(kinematics: Kinematics, wanted: tuple[tuple[int, ...], ...], firsts: tuple[int, ...]) -> tuple[_Link, ...]:
    places = zip(wanted, firsts, strict=True)
    return tuple(_Link.of(kinematics, link, parameters, first) for link, (parameters, first) in enumerate(places))


class _Chain:
    """The links of a robot with the arrays that one chunk needs, used again by the next: fresh memory costs time.

    Per link the rows of one array (18 + 6 k, samples), in its own frame: ω ωᵀ (9), then the vectors that are carried
    along the chain: ω, α, a, and for each of the k upstream joints z and u, the link's own joint last. The components
    stand next to the samples, so that sums over them run in the innermost cache.
    """

    def __init__(self, robot: RobotModel, wanted: Sequence[Sequence[int]], firsts: Sequence[int], samples: int) -> None:
        self._links = _links(robot.kinematics, tuple(map(tuple, wanted)), tuple(firsts))
        self._coupling = [_coupling(robot, link) for link in self._links] if robot.mimics else []
        self._turn = np.array([link.turn for link in self._links])
        self._axes = np.array([link.axis for link in self._links])[:, :, None]
        # In a chain a link's rows are of no use once the next link has its own: two arrays in turn stay in the cache.
        height = 18 + 6 * max(len(link.joints) for link in self._links)
        in_turn = all(link.parent == index - 1 for index, link in enumerate(self._links))
        arrays = [np.empty((height, samples)) for _ in range(2 if in_turn else len(self._links))]
        self._rows = [
            arrays[index % len(arrays)][: 18 + 6 * len(link.joints)] for index, link in enumerate(self._links)
        ]
        # A base accelerating upwards stands for gravity: accelerations are "minus gravity".
        self._base = np.zeros((18, samples))
        self._base[15:18] = -robot.gravity[:, None]
        self._turns = np.ones((robot.n, 3, samples))
        self._rotations = np.empty((robot.n, 9, samples))
        self._joint = np.empty((4, samples))
        self._wrench = np.empty((6 * max(map(len, wanted)), samples))

    def columns(self, q: FloatArray, dq: FloatArray, ddq: FloatArray, out: FloatArray) -> None:
        """Write the wanted columns of states (samples, n) into out (columns, n, samples)."""
        q, dq, ddq = (np.ascontiguousarray(state.T, dtype=np.float64) for state in (q, dq, ddq))
        samples = q.shape[1]
        turns = self._turns[..., :samples]
        # tan is vectorised by numpy where cos and sin are not, and cos² + sin² = 1 to rounding in any case.
        half = np.tan(0.5 * q)
        ratio = 2.0 / (1.0 + half * half)
        np.subtract(ratio, 1.0, out=turns[:, 1])
        np.multiply(ratio, half, out=turns[:, 2])
        rotations = np.matmul(self._turn, turns, out=self._rotations[..., :samples]).reshape(-1, 3, 3, samples)
        spin = self._axes * dq[:, None]
        for index, link in enumerate(self._links):
            parent = (self._rows[link.parent] if link.parent >= 0 else self._base)[:, :samples]
            rows = self._rows[index][:, :samples]
            self._carry(link, parent, rotations[index], q[index], rows)
            self._add_joint(link, rows, spin[index], dq[index], ddq[index])
            self._project(link, rows, out[link.columns])
            if self._coupling:
                _to_leaders(self._coupling[index], out[link.columns])

    def _carry(self, link: _Link, parent: FloatArray, rotation: FloatArray, q: FloatArray, child: FloatArray) -> None:
        """Express the parent's vectors at the child's origin and in the child's frame."""
        products, vectors = parent[:9].reshape(3, 3, len(q)), parent[9:].reshape(-1, 3, len(q))
        if link.moved:
            vectors = vectors.copy()
            angular, linear = vectors[1::2], vectors[2::2]  # α and a, and every pair z and u
            for k in link.moved:
                i, j = (k + 1) % 3, (k + 2) % 3
                arm = link.offset[k] + link.slide[k] * q if link.slide[k] else link.offset[k]
                linear[:, i] += angular[:, j] * arm
                linear[:, j] -= angular[:, i] * arm
                # ω × (ω × arm), of the acceleration alone
                linear[0, i] += products[i, k] * arm
                linear[0, j] += products[j, k] * arm
                linear[0, k] -= (products[i, i] + products[j, j]) * arm
        carried = child[9 : 9 + 3 * len(vectors)].reshape(len(vectors), 3, len(q))
        for child_row, parent_row, factor in link.fixed:
            np.multiply(vectors[:, parent_row], factor, out=carried[:, child_row])
        for rows, columns in link.blocks:
            np.einsum("jis,vis->vjs", rotation[rows, columns], vectors[:, columns], out=carried[:, rows])

    def _add_joint(self, link: _Link, rows: FloatArray, spin: FloatArray, dq: FloatArray, ddq: FloatArray) -> None:
        """The joint's own motion, spin its axis times q̇; then the products ω ωᵀ."""
        rows[-6:] = link.twist
        omega = rows[9:12]
        joint = self._joint[:, : len(dq)]
        np.multiply(omega, dq, out=joint[:3])
        joint[3] = ddq
        if link.revolute:
            rows[12:15] += link.coriolis @ joint
            omega += spin
        else:
            rows[15:18] += link.coriolis @ joint
        np.multiply(omega[:, None], omega, out=rows[:9].reshape(3, 3, len(dq)))

    def _project(self, link: _Link, rows: FloatArray, out: FloatArray) -> None:
        """Power of each unit twist on the wrench of each wanted parameter; out is (wanted, n, samples)."""
        samples = rows.shape[1]
        upstream, last = len(link.joints) - 1, link.joints[-1]
        np.matmul(link.own, rows[:18], out=out[:, last])
        if upstream == 0:
            return
        axes = rows[18:-6].reshape(upstream, 6, samples)
        place = slice(0, 0)
        for table, components in ((link.with_force, 6), (link.without_force, 3)):
            count = len(table) // components
            place = slice(place.stop, place.stop + count)
            if count == 0:
                continue
            wrench = np.matmul(table, rows[: table.shape[1]], out=self._wrench[: len(table), :samples])
            wrench = wrench.reshape(count, components, samples)
            if link.serial:
                np.einsum("mcs,kcs->mks", wrench, axes[:, :components], out=out[place, :upstream])
            else:  # a branch of a tree: its upstream joints are not the first ones
                out[place, list(link.joints[:-1])] = np.einsum("mcs,kcs->mks", wrench, axes[:, :components])


def _coupling(robot: RobotModel, link: _Link) -> list[tuple[int, int, float, bool]]:
    """(follower, leader, multiplier, whether the leader has a torque of this link by itself or from another)."""
    known, found = set(link.joints), []
    for follower, leader, multiplier, _ in robot.followers:
        if follower in link.joints:
            found.append((follower, leader, multiplier, leader in known))
            known.add(leader)
    return found


def _to_leaders(coupling: Sequence[tuple[int, int, float, bool]], out: FloatArray) -> None:
    """The power of a joint that follows is its leader's: τ of the leader gets multiplier · τ of the follower, which has
    none of its own (virtual work). out: (columns, n, samples).
    """
    for follower, leader, multiplier, known in coupling:
        torque = multiplier * out[:, follower]
        if known:
            out[:, leader] += torque
        else:
            out[:, leader] = torque
        out[:, follower] = 0.0


def _blocks(used: BoolArray, rows: Sequence[int]) -> tuple[tuple[slice, slice], ...]:
    """Rectangles (rows, columns) that hold all entries in use of some rows of a (3, 3) matrix, each row in one."""
    rows_of: dict[tuple[int, ...], list[int]] = {}
    for row in rows:
        rows_of.setdefault(tuple(np.flatnonzero(used[row])), []).append(row)
    return tuple((_slice(rows), _slice(columns)) for columns, rows in rows_of.items())


def _slice(chosen: Sequence[int]) -> slice:
    """At most three ascending numbers below 3 as a slice, which needs no copy."""
    step = chosen[1] - chosen[0] if len(chosen) > 1 else 1
    return slice(int(chosen[0]), int(chosen[-1]) + 1, int(step))


def skew(vector: FloatArray) -> FloatArray:
    """The matrices S(v), (…, 3, 3), of the vector product with vectors (…, 3): S(v) w = v × w."""
    out = np.zeros((*vector.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -vector[..., 2], vector[..., 1]
    out[..., 1, 0], out[..., 1, 2] = vector[..., 2], -vector[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -vector[..., 1], vector[..., 0]
    return out
