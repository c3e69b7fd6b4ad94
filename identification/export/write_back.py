"""What an audit found, written back into the simulator's file, and the torque before and after in one figure.

Here: the order of things (bodies and gravity first, then the friction that is lacking) and the drawing. Not here: the
file (`amend`) and what is foretold (`audit.foretold`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from identification.arrays import BoolArray, FloatArray
from identification.audit.columns import Geometry
from identification.audit.difference import Difference
from identification.audit.foretold import foretold, lacking_friction
from identification.audit.reading import Reading, read_so
from identification.audit.rows import Rows, rows_of
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.export.amend import Amended, amend
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.robots.joint_units import in_units
from identification.robots.simulator_models import read_simulator_model

# Okabe and Ito's colours with three kinds of line: told apart in grey print and by colour-blind readers.
_MEASURED: dict[str, Any] = {"color": "#000000", "linewidth": 3.2, "alpha": 0.35}
_BEFORE: dict[str, Any] = {"color": "#D55E00", "linewidth": 1.1, "linestyle": ":"}
_AFTER: dict[str, Any] = {"color": "#0072B2", "linewidth": 1.2, "linestyle": "--"}
_MOST_POINTS = 1500


@dataclass(frozen=True, slots=True, eq=False)
class WrittenBack:
    """amended: the file. measured, before, after: (R, n) Nm on rows `spacing_s` apart; used: (R, n). units: (n,).

    put_right: whether signs, scales or the delay of the measured torque were, or how the data are read.
    """

    amended: Amended
    source: str
    measured: FloatArray
    before: FloatArray
    after: FloatArray
    used: BoolArray
    spacing_s: float
    units: tuple[str, ...]
    put_right: bool

    def rms(self, torque: FloatArray) -> FloatArray:
        """(n,) of measured minus foretold, over the rows in which each joint moves."""
        left = np.where(self.used, self.measured - torque, 0.0)
        return np.asarray(np.sqrt((left**2).sum(axis=0) / np.maximum(self.used.sum(axis=0), 1)))

    @property
    def sentence(self) -> str:
        """What it is worth."""
        before, after = (float(np.sqrt(np.sum(self.rms(each) ** 2))) for each in (self.before, self.after))
        unit = in_units("Nm", self.units)
        return (
            f"{self.amended.path} has what was found: {before:.3g} {unit} RMS (all joints together) of measured minus "
            f"simulated torque before, {after:.3g} {unit} after"
            + (", with what is wrong in the measured one put right." if self.put_right else ".")
        )


def write_back(
    recordings: Sequence[Recording],
    robot: RobotModel,
    source: Path,
    differences: Sequence[Difference],
    target: Path,
    reading: Reading | None = None,
) -> WrittenBack:
    """Write a simulator's file with the differences put right, and read both back for their torque.

    reading: how the recordings are to be read; without it their torque's signs are as the differences say.

    A file's friction is a guess more often than not: what the rows lack of it after everything else is written too.
    Raises the errors of `amend`.
    """
    regressor = BaseRegressor(robot, RegressorOptions(rotor_inertia=True))
    given = rows_of(read_so(reading, recordings, robot))
    rows = _put_right(given, [item for item in differences if reading is None or item.effect != "inverted_torque_sign"])
    geometry = Geometry(robot, rows)
    amended = amend(source, differences, robot, target)
    before = read_simulator_model(source, regressor)
    # A base that leans weighs first moments about a vertical axis, which base parameters on a level one do not have.
    there = BaseRegressor(replace(robot, gravity=amended.gravity), RegressorOptions(rotor_inertia=True))
    after = _values(amended, source, differences, robot, there)
    if not any(item.effect == "friction_change" for item in differences):
        left = rows.torque - foretold(geometry, there, after, amended.gravity)
        own = [
            np.array([after[there.names.index(f"{symbol}_{joint}")] for joint in range(1, robot.n + 1)])
            for symbol in ("FV", "FS")
        ]
        found = lacking_friction(geometry, left, own[0], own[1], source.name)
        if found:
            differences = [*differences, *found]
            amended = amend(source, differences, robot, target)
            after = _values(amended, source, differences, robot, there)
    return WrittenBack(
        amended, source.name, rows.torque, foretold(geometry, regressor, before),
        foretold(geometry, there, after, amended.gravity), rows.used, rows.spacing_s, robot.units,
        rows is not given or (reading is not None and reading.is_other),
    )  # fmt: skip


def _put_right(rows: Rows, differences: Sequence[Difference]) -> Rows:
    """The rows with delay, signs and scales of the torque as they were found to be: no file has a place for these, and
    friction is read off the torque. The rows themselves where nothing of that was found.
    """
    delay_s, scale = 0.0, np.ones(rows.torque.shape[1])
    for item in differences:
        if item.effect == "inverted_torque_sign":
            scale[[joint - 1 for joint in item.joints]] *= -1.0
        elif item.effect == "torque_sensor_gain" and item.numbers[0].interval[0] > 0.0:
            scale[slice(None) if item.joint is None else item.joint - 1] /= item.numbers[0].value
        elif item.effect == "torque_delay":
            delay_s += item.numbers[0].value
    if delay_s == 0.0 and np.all(scale == 1.0):
        return rows
    return replace(rows, torque=scale * rows.torque_after(delay_s)[0])


def _values(
    amended: Amended, source: Path, differences: Sequence[Difference], robot: RobotModel, regressor: BaseRegressor
) -> FloatArray:
    """Base parameters of the file that was written, as its bodies are; a turned base is in `amended.gravity`."""
    if np.allclose(amended.gravity, robot.gravity):
        return read_simulator_model(amended.path, regressor)
    level = amended.path.with_name(f"{amended.path.stem}.level{amended.path.suffix}")
    try:
        amend(source, [item for item in differences if item.effect != "base_tilt"], robot, level)
        return read_simulator_model(level, regressor)
    finally:
        level.unlink(missing_ok=True)


def draw_before_after(written: WrittenBack) -> Figure:
    """One row a joint: measured torque with that of the file before and after, and what each leaves."""
    n = written.measured.shape[1]
    figure = Figure(figsize=(13.5, 1.5 * n + 1.6), layout="constrained")
    figure.suptitle(f"{written.source}: {written.sentence.partition(': ')[2]}")
    rows = figure.subplots(n, 2, sharex=True, squeeze=False)
    shown = slice(0, _MOST_POINTS)
    time = written.spacing_s * np.arange(len(written.measured))[shown]
    for joint, (left, right) in enumerate(rows):
        measured, before, after = (each[shown, joint] for each in (written.measured, written.before, written.after))
        left.plot(time, measured, label="measured", **_MEASURED)
        left.plot(time, before, label="file as given", **_BEFORE)
        left.plot(time, after, label="file as written", **_AFTER)
        right.plot(time, measured - before, label="measured − as given", **_BEFORE)
        right.plot(time, measured - after, label="measured − as written", **_AFTER)
        left.set_ylabel(f"joint {joint + 1}\ntorque ({written.units[joint]})")
        right.set_ylabel(f"difference\n({written.units[joint]})")
        for axes in (left, right):
            axes.grid(alpha=0.25)
            axes.set_xlim(time[0], time[-1])
    for column in (0, 1):
        rows[-1, column].set_xlabel("moving time, low-pass filtered (s)")
        rows[0, column].legend(loc="upper right", ncols=3, fontsize="small")
    return figure
