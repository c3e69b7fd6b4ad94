"""The table of a motion before it is driven: its shape, its grid beside that of the commands, its state at a row.

Pure functions on arrays. `motion` calls them when a motion is built; limits are judged elsewhere (`safety`).
"""

from __future__ import annotations

import numpy as np

from fri_client.errors import FriError
from safety.limits import FloatArray

_RELATIVE_GRID_TOLERANCE = 1e-6


class MotionError(FriError):
    """The table cannot be driven as asked: shape, a value that is not finite, or a period off the command grid."""

    exit_code = 65


def command_stride(rows: int, table_period_s: float, command_period_s: float) -> int:
    """Rows of the table per command: command_period_s / table_period_s.

    Raises MotionError unless that is a whole number and the table's period a whole number of commands.
    """
    ratio = command_period_s / table_period_s
    stride = round(ratio)
    if stride < 1 or abs(ratio - stride) > _RELATIVE_GRID_TOLERANCE * ratio:
        raise MotionError(
            f"The robot takes a command every {command_period_s * 1e3:g} ms, which is no whole multiple of the table's "
            f"{table_period_s * 1e3:g} ms grid: choose another send period or receive multiplier."
        )
    if rows % stride:
        raise MotionError(
            f"The trajectory's period of {rows * table_period_s:g} s is no whole number of command periods of "
            f"{command_period_s * 1e3:g} ms: choose another send period or another trajectory."
        )
    return stride


def checked_table(table: FloatArray, joints: int) -> FloatArray:
    """The table as float64 (N, joints). Raises MotionError for a wrong shape or a value that is not finite."""
    array = np.asarray(table, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != joints or len(array) < 3:
        raise MotionError(f"The table has shape {array.shape}; at least 3 rows of {joints} joint positions are needed.")
    wrong = np.argwhere(~np.isfinite(array))
    if len(wrong):
        row, joint = (int(place) for place in wrong[0])
        raise MotionError(f"The table holds {array[row, joint]} at row {row}, joint {joint + 1}; nothing was moved.")
    return array


def state_of_row(table: FloatArray, row: int, period_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position rad, velocity rad/s and acceleration rad/s² at one row, by central differences of the periodic table."""
    before, here, after = table[row - 1], table[row], table[(row + 1) % len(table)]
    return here.copy(), (after - before) / (2.0 * period_s), (after - 2.0 * here + before) / period_s**2
