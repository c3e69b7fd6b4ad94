"""RMS per joint as tables for a terminal: of fits, validations and simulations."""

from __future__ import annotations

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
        [(row.label, *(f"{value:.3f}" for value in row.rms_nm), f"{row.total_nm:.3f}") for row in rms.rows],
    )
    if percent:
        data(f"The same in % of the RMS {torque}:")
        show_table(("joint", *heads), [(row.label, *(f"{value:.1f}" for value in row.percent)) for row in rms.rows])
