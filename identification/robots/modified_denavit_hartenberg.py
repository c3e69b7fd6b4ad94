"""Robots from a table of modified Denavit-Hartenberg parameters (Khalil and Dombre), as a CSV file or as arrays.

The columns are those of the paper's Table 1: gamma (0 revolute, 1 prismatic), alpha, d, theta, rl; frame i relative to
frame i − 1 is Rx(α) Tx(d) Rz(θ) Tz(rl). Optional columns: joint_name, position_lower_rad, position_upper_rad,
velocity_rad_s, effort_nm.
"""

from __future__ import annotations

import ast
import csv
import hashlib
import math
import re
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.errors import RobotError
from identification.robots.installation import STANDARD_GRAVITY
from identification.robots.model import Kinematics, RobotModel, build_pinocchio_model

_REQUIRED_COLUMNS = ("alpha_rad", "d_m", "theta", "rl_m")
_LIMIT_COLUMNS = ("position_lower_rad", "position_upper_rad", "velocity_rad_s", "effort_nm")
_JOINT_VARIABLE = re.compile(r"\bq_?(\d+)\b")


@dataclass(frozen=True, slots=True)
class _Row:
    parameters: tuple[float, float, float, float]
    revolute: bool
    name: str
    limits: tuple[float, float, float, float]


def robot_from_table(
    text: str, *, name: str, source: str, gravity: tuple[float, float, float] = STANDARD_GRAVITY
) -> RobotModel:
    """The robot of a CSV table (format in the module docstring); angles may be written as `-pi/2`, `170*pi/180`.

    Lines that begin with # are comments. Raises RobotError with the row and column of the first thing that is wrong.
    """
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    reader = csv.DictReader(lines, skipinitialspace=True)
    columns = reader.fieldnames or []
    missing = [column for column in _REQUIRED_COLUMNS if column not in columns]
    if missing:
        raise RobotError(
            f"{source} is no modified Denavit-Hartenberg table: column {', '.join(missing)} is missing "
            f"(needed: {', '.join(_REQUIRED_COLUMNS)}).",
            file=source,
            field=missing[0],
        )
    rows = [_read_row(row, joint, source) for joint, row in enumerate(reader, start=1)]
    if not rows:
        raise RobotError(f"{source} lists no joint: the table has a header and no rows.", file=source, field="link")
    limits = np.array([row.limits for row in rows])
    return robot_from_arrays(
        np.array([row.parameters for row in rows]),
        revolute=np.array([row.revolute for row in rows]),
        name=name,
        joint_names=tuple(row.name for row in rows),
        position_lower=limits[:, 0],
        position_upper=limits[:, 1],
        velocity=limits[:, 2],
        effort=limits[:, 3],
        gravity=gravity,
        source=source,
        digest=hashlib.sha256(text.encode()).hexdigest(),
    )


def robot_from_arrays(
    parameters: FloatArray,
    *,
    revolute: np.ndarray[tuple[int], np.dtype[np.bool_]] | None = None,
    name: str = "robot",
    joint_names: tuple[str, ...] | None = None,
    position_lower: FloatArray | None = None,
    position_upper: FloatArray | None = None,
    velocity: FloatArray | None = None,
    effort: FloatArray | None = None,
    gravity: tuple[float, float, float] = STANDARD_GRAVITY,
    source: str = "arrays",
    digest: str | None = None,
) -> RobotModel:
    """The serial robot with (n, 4) modified Denavit-Hartenberg parameters alpha rad, d m, theta rad, rl m.

    The entry of the joint variable (theta of a revolute joint, rl of a prismatic one) is its offset. Limits default to
    nan (unknown). Raises RobotError if the array has another shape or is not finite.
    """
    table = np.array(parameters, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != 4:
        raise RobotError(f"Modified Denavit-Hartenberg parameters must have shape (n, 4), not {table.shape}.")
    n = len(table)
    rotation = np.empty((n, 3, 3))
    translation = np.empty((n, 3))
    for joint, (alpha, d, theta, rl) in enumerate(table):
        cos_alpha, sin_alpha = _exact_cos_sin(alpha)
        cos_theta, sin_theta = _exact_cos_sin(theta)
        # eq. of Khalil and Dombre: Rx(alpha) Rz(theta), origin (d, −sin(alpha) rl, cos(alpha) rl)
        rotation[joint] = (
            (cos_theta, -sin_theta, 0.0),
            (cos_alpha * sin_theta, cos_alpha * cos_theta, -sin_alpha),
            (sin_alpha * sin_theta, sin_alpha * cos_theta, cos_alpha),
        )
        translation[joint] = (d, -sin_alpha * rl, cos_alpha * rl)
    kinematics = Kinematics(
        parent=np.arange(-1, n - 1, dtype=np.int64),
        rotation=rotation + 0.0,
        translation=translation + 0.0,
        axis=np.tile((0.0, 0.0, 1.0), (n, 1)),
        revolute=np.ones(n, dtype=np.bool_) if revolute is None else np.array(revolute, dtype=np.bool_),
    )
    names = joint_names if joint_names is not None else tuple(f"joint_{joint}" for joint in range(1, n + 1))
    unknown = np.full(n, np.nan)
    base_gravity = np.array(gravity, dtype=np.float64)
    return RobotModel(
        name=name,
        joint_names=names,
        kinematics=kinematics,
        pinocchio_model=build_pinocchio_model(name, kinematics, names, base_gravity),
        modified_denavit_hartenberg=table,
        position_lower=unknown if position_lower is None else np.array(position_lower, dtype=np.float64),
        position_upper=unknown if position_upper is None else np.array(position_upper, dtype=np.float64),
        velocity=unknown if velocity is None else np.array(velocity, dtype=np.float64),
        effort=unknown if effort is None else np.array(effort, dtype=np.float64),
        gravity=base_gravity,
        source=source,
        digest=digest if digest is not None else hashlib.sha256(table.tobytes()).hexdigest(),
    )


def _exact_cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine, exact at multiples of π/2 (cos(π/2) = 6e-17 would give parameters without effect a column)."""
    quarter_turns = angle / (math.pi / 2)
    if abs(quarter_turns - round(quarter_turns)) < 1e-12:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarter_turns) % 4]
    return math.cos(angle), math.sin(angle)


def _read_row(row: dict[str, str], joint: int, source: str) -> _Row:
    theta_offset, theta_variable = _split_variable(row["theta"], "theta", joint, source)
    rl_offset, rl_variable = _split_variable(row["rl_m"], "rl_m", joint, source)
    if theta_variable == rl_variable:
        raise _wrong(source, joint, "theta", f"exactly one of theta and rl_m must hold the joint variable q{joint}.")
    gamma = (row.get("gamma_rad") or row.get("gamma") or "").strip()
    if gamma and _number(gamma, "gamma_rad", joint, source) != (0.0 if theta_variable else 1.0):
        kind = "revolute (0)" if theta_variable else "prismatic (1)"
        what = f"gamma is {gamma}, but the joint variable stands in the column of a {kind} joint."
        raise _wrong(source, joint, "gamma_rad", what)
    alpha = _number(row["alpha_rad"], "alpha_rad", joint, source)
    d = _number(row["d_m"], "d_m", joint, source)
    lower, upper, velocity, effort = (
        _number(row[column], column, joint, source) if (row.get(column) or "").strip() else math.nan
        for column in _LIMIT_COLUMNS
    )
    name = (row.get("joint_name") or "").strip() or f"joint_{joint}"
    return _Row((alpha, d, theta_offset, rl_offset), theta_variable, name, (lower, upper, velocity, effort))


def _wrong(source: str, joint: int, column: str, message: str) -> RobotError:
    return RobotError(f"{source}, joint {joint}: {message}", file=source, field=column, joint=joint)


def _split_variable(text: str | None, column: str, joint: int, source: str) -> tuple[float, bool]:
    """Offset of the entry and whether it holds the joint variable: `q3+pi/2` → (π/2, True), `0.42` → (0.42, False)."""
    entry = (text or "").strip()
    found = _JOINT_VARIABLE.search(entry)
    if found is None:
        return _number(entry, column, joint, source), False
    if int(found.group(1)) != joint:
        raise _wrong(source, joint, column, f"{column} holds {found.group(0)}, the variable of another joint.")
    at_zero, at_one = (_number(_JOINT_VARIABLE.sub(value, entry), column, joint, source) for value in ("0", "1"))
    if abs(at_one - at_zero - 1.0) > 1e-12:
        raise _wrong(source, joint, column, f"{column} must be q{joint} plus a constant, not '{entry}'.")
    return at_zero, True


def _number(text: str | None, column: str, joint: int, source: str) -> float:
    """A finite number from digits, pi, + − * / and brackets; anything else is an error with its place."""
    entry = (text or "").strip()
    try:
        value = _evaluate(ast.parse(entry, mode="eval").body)
    except (SyntaxError, ValueError, ZeroDivisionError, RecursionError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise _wrong(source, joint, column, f"column {column} holds '{entry}', which is no finite number.")
    return value


def _evaluate(node: ast.expr) -> float:
    match node:
        case ast.Constant(value=bool()):
            raise ValueError(node)
        case ast.Constant(value=int() | float() as value):
            return float(value)
        case ast.Name(id="pi"):
            return math.pi
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_evaluate(operand)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _evaluate(operand)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _evaluate(left) + _evaluate(right)
        case ast.BinOp(left=left, op=ast.Sub(), right=right):
            return _evaluate(left) - _evaluate(right)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return _evaluate(left) * _evaluate(right)
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return _evaluate(left) / _evaluate(right)
    raise ValueError(node)
