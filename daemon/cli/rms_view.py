"""RMS per joint as tables for a terminal: of fits, validations and simulations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from daemon.cli.output import data, show_table

if TYPE_CHECKING:
    from identification.fitting.rms import RmsTable


def show_rms(rms: RmsTable, title: str, *, unit: str = "Nm", percent: bool = True) -> None:
    """The table in `unit` with the sum over the joints, and in percent of the RMS torque, on stdout."""
    joints = len(rms.rows[0].rms_nm) if rms.rows else 0
    heads = [str(joint) for joint in range(1, joints + 1)]
    torque = "force" if unit == "N" else "torque"
    data(f"{title.replace('torque', torque)}, {unit}:")
    show_table(
        ("joint", *heads, "sum"),
        [(row.label, *(_cell(value, 3) for value in row.rms_nm), _cell(row.total_nm, 3)) for row in rms.rows],
    )
    if percent:
        data(f"The same in % of the RMS {torque}:")
        show_table(("joint", *heads), [(row.label, *(_cell(value, 1) for value in row.percent)) for row in rms.rows])


def _cell(value: float, digits: int) -> str:
    """A number, or a dash where there is none: a joint that follows another has no torque of its own."""
    return "–" if math.isnan(value) else f"{value:.{digits}f}"
