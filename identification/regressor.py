"""The torque regressor Y(q, q̇, q̈) of eq. (5) for many samples at once, and the columns of joint friction and drives.

Here: rigid-body columns of the ten dynamic parameters of each link, eq. (3), computed with numpy over all samples in
chunks, and the diagonal columns of viscous and Coulomb friction, reflected rotor inertia and torque offset. Not here:
grouping to base parameters (`base_parameters`). Pinocchio computes the same rigid-body columns one sample at a time;
the tests hold the two together.

How it works: every joint axis k upstream of link j is carried along the chain as the pair (z, u) in link j's frame,
z its direction and u = z × p with p from the axis to the frame's origin (z = 0 and u the direction for a prismatic
joint). The torque that a force f and a moment n at link j's origin cause at joint k is z·n + u·f, and the columns of
link j are that product with the ten unit parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from identification.robots.model import Kinematics, RobotModel

FloatArray = npt.NDArray[np.float64]

INERTIAL_SYMBOLS = ("M", "MX", "MY", "MZ", "XX", "XY", "XZ", "YY", "YZ", "ZZ")
"""The inertial part of eq. (3), in the order of the regressor's columns."""

_CHUNK = 2000
_Vector = tuple[FloatArray, FloatArray, FloatArray]
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
    robot: RobotModel, q: FloatArray, dq: FloatArray, ddq: FloatArray, wanted: Sequence[Sequence[int]]
) -> Iterator[tuple[slice, FloatArray]]:
    """Chosen columns of the rigid-body regressor, chunk by chunk: (slice of samples, array (columns, n, samples)).

    wanted: per link the positions of the parameters in eq. (3), 0 (M) to 9 (ZZ). The array is reused by the next
    chunk: copy what is to be kept.
    """
    samples = _check_states(robot.n, q, dq, ddq)
    count = sum(len(parameters) for parameters in wanted)
    buffer = np.zeros((count, robot.n, min(samples, _CHUNK)))
    for start in range(0, samples, _CHUNK):
        rows = slice(start, min(start + _CHUNK, samples))
        out = buffer[:, :, : rows.stop - rows.start]
        position, velocity, acceleration = (
            np.ascontiguousarray(state[rows].T, dtype=np.float64) for state in (q, dq, ddq)
        )
        _fill_columns(robot.kinematics, robot.gravity, position, velocity, acceleration, wanted, out)
        yield rows, out


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


def _fill_columns(
    kinematics: Kinematics,
    gravity: FloatArray,
    q: FloatArray,
    dq: FloatArray,
    ddq: FloatArray,
    wanted: Sequence[Sequence[int]],
    out: FloatArray,
) -> None:
    """Write the wanted columns of every link into out (columns, n, samples); q, dq, ddq are (n, samples)."""
    samples = q.shape[1]
    zero = np.zeros(samples)
    still: _Vector = (zero, zero, zero)
    # A base accelerating upwards stands for gravity: linear accelerations below are "minus gravity".
    base = (still, still, _constant(-gravity, zero), np.zeros((3, 0, samples)), np.zeros((3, 0, samples)))
    states: list[tuple[_Vector, _Vector, _Vector, FloatArray, FloatArray]] = []
    first = 0
    for link in range(kinematics.n):
        parent = int(kinematics.parent[link])
        state = _transport(kinematics, link, states[parent] if parent >= 0 else base, q[link], dq[link], ddq[link])
        states.append(state)
        last = first + len(wanted[link])
        upstream = kinematics.upstream(link)
        if upstream == tuple(range(len(upstream))):
            _link_columns(*state, wanted[link], out[first:last, : len(upstream)])
        else:  # a branch of a tree: its upstream joints are not the first ones
            columns = np.empty((last - first, len(upstream), samples))
            _link_columns(*state, wanted[link], columns)
            out[first:last, list(upstream)] = columns
        first = last


def _transport(
    kinematics: Kinematics,
    link: int,
    parent_state: tuple[_Vector, _Vector, _Vector, FloatArray, FloatArray],
    q: FloatArray,
    dq: FloatArray,
    ddq: FloatArray,
) -> tuple[_Vector, _Vector, _Vector, FloatArray, FloatArray]:
    """Angular velocity, angular acceleration, acceleration of the origin and upstream axes, in the frame of `link`."""
    omega, alpha, linear, directions, moments = parent_state
    axis = kinematics.axis[link]
    revolute = bool(kinematics.revolute[link])
    placement = kinematics.rotation[link]
    direction: _Vector = (directions[0], directions[1], directions[2])
    moment: _Vector = (moments[0], moments[1], moments[2])

    offset = kinematics.translation[link]
    arm: tuple[FloatArray | float, ...] = tuple(offset)
    if not revolute:
        slide = placement @ axis
        arm = tuple(offset[i] + slide[i] * q if slide[i] else float(offset[i]) for i in range(3))
    if not revolute or np.any(offset):
        linear = _add(linear, _add(_cross(alpha, arm), _cross(omega, _cross(omega, arm))))
        moment = _add(moment, _cross(direction, arm))

    turn = _JointTurn(axis, q) if revolute else None
    omega, alpha, linear, direction, moment = (
        _into_child(placement, turn, vector) for vector in (omega, alpha, linear, direction, moment)
    )
    if revolute:
        spin = _scaled(axis, dq)
        alpha = _add(_add(alpha, _cross(omega, spin)), _scaled(axis, ddq))
        omega = _add(omega, spin)
    else:
        drift = _scaled(axis, 2.0 * dq)
        linear = _add(_add(linear, _cross(omega, drift)), _scaled(axis, ddq))

    count = directions.shape[1]
    new_directions = np.zeros((3, count + 1, q.shape[0]))
    new_moments = np.zeros((3, count + 1, q.shape[0]))
    for i in range(3):
        new_directions[i, :count] = direction[i]
        new_moments[i, :count] = moment[i]
        (new_directions if revolute else new_moments)[i, count] = axis[i]
    return _arrays(omega, q), _arrays(alpha, q), _arrays(linear, q), new_directions, new_moments


def _link_columns(
    omega: _Vector,
    alpha: _Vector,
    linear: _Vector,
    directions: FloatArray,
    moments: FloatArray,
    wanted: Sequence[int],
    out: FloatArray,
) -> None:
    """z·n + u·f for unit values of the wanted parameters of one link; out is (wanted, upstream joints, samples).

    f = m a + (α̂ + ω̂ω̂) h and n = I α + ω × I ω + h × a, with m, h = (MX, MY, MZ) and I of eq. (4).
    """
    zx, zy, zz = directions
    ux, uy, uz = moments
    ox, oy, oz = omega
    ax, ay, az = alpha
    lx, ly, lz = linear
    chosen = set(wanted)
    if chosen & {1, 2, 3}:
        xx, yy, zz_ = ox * ox, oy * oy, oz * oz
        xy, xz, yz = ox * oy, ox * oz, oy * oz
    if chosen & set(range(4, 10)):
        wx = zy * oz - zz * oy  # z × ω
        wy = zz * ox - zx * oz
        wz = zx * oy - zy * ox
    for place, parameter in enumerate(wanted):
        column = out[place]
        match parameter:
            case 0:
                column[...] = ux * lx + uy * ly + uz * lz
            case 1:
                column[...] = ly * zz - lz * zy - (yy + zz_) * ux + (xy + az) * uy + (xz - ay) * uz
            case 2:
                column[...] = lz * zx - lx * zz + (xy - az) * ux - (xx + zz_) * uy + (yz + ax) * uz
            case 3:
                column[...] = lx * zy - ly * zx + (xz + ay) * ux + (yz - ax) * uy - (xx + yy) * uz
            case 4:
                column[...] = zx * ax + wx * ox
            case 5:
                column[...] = zx * ay + zy * ax + wx * oy + wy * ox
            case 6:
                column[...] = zx * az + zz * ax + wx * oz + wz * ox
            case 7:
                column[...] = zy * ay + wy * oy
            case 8:
                column[...] = zy * az + zz * ay + wy * oz + wz * oy
            case _:
                column[...] = zz * az + wz * oz


class _JointTurn:
    """Turns vectors of the frame before a revolute joint into the frame after it: Rot(axis, q)ᵀ v."""

    def __init__(self, axis: FloatArray, q: FloatArray) -> None:
        self._axis = axis
        self._cos = np.cos(q)
        self._sin = np.sin(q)
        along = int(np.argmax(np.abs(axis)))
        self._aligned = along if abs(axis[along]) == 1.0 else None
        if self._aligned is not None and axis[along] < 0.0:
            self._sin = -self._sin

    def __call__(self, vector: _Vector) -> _Vector:
        cos, sin = self._cos, self._sin
        if self._aligned is not None:
            result = list(vector)
            first, second = (self._aligned + 1) % 3, (self._aligned + 2) % 3
            result[first] = cos * vector[first] + sin * vector[second]
            result[second] = cos * vector[second] - sin * vector[first]
            return (result[0], result[1], result[2])
        a = self._axis
        along = (1.0 - cos) * (a[0] * vector[0] + a[1] * vector[1] + a[2] * vector[2])
        crossed = _cross(vector, tuple(a))
        return (
            cos * vector[0] + sin * crossed[0] + along * a[0],
            cos * vector[1] + sin * crossed[1] + along * a[1],
            cos * vector[2] + sin * crossed[2] + along * a[2],
        )


def _into_child(placement: FloatArray, turn: _JointTurn | None, vector: _Vector) -> _Vector:
    """placementᵀ v, then the joint's own turn; products with 0 and 1 are not computed."""
    turned = tuple(_combination(placement[:, row], vector) for row in range(3))
    placed: _Vector = (turned[0], turned[1], turned[2])
    return placed if turn is None else turn(placed)


def _combination(weights: FloatArray, vector: _Vector) -> FloatArray:
    total: FloatArray | None = None
    for weight, component in zip(weights, vector, strict=True):
        if weight == 0.0:
            continue
        if total is None:
            total = component if weight == 1.0 else -component if weight == -1.0 else weight * component
        else:
            total = total + weight * component
    assert total is not None, "a row of a rotation matrix is never zero"
    return total


def _cross(a: Sequence[FloatArray | float], b: Sequence[FloatArray | float]) -> _Vector:
    return (
        np.asarray(a[1] * b[2] - a[2] * b[1]),
        np.asarray(a[2] * b[0] - a[0] * b[2]),
        np.asarray(a[0] * b[1] - a[1] * b[0]),
    )


def _add(a: _Vector, b: _Vector) -> _Vector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _scaled(axis: FloatArray, values: FloatArray) -> _Vector:
    return (axis[0] * values, axis[1] * values, axis[2] * values)


def _constant(vector: FloatArray, zero: FloatArray) -> _Vector:
    return (zero + vector[0], zero + vector[1], zero + vector[2])


def _arrays(vector: _Vector, like: FloatArray) -> _Vector:
    return (
        np.broadcast_to(vector[0], like.shape),
        np.broadcast_to(vector[1], like.shape),
        np.broadcast_to(vector[2], like.shape),
    )
