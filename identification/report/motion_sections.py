"""Excitation and residuals as figures: the paper's Fig. 2 and 3, velocities, and what the model leaves, by joint in
time and in frequency against the noise. Here: which panels there are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pinocchio

from identification.arrays import FloatArray, evenly
from identification.report.document import Block, Figure, Heading, Line, Panel, Paragraph, Section, Style
from identification.report.numbers import rounded
from identification.report.stretches import Stretch
from identification.robots import RobotModel

_PATH_POINTS = 400
_BANDS_PER_OCTAVE = 8
_VIEWS = ((0, 1, "from above"), (0, 2, "from the side"), (1, 2, "from the front"))


def excitation_section(stretches: Sequence[Stretch], robot: RobotModel | None) -> Section | None:
    """How the arm moved: joint positions, velocities and the path of the last link; None without any motion.

    robot: for the path; without it there is none.
    """
    if not stretches:
        return None
    blocks: list[Block] = []
    for stretch in stretches:
        if len(stretches) > 1:
            blocks.append(Heading(stretch.name))
        blocks += [
            _by_joint("Joint positions", stretch.time, stretch.position, "position", "rad"),
            _by_joint("Joint velocities", stretch.time, stretch.velocity, "velocity", "rad/s"),
        ]
        if robot is not None:
            blocks.append(_path(stretch, robot))
    return Section("excitation", "How the arm moved", tuple(blocks))


def residual_section(stretches: Sequence[Stretch], what: str) -> Section | None:
    """Measured minus modelled torque by joint, over time and over frequency; what: which model, in words."""
    if not stretches:
        return None
    noisy = any(np.isfinite(stretch.floor_nm).any() for stretch in stretches)
    hint = (
        "Dotted: the noise (one standard deviation). A residual as large as the noise and without shape holds nothing "
        "that a better model could explain."
        if noisy
        else "How large the noise is, this recording does not tell: no motion is repeated in it."
    )
    blocks: list[Block] = [
        Paragraph(f"Measured torque beside the modelled one, and the residual, their difference, with {what}. {hint}")
    ]
    for stretch in stretches:
        if len(stretches) > 1:
            blocks.append(Heading(stretch.name))
        n = stretch.residual.shape[1]
        blocks += [
            Figure(
                "Measured and modelled torque",
                tuple(_torque_panel(stretch, joint) for joint in range(n)),
                (("measured", "measured"), ("fitted", "modelled")),
            ),
            Figure(
                "Residual over time",
                tuple(_residual_panel(stretch, joint) for joint in range(n)),
                (("after", "measured − modelled"), *((("noise", "noise, ±1 σ"),) if noisy else ())),
            ),
            Figure(
                "Residual over frequency",
                tuple(
                    spectrum_panel(
                        joint, stretch.frequency, (("after", stretch.spectrum),), stretch.noise, f"Joint {joint + 1}"
                    )
                    for joint in range(n)
                ),
                (("after", "measured − modelled"), *((("noise", "noise"),) if stretch.noise is not None else ())),
            ),
        ]
    return Section("residuals", "Torque and residuals by joint", tuple(blocks))


def spectrum_panel(
    joint: int, frequency: FloatArray, lines: Sequence[tuple[Style, FloatArray]], noise: FloatArray | None, title: str
) -> Panel:
    """Spectra (F, n) of one joint (from 0) as RMS per line, by style, with the noise on top.

    Neighbouring lines are averaged in power where they are denser than an eighth of an octave.
    """
    drawn = list(lines)
    if noise is not None:
        drawn.append(("noise", noise))
    positive = frequency > 0.0
    band = np.round(np.log2(frequency[positive] / frequency[positive][0]) * _BANDS_PER_OCTAVE).astype(int)
    shown = tuple(
        Line(style, _band_means(band, frequency[positive]), np.sqrt(_band_means(band, values[positive, joint] ** 2)))
        for style, values in drawn
    )
    peak = lines[-1][1][positive, joint]
    where = (
        f"; largest {rounded(peak.max(), 2)} Nm at {rounded(frequency[positive][peak.argmax()])} Hz"
        if peak.size
        else ""
    )
    return Panel(
        title, "frequency (Hz)", "Nm RMS per line", shown,
        f"spectrum of the residual up to {rounded(frequency[-1])} Hz{where}", logarithmic=True,
    )  # fmt: skip


def _by_joint(caption: str, time: FloatArray, values: FloatArray, quantity: str, unit: str) -> Figure:
    return Figure(
        caption,
        tuple(
            Panel(
                f"Joint {joint + 1}",
                "time (s)",
                f"{quantity} ({unit})",
                (Line("measured", time, column),),
                f"{quantity} between {rounded(np.nanmin(column))} and {rounded(np.nanmax(column))} {unit}",
            )
            for joint, column in enumerate(values.T)
        ),
    )


def _residual_panel(stretch: Stretch, joint: int) -> Panel:
    values, floor = stretch.residual[:, joint], float(stretch.floor_nm[joint])
    rms = float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")
    return Panel(
        f"Joint {joint + 1}",
        "time (s)",
        "torque (Nm)",
        (Line("after", stretch.residual_time, values),),
        f"residual over time, RMS {rounded(rms)} Nm, noise {rounded(floor)} Nm",
        floor=floor,
    )


def _torque_panel(stretch: Stretch, joint: int) -> Panel:
    measured, residual = stretch.measured[:, joint], stretch.residual[:, joint]
    known = np.isfinite(measured)
    span = (measured[known].min(), measured[known].max()) if known.any() else (np.nan, np.nan)
    return Panel(
        f"Joint {joint + 1}",
        "time (s)",
        "torque (Nm)",
        (Line("measured", stretch.residual_time, measured), Line("fitted", stretch.residual_time, measured - residual)),
        f"measured torque between {rounded(span[0])} and {rounded(span[1])} Nm, and the modelled one over it",
    )


def _path(stretch: Stretch, robot: RobotModel) -> Figure:
    """The origin of the last link's frame in the base frame, seen from three sides; a star where it begins."""
    known = np.flatnonzero(np.isfinite(stretch.position).all(axis=1))
    chosen = known[evenly(len(known), _PATH_POINTS)]
    data = robot.pinocchio_model.createData()
    path = np.empty((len(chosen), 3))
    for row, position in enumerate(stretch.position[chosen]):
        pinocchio.forwardKinematics(robot.pinocchio_model, data, position)
        path[row] = data.oMi[robot.n].translation
    return Figure(
        "Path of the last link's origin in the base frame of the model (star: where it begins)",
        tuple(
            Panel(
                f"Seen {view}",
                f"{'xyz'[first]} (m)",
                f"{'xyz'[second]} (m)",
                (
                    Line("measured", path[:, first], path[:, second]),
                    Line("fitted", path[:1, first], path[:1, second], marks="star"),
                ),
                f"{'xyz'[first]} between {rounded(np.min(path[:, first]))} and {rounded(np.max(path[:, first]))} m, "
                f"{'xyz'[second]} between {rounded(np.min(path[:, second]))} and {rounded(np.max(path[:, second]))} m",
                equal=True,
            )
            for first, second, view in _VIEWS
        ),
    )


def _band_means(band: npt.NDArray[np.int_], values: FloatArray) -> FloatArray:
    """Mean of the values of each band that has any, bands in order."""
    index = np.unique(band, return_inverse=True)[1]
    return np.asarray(np.bincount(index, values) / np.bincount(index), dtype=np.float64)
