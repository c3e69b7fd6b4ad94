"""The paper's Fig. 4 for any robot: per joint the torques measured, from inverse dynamics and simulated, and what is
left between them. Here: the drawing. Not here: any number in it (`comparison`). Opens no window.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from identification.simulation.comparison import Comparison

# Okabe and Ito's colours with three kinds of line: told apart in grey print and by colour-blind readers.
_MEASURED: dict[str, Any] = {"color": "#000000", "linewidth": 3.2, "alpha": 0.35, "label": "measured"}
_INVERSE: dict[str, Any] = {"color": "#0072B2", "linewidth": 1.3, "linestyle": "--", "label": "inverse dynamics"}
_SIMULATED: dict[str, Any] = {"color": "#D55E00", "linewidth": 1.3, "linestyle": ":", "label": "simulated"}
_LEFT, _LOOP, _FLOOR = "#56B4E9", "#D55E00", "#009E73"
_MOST_POINTS = 2000


def draw_comparison(comparison: Comparison, title: str, joint_units: tuple[str, ...] | None = None) -> Figure:
    """One row per joint: torques on the left, differences on the right with the noise's standard deviation drawn in.

    joint_units: "Nm" or "N" of each joint; Nm by default.
    """
    n = comparison.simulated_torque.shape[1]
    units = joint_units or ("Nm",) * n
    figure = Figure(figsize=(13.5, 1.5 * n + 1.6), layout="constrained")
    figure.suptitle(title)
    rows = figure.subplots(n, 2, sharex=True, squeeze=False)
    step = max(1, len(comparison.torque_time) // _MOST_POINTS)
    time = comparison.torque_time[::step]
    for joint, (left, right) in enumerate(rows):
        modelled = comparison.inverse_dynamics_torque[::step, joint]
        simulated = comparison.simulated_torque[::step, joint]
        measured = None if comparison.measured_torque is None else comparison.measured_torque[::step, joint]
        if measured is not None:
            left.plot(time, measured, **_MEASURED)
        left.plot(time, modelled, **_INVERSE)
        left.plot(time, simulated, **_SIMULATED)
        left.set_ylabel(f"joint {joint + 1}\ntorque ({units[joint]})")
        # Not measured minus simulated: both differences would carry the same noise and hide each other.
        if measured is not None:
            right.plot(time, measured - modelled, color=_LEFT, linewidth=0.8, label="measured − inverse dynamics")
        right.plot(time, modelled - simulated, color=_LOOP, linewidth=1.3, label="inverse dynamics − simulated")
        _draw_floor(right, float(comparison.noise_floor_nm[joint]))
        right.set_ylabel(f"difference\n({units[joint]})")
        for axes in (left, right):
            axes.grid(alpha=0.25)
            axes.set_xlim(time[0], time[-1])
            axes.margins(y=0.1)
    for column in (0, 1):
        rows[-1, column].set_xlabel("time (s)")
        rows[0, column].legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize="small", frameon=False,
            borderaxespad=0.2, columnspacing=1.0, handlelength=1.6,
        )  # fmt: skip
    return figure


def _draw_floor(axes: Axes, noise_floor: float) -> None:
    if np.isfinite(noise_floor):
        for value, label in ((noise_floor, "noise, ±1 σ"), (-noise_floor, "")):
            axes.axhline(value, color=_FLOOR, linestyle="--", linewidth=1.2, zorder=4, label=label)


def save_figure(figure: Figure, file: Path) -> None:
    """Write the figure; the suffix chooses the format (.svg, .png, .pdf)."""
    figure.savefig(file, dpi=110)
