"""The torque that a table of positions will take, foreseen from a model of the arm, for the preflight.

Here: which model foresees it, and the torque along the table that is sent. Not here: the limits and the verdict
(`safety.preflight`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daemon.api import RunRequest
from daemon.errors import DaemonError
from daemon.motion.tool import Tool
from daemon.motion.workspace import load_surroundings
from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import IdentificationError, ModelFileError
from identification.excitation.nominal import nominal_parameters
from identification.model_file import read_model
from identification.physical_parameters import PhysicalParameters
from identification.robots import BUILT_IN_ROBOTS, Installation, load_robot
from identification.robots.installation import ON_THE_FLOOR
from safety.geometry import FLANGE_M

SAME_GRAVITY = 0.02
"""m/s², by axis: what 9.81 leaves open of the gravity of a place."""

BLOCK_ROWS = 20_000
"""Rows of a table of which the regressor, 3 kB each, is in memory at once: another motion may be under way here."""


@dataclass(frozen=True, slots=True, eq=False)
class TorqueForesight:
    """A model of the arm to ask for torques: base parameters `values` (p,), and in words where they come from.

    has_tool: the declared load of the tool is among them.
    """

    source: str
    regressor: BaseRegressor
    values: FloatArray
    has_tool: bool = False

    def at_rest(self, position: FloatArray) -> FloatArray:
        """(n,) Nm that hold the arm at a position, (n,) rad."""
        still = np.zeros((1, self.regressor.robot.n))
        return np.asarray(self.regressor.matrix(position[None], still, still) @ self.values).reshape(-1)

    def along(self, table: FloatArray, sample_period_s: float) -> FloatArray:
        """(N, n) Nm along one period (N, n) rad that is repeated without a break, by eq. (5) with central differences.

        Of the table and not of the trajectory's formula: the rows are what is sent.
        """
        before, after = np.roll(table, 1, axis=0), np.roll(table, -1, axis=0)
        velocity = (after - before) / (2.0 * sample_period_s)
        acceleration = (after - 2.0 * table + before) / sample_period_s**2
        blocks = [
            self.regressor.matrix(table[rows], velocity[rows], acceleration[rows]) @ self.values
            for rows in (slice(first, first + BLOCK_ROWS) for first in range(0, len(table), BLOCK_ROWS))
        ]
        return np.concatenate(blocks)


def torque_foresight(
    robot: str, model_file: Path | None = None, tool: Tool | None = None, installation: Installation = ON_THE_FLOOR
) -> TorqueForesight | None:
    """A model.json's base parameters, else the paper's Table 3 for the iiwa 14; None where nothing is known of the arm.

    robot: a built-in arm. tool: its load is added to Table 3, which is the bare arm's, and not to a model.json, which
    may have been identified with the tool. installation: how the arm stands. Raises ModelFileNotFoundError (66) or
    ModelFileError (65), also for a model of another arm, or of one that stands otherwise: on a wall more parameters
    show in the torque than on a floor, so that a model from there does not foresee it.
    """
    if model_file is None:
        built_in = load_robot(robot, installation)
        nominal = nominal_parameters(built_in)
        if nominal is None:
            return None
        regressor = BaseRegressor(built_in)
        values = regressor.base_from_physical(nominal)
        if tool is None or not tool.mass_kg:
            return TorqueForesight("Table 3 of the paper", regressor, values)
        values = values + regressor.base_from_physical(_load_of(tool, built_in.n))
        return TorqueForesight(f"Table 3 of the paper and {tool.mass_kg:g} kg on the flange", regressor, values, True)
    model = read_model(model_file)
    its_robot = model.load_robot()
    if its_robot.n != load_robot(robot).n or (its_robot.name in BUILT_IN_ROBOTS and its_robot.name != robot):
        raise ModelFileError(
            f"{model_file.name} is a model of {its_robot.name}, but the motion is for {robot}",
            file=model_file,
            field="robot",
        )
    if not np.allclose(its_robot.gravity, installation.gravity, atol=SAME_GRAVITY):
        raise ModelFileError(
            f"{model_file.name} was identified with gravity {_listed(its_robot.gravity)} m/s² in the frame of the "
            f"base, but the arm stands in {_listed(installation.gravity)}; a model of the arm as it stands is needed",
            file=model_file,
            field="installation",
        )
    regressor = BaseRegressor(its_robot, model.options)
    return TorqueForesight(str(model_file), regressor, model.base_values(regressor))


def foresight_of_run(request: RunRequest) -> TorqueForesight | None:
    """The model that the preflight of a run had; None where it cannot be read here."""
    try:
        around = load_surroundings(request.robot, request.workspace_file)
        model = None if request.model_file is None else Path(request.model_file)
        stand = ON_THE_FLOOR if request.gravity_m_s2 is None else Installation(request.gravity_m_s2)
        return torque_foresight(request.robot, model, around.tool, stand)
    except (DaemonError, IdentificationError, OSError):
        return None


def stand_of_model(model_file: Path) -> Installation:
    """How the arm of a model stands. Raises as `torque_foresight` does."""
    return Installation(read_model(model_file).load_robot().installation.gravity)


def _listed(gravity: Sequence[float] | FloatArray) -> str:
    return f"({', '.join(f'{value:.3g}' for value in gravity)})"


def _load_of(tool: Tool, links: int) -> PhysicalParameters:
    """The tool as part of the last link, all other links without anything. The flange's axes are the link's, turned by
    π about z (see `identification.export.kinematic_urdf`).
    """
    turn = np.diag([-1.0, -1.0, 1.0])
    mass, center, inertia = np.zeros(links), np.zeros((links, 3)), np.zeros((links, 3, 3))
    mass[-1] = tool.mass_kg or 0.0
    center[-1] = turn @ np.array(tool.center_of_mass_m or (0.0, 0.0, 0.0)) + np.array([0.0, 0.0, FLANGE_M])
    inertia[-1] = turn @ tool.inertia() @ turn
    still = np.zeros(links)
    return PhysicalParameters(mass, center, inertia, still, still.copy())
