"""The torque regressor Y(q, q̇, q̈) of eq. (5) for many samples at once, and the columns of joint friction and drives.

Here: rigid-body columns of the ten dynamic parameters of each link, eq. (3), computed with numpy over all samples in
chunks, and the diagonal columns of viscous and Coulomb friction, reflected rotor inertia and torque offset. Not here:
grouping to base parameters (`base_parameters`). Pinocchio computes the same rigid-body columns one sample at a time;
the tests hold the two together.

How it works: the unit twist (z, u) of every joint upstream of link j is carried along the chain to the origin of link
j's frame: z the axis, u the velocity it gives the origin (z = 0 and u the direction for a prismatic joint). The torque
that a moment n and a force f at that origin cause at joint k is z_k·n + u_k·f (the transposed Jacobian), and n and f of
a unit parameter are linear in ω ωᵀ, α and a: a constant table of 6 × 12 numbers per parameter. Link velocity and
spatial acceleration are twists too, so one map carries everything (Featherstone 2008, sections 2.8–2.11 and 5.3).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from identification.robots.model import Kinematics, RobotModel

FloatArray = npt.NDArray[np.float64]

INERTIAL_SYMBOLS = ("M", "MX", "MY", "MZ", "XX", "XY", "XZ", "YY", "YZ", "ZZ")
"""The inertial part of eq. (3), in the order of the regressor's columns."""

# Long enough that numpy's calls cost little, short enough that a link's arrays stay in a core's cache.
CHUNK = 1250
_FIRST_WITHOUT_FORCE = 4
_ALL_PARAMETERS = tuple(range(len(INERTIAL_SYMBOLS)))


def torque_regressor(robot: RobotModel, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """Rigid-body regressor Y, τ = Y · (π_1, …, π_n), with ten inertial parameters per link in the order of eq. (3).

    q, dq, ddq: (S, n) rad, rad/s, rad/s² (m for prismatic joints). Returns (S, n, 10 n), Nm per unit of the parameter.
    Link frames are the joint frames; the tensor entries are those about the frame's origin, eq. (4). Raises ValueError
    when the three arrays are not of one shape (S, n).
    """
    samples = _check_states(robot.n, q, dq, ddq)
    result = np.empty((samples, robot.n, len(INERTIAL_SYMBOLS) * robot.n))
    wanted = [_ALL_PARAMETERS] * robot.n
    for rows, columns in rigid_body_columns(robot, q, dq, ddq, wanted):
        result[rows] = columns.transpose(2, 1, 0)
    return result


def rigid_body_columns(
    robot: RobotModel,
    q: FloatArray,
    dq: FloatArray,
    ddq: FloatArray,
    wanted: Sequence[Sequence[int]],
    *,
    spare: int = 0,
) -> Iterator[tuple[slice, FloatArray]]:
    """Chosen columns of the rigid-body regressor, chunk by chunk: (slice of samples, array (columns, n, samples)).

    wanted: per link the positions of the parameters in eq. (3), 0 (M) to 9 (ZZ), ascending. spare: columns more at the
    end, zero at first, for the caller to fill. The array is reused by the next chunk: copy what is to be kept.
    """
    samples = _check_states(robot.n, q, dq, ddq)
    chain = _Chain(robot, wanted, min(samples, CHUNK), spare)
    for start in range(0, samples, CHUNK):
        rows = slice(start, min(start + CHUNK, samples))
        yield rows, chain.columns(*(np.ascontiguousarray(state[rows].T, dtype=np.float64) for state in (q, dq, ddq)))


def viscous_columns(velocity: FloatArray) -> FloatArray:
    """Regressor columns of viscous friction, FV_i · q̇_i, eq. (1).

    velocity: (samples, joints) rad/s. Returns (samples, joints, joints), diagonal in the last two axes.
    """
    return _diagonal(velocity)


def coulomb_columns(velocity: FloatArray) -> FloatArray:
    """Regressor columns of Coulomb friction, FS_i · sign(q̇_i), eq. (1).

    velocity: (samples, joints) rad/s. Returns (samples, joints, joints), diagonal in the last two axes.
    sign(0) is 0: a joint at rest contributes nothing.
    """
    return _diagonal(np.sign(velocity))


def rotor_inertia_columns(acceleration: FloatArray) -> FloatArray:
    """Regressor columns of the drive's inertia seen at the joint, IA_i · q̈_i (where torque is measured motor-side).

    acceleration: (samples, joints) rad/s². Returns (samples, joints, joints), diagonal in the last two axes.
    """
    return _diagonal(acceleration)


def offset_columns(velocity: FloatArray) -> FloatArray:
    """Regressor columns of a constant torque per joint, OFF_i (sensor offset; also asymmetric Coulomb friction).

    velocity: (samples, joints), used for its shape. Returns (samples, joints, joints), diagonal in the last two axes.
    """
    return _diagonal(np.ones_like(velocity, dtype=np.float64))


def _diagonal(values: FloatArray) -> FloatArray:
    samples, joints = values.shape
    columns = np.zeros((samples, joints, joints))
    columns[:, np.arange(joints), np.arange(joints)] = values
    return columns


def _check_states(n: int, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> int:
    if q.ndim != 2 or q.shape[1] != n or q.shape != dq.shape or q.shape != ddq.shape:
        raise ValueError(
            f"positions, velocities and accelerations must all have shape (samples, {n}), "
            f"not {q.shape}, {dq.shape}, {ddq.shape}"
        )
    return len(q)


def _unit_wrenches() -> FloatArray:
    """Moment n and force f about a link's origin for unit parameters of eq. (3), as (10, 6, 12) times [ω ωᵀ, α, a].

    f = m a + α × h + ω × (ω × h) and n = I α + ω × I ω + h × a, with h = (MX, MY, MZ) and I of eq. (4) about the
    origin; a is the origin's acceleration. The 12 numbers are the six products ω_i ω_j, i ≤ j, row by row, α and a.
    """
    unit = np.eye(3)
    cross = np.array([[np.cross(unit[j], unit[k]) for k in range(3)] for j in range(3)]).transpose(2, 0, 1)
    table = np.zeros((10, 6, 15))
    products, alpha, linear = np.split(table, (9, 12), axis=2)
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
    symmetric = products.reshape(10, 6, 3, 3) + products.reshape(10, 6, 3, 3).swapaxes(2, 3)
    rows, columns = np.triu_indices(3)
    symmetric = symmetric[..., rows, columns] * np.where(rows == columns, 0.5, 1.0)
    return np.concatenate([symmetric, alpha, linear], axis=2)


_UNIT_WRENCHES = _unit_wrenches()


@dataclass(frozen=True, slots=True, eq=False)
class _Link:
    """What is constant about one link and its joint.

    turn: (9, 3) rotation from the parent's frame as a factor of (1, cos q, sin q), Rodrigues' formula. blocks: which
    entries of it, rows and columns, are not zero throughout. offset, slide: (3,) arm from the parent's origin,
    offset + slide · q, moved its entries other than zero. axis: (3,) of the joint. own: components of a twist that the
    joint moves. bracket: (6, 7) with V × S in the first six columns and S in the last, S the joint's unit twist.
    with_force, without_force: rows of the table of unit wrenches for the mass and first moments (6 k, 12) and for the
    tensor (3 m, 9), which causes no force. columns, joints: where its columns go, joints from the base outwards, its
    own last; serial: whether these are the first ones.
    """

    parent: int
    turn: FloatArray
    blocks: tuple[tuple[slice, slice], ...]
    offset: FloatArray
    slide: FloatArray
    moved: tuple[int, ...]
    axis: FloatArray
    own: slice
    bracket: FloatArray
    with_force: FloatArray
    without_force: FloatArray
    columns: slice
    joints: tuple[int, ...]
    serial: bool

    @classmethod
    def of(cls, kinematics: Kinematics, link: int, wanted: Sequence[int], first: int) -> _Link:
        axis, placement = kinematics.axis[link], kinematics.rotation[link]
        along, zero, crossed = np.outer(axis, axis), np.zeros((3, 3)), -_skew(axis)
        if kinematics.revolute[link]:
            turn = np.stack([placement @ along, placement @ (np.eye(3) - along), placement @ -crossed], axis=-1)
            own, slide = slice(0, 3), np.zeros(3)
            bracket = np.block([[crossed, zero, axis[:, None]], [zero, crossed, zero[:, :1]]])
        else:
            turn = np.stack([placement, zero, zero], axis=-1)
            own, slide = slice(3, 6), placement @ axis
            bracket = np.block([[zero, zero, zero[:, :1]], [crossed, zero, axis[:, None]]])
        with_force = [parameter for parameter in wanted if parameter < _FIRST_WITHOUT_FORCE]
        without_force = list(wanted[len(with_force) :])
        turn = turn.transpose(1, 0, 2)
        upstream = kinematics.upstream(link)
        return cls(
            parent=int(kinematics.parent[link]),
            turn=turn.reshape(9, 3),
            blocks=_blocks(np.asarray(turn.any(axis=-1))),
            offset=kinematics.translation[link],
            slide=slide,
            moved=tuple(np.flatnonzero((kinematics.translation[link] != 0.0) | (slide != 0.0)).tolist()),
            axis=axis,
            own=own,
            bracket=bracket,
            with_force=_UNIT_WRENCHES[with_force].reshape(-1, 12),
            without_force=_UNIT_WRENCHES[without_force, :3, :9].reshape(-1, 9),
            columns=slice(first, first + len(wanted)),
            joints=upstream,
            serial=upstream == tuple(range(len(upstream))),
        )


@lru_cache(maxsize=32)
def _links(kinematics: Kinematics, wanted: tuple[tuple[int, ...], ...]) -> tuple[_Link, ...]:
    first = [0, *itertools.accumulate(map(len, wanted))]
    return tuple(_Link.of(kinematics, link, parameters, first[link]) for link, parameters in enumerate(wanted))


class _Chain:
    """The links of a robot with the arrays that one chunk needs, used again by the next: fresh memory costs time.

    Per link a block of twists in its own frame, (2 + k, 2, 3, samples), angular before linear: velocity, spatial
    acceleration, and the unit twist of each of the k upstream joints, the link's own last (constant in its own frame).
    The components stand next to the samples, so that sums over them run in the innermost cache.
    """

    def __init__(self, robot: RobotModel, wanted: Sequence[Sequence[int]], samples: int, spare: int) -> None:
        self._links = _links(robot.kinematics, tuple(map(tuple, wanted)))
        self._twists = [np.zeros((2 + len(link.joints), 2, 3, samples)) for link in self._links]
        for link, twists in zip(self._links, self._twists, strict=True):
            twists[-1, link.own.start // 3] = link.axis[:, None]
        # A base accelerating upwards stands for gravity: linear accelerations are "minus gravity".
        self._base = np.zeros((2, 2, 3, samples))
        self._base[1, 1] = -robot.gravity[:, None]
        self._out = np.zeros((sum(map(len, wanted)) + spare, robot.n, samples))
        self._turns = np.ones((robot.n, 3, samples))
        self._rotation = np.empty((9, samples))
        self._joint = np.empty((7, samples))
        self._motion = np.empty((12, samples))
        self._wrench = np.empty((6 * max(map(len, wanted)), samples))

    def columns(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """The wanted columns (columns, n, samples) of states (n, samples), valid until the next call."""
        samples = q.shape[1]
        out = self._out[..., :samples]
        turns = self._turns[..., :samples]
        # tan is vectorised by numpy where cos and sin are not, and cos² + sin² = 1 to rounding in any case.
        half = np.tan(0.5 * q)
        ratio = 2.0 / (1.0 + half * half)
        np.subtract(ratio, 1.0, out=turns[:, 1])
        np.multiply(ratio, half, out=turns[:, 2])
        for index, link in enumerate(self._links):
            parent = (self._twists[link.parent] if link.parent >= 0 else self._base)[..., :samples]
            twists = self._twists[index][..., :samples]
            self._carry(link, parent, turns[index], q[index], twists)
            self._add_joint(link, twists, dq[index], ddq[index])
            self._project(link, twists, out[link.columns])
        return out

    def _carry(self, link: _Link, parent: FloatArray, turn: FloatArray, q: FloatArray, child: FloatArray) -> None:
        """Express the parent's twists at the child's origin and in the child's frame."""
        if len(link.moved):
            parent = parent.copy()
            angular, linear = parent[:, 0], parent[:, 1]
            for k in link.moved:
                arm = link.offset[k] + link.slide[k] * q if link.slide[k] else link.offset[k]
                linear[:, (k + 1) % 3] += angular[:, (k + 2) % 3] * arm
                linear[:, (k + 2) % 3] -= angular[:, (k + 1) % 3] * arm
        rotation = np.matmul(link.turn, turn, out=self._rotation[:, : len(q)]).reshape(3, 3, len(q))
        for rows, columns in link.blocks:
            np.einsum("jis,mgis->mgjs", rotation[rows, columns], parent[:, :, columns], out=child[:-1, :, rows])

    def _add_joint(self, link: _Link, twists: FloatArray, dq: FloatArray, ddq: FloatArray) -> None:
        """The joint's own motion: A += S q̈ + V × S q̇, then V += S q̇."""
        joint = self._joint[:, : len(dq)]
        np.multiply(twists[0], dq, out=joint[:6].reshape(2, 3, len(dq)))
        joint[6] = ddq
        twists[1] += (link.bracket @ joint).reshape(2, 3, len(dq))
        twists[0, link.own.start // 3] += link.axis[:, None] * dq

    def _project(self, link: _Link, twists: FloatArray, out: FloatArray) -> None:
        """Power of each unit twist on the wrench of each wanted parameter; out is (wanted, n, samples)."""
        samples = twists.shape[-1]
        motion = self._motion[:, :samples]
        omega, velocity = twists[0]
        np.multiply(omega[0], omega, out=motion[:3])
        np.multiply(omega[1], omega[1:], out=motion[3:5])
        np.multiply(omega[2], omega[2], out=motion[5])
        motion[6:].reshape(2, 3, samples)[...] = twists[1]
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # acceleration of the origin = spatial + ω × v
            motion[9 + i] += omega[j] * velocity[k]
            motion[9 + i] -= omega[k] * velocity[j]
        upstream, last = len(link.joints) - 1, link.joints[-1]
        axes = twists[2:-1].reshape(upstream, 6, samples)
        place = slice(0, 0)
        for table, components in ((link.with_force, 6), (link.without_force, 3)):
            count = len(table) // components
            place = slice(place.stop, place.stop + count)
            if count == 0:
                continue
            wrench = np.matmul(table, motion[: table.shape[1]], out=self._wrench[: len(table), :samples])
            wrench = wrench.reshape(count, components, samples)
            if link.own.stop <= components:
                np.einsum("mcs,c->ms", wrench[:, link.own], link.axis, out=out[place, last])
            if link.serial:
                np.einsum("mcs,kcs->mks", wrench, axes[:, :components], out=out[place, :upstream])
            else:  # a branch of a tree: its upstream joints are not the first ones
                out[place, list(link.joints[:-1])] = np.einsum("mcs,kcs->mks", wrench, axes[:, :components])


def _blocks(used: npt.NDArray[np.bool_]) -> tuple[tuple[slice, slice], ...]:
    """Rectangles (rows, columns) that hold all entries in use of a (3, 3) matrix; each row is in one of them."""
    rows_of: dict[tuple[int, ...], list[int]] = {}
    for row in range(3):
        rows_of.setdefault(tuple(np.flatnonzero(used[row])), []).append(row)
    return tuple((_slice(rows), _slice(columns)) for columns, rows in rows_of.items())


def _slice(chosen: Sequence[int]) -> slice:
    """At most three ascending numbers below 3 as a slice, which needs no copy."""
    step = chosen[1] - chosen[0] if len(chosen) > 1 else 1
    return slice(int(chosen[0]), int(chosen[-1]) + 1, int(step))


def _skew(vector: FloatArray) -> FloatArray:
    """The matrix S(v), (3, 3), of the vector product: S(v) w = v × w."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
