"""From a trajectory file to a run request: load, scale, tabulate, check. The step before anything moves.

Nothing here talks to a robot.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from daemon.api import RunRequest
from daemon.folders import make_folder
from daemon.motion.tip_speed import T1_SPEED_M_S, rounded_up, tip_speed
from daemon.motion.tool import FastenedMass, Tool
from daemon.motion.torque_foresight import TorqueForesight, stand_of_model, torque_foresight
from daemon.motion.workspace import Surroundings, load_surroundings
from daemon.motion.workspace_file import WorkspaceFile
from daemon.times import new_job_id
from identification.errors import TrajectoryError
from identification.excitation import Trajectory, default_trajectory, load_trajectory
from identification.excitation.limits import LONGEST_PERIOD_S
from identification.robots import Installation
from identification.robots.installation import ON_THE_FLOOR
from safety.limits import limits_for
from safety.preflight import preflight
from safety.preflight_report import PreflightReport

TABLE_RATE_HZ = 1000.0
LEAD_IN_S = 1.0
"""Seconds of the period that are driven before the first recorded one, so that the controller's transients die out."""


@dataclass(frozen=True, slots=True)
class PreparedMotion:
    """A motion ready to be run or refused.

    table: (N, 7) rad, one period at 1 kHz with the amplitude applied; preflight: the verdict on exactly this table.
    surroundings: what it was held against, the tool among them. lead_in_s: end of the period that is driven before the
    first recorded one, s.
    foresight: what its torque was predicted with, None: nothing is known of the arm, and no torque was checked.
    installation: how the arm stands.
    """

    name: str
    robot: str
    trajectory: Trajectory
    amplitude: float
    table: NDArray[np.float64]
    preflight: PreflightReport
    surroundings: Surroundings
    foresight: TorqueForesight | None
    lead_in_s: float = LEAD_IN_S
    installation: Installation = ON_THE_FLOOR

    def speed_sentence(self) -> str:
        """How fast the end of the tool goes along the motion, and whether T1 lets it."""
        fastest = tip_speed(self.surroundings.geometry, self.table, 1.0 / TABLE_RATE_HZ)
        is_slow = fastest <= T1_SPEED_M_S
        verdict = f"{'slow enough' if is_slow else 'too fast'} for T1, which allows {T1_SPEED_M_S:g} m/s"
        only = "" if is_slow else "; it does not begin in T1"
        return f"The end-effector reaches {rounded_up(fastest):.3f} m/s: {verdict}{only}."

    def foresight_sentence(self) -> str:
        """Plain words on what the check of torque stands on, and on what it does not know."""
        if self.foresight is None:
            return f"No torque was checked: nothing is known of the masses of {self.robot}; give a model with --model."
        tool = "The tool is counted in" if self.foresight.has_tool else "No tool is counted in but what the model has"
        return (
            f"Torque along the motion is predicted with {self.foresight.source}. {tool}. That of start ramp and stops "
            "is not predicted."
        )


def prepare_motion(
    source: Path | None,
    *,
    robot: str | None = None,
    amplitude: float = 1.0,
    workspace: Path | None = None,
    model: Path | None = None,
    tool: Tool | None = None,
    added_mass: FastenedMass | None = None,
    lead_in_s: float = LEAD_IN_S,
    installation: Installation | None = None,
) -> PreparedMotion:
    """Load a trajectory (None: the shipped excitation), scale it by `amplitude` in (0, 1] and check its 1 kHz table.

    robot: "iiwa14" or "iiwa7"; None takes the trajectory's own, or iiwa14. workspace: a workspace file, None: a floor
    at the mounting face. model: a model.json to foresee the torque with, None: what is taken to be known of the arm.
    tool: what it says stands before what the workspace file says of the tool; an empty one: nothing is on the flange.
    added_mass: fastened to the tool. installation: how the arm stands, None: as the model says, else on a floor.
    Raises TrajectoryError or ModelFileError (65, 66) for a file that cannot be used, ConfigurationError (78) for a
    workspace file, and LimitsError for a robot without limits; an unsafe motion is returned with its report.
    """
    trajectory = default_trajectory(robot or "iiwa14") if source is None else load_trajectory(source)
    if not trajectory.period_s <= LONGEST_PERIOD_S:
        reason = f"its period is {trajectory.period_s:g} s; at most {LONGEST_PERIOD_S:g} s can be driven. Is it in ms?"
        raise TrajectoryError(f"{source or 'the shipped excitation'}: {reason}", file=source)
    arm = robot or trajectory.robot or "iiwa14"
    table = trajectory.scaled(amplitude).table(TABLE_RATE_HZ)
    surroundings = load_surroundings(arm, workspace, tool, added_mass)
    stand = installation or (ON_THE_FLOOR if model is None else stand_of_model(model))
    foresight = torque_foresight(arm, model, surroundings.tool, stand)
    report = check_table(table, arm, surroundings, foresight, lead_in_s)
    name = f"shipped excitation of {arm}" if source is None else str(source)
    return PreparedMotion(name, arm, trajectory, amplitude, table, report, surroundings, foresight, lead_in_s, stand)


def check_table(
    table: NDArray[np.float64],
    robot: str,
    surroundings: Surroundings | None = None,
    foresight: TorqueForesight | None = None,
    lead_in_s: float = LEAD_IN_S,
    start: NDArray[np.float64] | None = None,
) -> PreflightReport:
    """Preflight of one period (N, 7) rad at 1 kHz of a built-in arm: limits, stops, ramp, self-collision, workspace.

    surroundings: None for a floor at the mounting face. foresight: for torque, None leaves that out. start: (7,) rad,
    where the start ramp begins; None: in the middle of the motion.
    """
    around = surroundings or load_surroundings(robot)
    # A table of another number of joints is the preflight's to refuse.
    fits = foresight is not None and table.shape[1:] == (foresight.regressor.robot.n,)
    torque = foresight.along(table, 1.0 / TABLE_RATE_HZ) if foresight is not None and fits else None
    return preflight(
        table,
        1.0 / TABLE_RATE_HZ,
        limits_for(robot),
        geometry=around.geometry,
        workspace=around.workspace,
        self_collision_margin_m=around.margins.self_collision_m,
        workspace_margin_m=around.margins.workspace_m,
        start_row=start_row_of(table, lead_in_s),
        start_position=start,
        torque=torque,
    )


def start_row_of(table: NDArray[np.float64], lead_in_s: float) -> int:
    """Row of a table (N, 7) at 1 kHz where the start ramp hands over to it: the lead-in ends with the period."""
    return (len(table) - round(lead_in_s * TABLE_RATE_HZ)) % len(table)


def write_run_request(motion: PreparedMotion, out_dir: Path, **settings: Any) -> RunRequest:
    """Write table, trajectory, workspace and preflight into the run's folder; the request that points to them.

    settings: further fields of RunRequest. Raises OSError, LogIOError when the folder cannot be written,
    ConfigurationError for a setting out of range.
    """
    make_folder(out_dir)
    table_file = out_dir / "table.npy"
    trajectory_file = out_dir / "trajectory.json"
    table = io.BytesIO()
    np.save(table, motion.table)
    table_file.write_bytes(table.getbuffer())  # numpy's own writing hides what the disk says
    trajectory_file.write_text(json.dumps(motion.trajectory.to_json(), indent=1) + "\n", encoding="utf-8")
    (out_dir / "preflight.json").write_text(json.dumps(motion.preflight.to_json(), indent=1) + "\n", encoding="utf-8")
    settings |= _noted_stand(motion.surroundings, motion.installation, out_dir)
    return RunRequest(
        run_id=settings.pop("run_id", None) or new_job_id(()),
        robot=motion.robot,
        table_file=str(table_file.resolve()),
        trajectory_file=str(trajectory_file.resolve()),
        out_dir=str(out_dir.resolve()),
        table_period_s=1.0 / TABLE_RATE_HZ,
        lead_in_s=motion.lead_in_s,
        amplitude=motion.amplitude,
        **settings,
    )


def write_monitor_request(
    robot: str, surroundings: Surroundings, installation: Installation, out_dir: Path, **settings: Any
) -> RunRequest:
    """The request of a run that commands nothing: what the arm carries and how it stands, but no motion.

    settings: further fields of RunRequest. Raises as `write_run_request`.
    """
    make_folder(out_dir)
    settings |= _noted_stand(surroundings, installation, out_dir)
    settings |= {"fit": False, "amplitude": 1.0, "periods": 1}
    return RunRequest(
        robot=robot, table_file="", trajectory_file="", out_dir=str(out_dir.resolve()), monitor_only=True, **settings
    )


def _noted_stand(surroundings: Surroundings, installation: Installation, out_dir: Path) -> dict[str, Any]:
    """Fields of a request: tool, surroundings and stand of the arm, with the file that describes them."""
    noted: dict[str, Any] = {"tool": surroundings.tool.describe()}
    if surroundings.entry != WorkspaceFile():
        # With the tool as it was taken: what is looked at before the start ramp is what was looked at here.
        workspace_file = out_dir / "workspace.yaml"
        workspace_file.write_bytes(msgspec.yaml.encode(surroundings.entry))
        noted["workspace_file"] = str(workspace_file.resolve())
    if installation != ON_THE_FLOOR:
        noted["gravity_m_s2"] = installation.gravity
    return noted
