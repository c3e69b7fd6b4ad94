"""What every command that reads recordings shares: its options, and the one place where they are read.

A robot, how it stands and which joints are meant are asked for in the same words everywhere. Nothing is computed here.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.cli.output import message

if TYPE_CHECKING:
    from identification.audit.mount import Mounting
    from identification.recordings.reader import Inputs
    from identification.robots import Installation, RobotModel

LogsArgument = Annotated[
    list[Path], typer.Argument(help="Recordings: .mcap, .npz, .csv, .db3, run folders or ROS 2 bag folders.")
]
RobotOption = Annotated[str | None, typer.Option("--robot", help="iiwa14, iiwa7, a URDF or an MDH table (CSV).")]
JointsOption = Annotated[
    str | None,
    typer.Option("--joints", metavar="A,B,…", help="Recorded joints that are the robot's, in its order, by name."),
]
LockOption = Annotated[
    list[str] | None,
    typer.Option("--lock", metavar="JOINT=POSITION", help="Joint of the URDF that stood still, rad (m); repeatable."),
]
ARM_WITHOUT_FILE = "--arm names one of the arms in a file: add --config FILE."
ArmOption = Annotated[
    str | None, typer.Option("--arm", metavar="NAME", help="One of the arms that the file of --config names.")
]
WALL = "wall: its +x (iiwa14, iiwa7: −x of base_link) points down"
MountOption = Annotated[
    str | None,
    typer.Option("--mount", metavar="floor|wall|ceiling", help=f"How the base is mounted; {WALL}."),
]
FoundMountOption = Annotated[
    str | None,
    typer.Option(
        "--mount",
        metavar="floor|wall|ceiling|auto",
        help=f"How the base is mounted; {WALL}; auto: as the recordings say.",
    ),
]
AUTO = "auto"
GravityOption = Annotated[
    str | None,
    typer.Option(
        "--gravity",
        metavar="X,Y,Z",
        help="Gravity in the frame of the base, m/s²; iiwa14, iiwa7: the paper's, base_link turned by 180° about z.",
    ),
]


def load_inputs(
    logs: Sequence[Path],
    robot: str | None,
    *,
    joints: str | None = None,
    installation: Installation | None = None,
    model_robot: RobotModel | None = None,
    find_mount: bool = False,
    say: bool = True,
) -> Inputs:
    """Recordings and their robot; what was found wrong in each is said on stderr, unless not `say`. As `read_inputs`.

    find_mount: take gravity as the recordings show it. Otherwise it is said where they show another than is stated.
    """
    from identification.recordings.reader import read_inputs

    def read(stand: Installation | None) -> Inputs:
        return read_inputs(logs, robot=robot, installation=stand, joints=names_of(joints), model_robot=model_robot)

    inputs = read(installation)
    if not say:
        return inputs
    for log, recording in zip(logs, inputs.recordings, strict=True):
        for finding in recording.report.findings:
            message(f"{log}: {finding.sentence}")
    found = _mounting(inputs)
    if found is not None and found.is_other:
        message(found.sentence if not find_mount else found.taken)
        if find_mount:
            held = inputs.robot.locked_joints
            return read(found.installation(held))
    elif find_mount:
        message("The recordings show no other mounting than the one stated.")
    return inputs


def _mounting(inputs: Inputs) -> Mounting | None:
    """How the base stands by the recordings alone; None where they are too short or at rest to say."""
    from identification.audit.mount import mounting_of
    from identification.errors import RecordingError

    try:
        return mounting_of(inputs.recordings, inputs.robot)
    except RecordingError:
        return None


def stated_mount(mount: str | None) -> str | None:
    """The mount as the user states it; None where the recordings are to say."""
    return None if mount == AUTO else mount


def names_of(joints: str | None) -> list[str] | None:
    """The names in a list with commas."""
    return None if joints is None else [name.strip() for name in joints.split(",") if name.strip()]


def installation_of(gravity: str | None, mount: str | None, lock: list[str] | None) -> Installation | None:
    """What the options say of the robot's stand, None where they say nothing."""
    from identification.errors import RobotError
    from identification.robots import Installation

    try:
        return Installation.parse(gravity=gravity, mount=mount, lock=lock or ())
    except RobotError as error:
        raise typer.BadParameter(str(error)) from error
