"""What every command that reads recordings shares: its options, and the one place where they are read.

A robot, how it stands and which joints are meant are asked for in the same words everywhere. Nothing is computed here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.cli.output import message

if TYPE_CHECKING:
    from daemon.config import DaemonConfig
    from identification.recordings.reader import Inputs
    from identification.robots import Installation, RobotModel

LogsArgument = Annotated[
    list[Path], typer.Argument(help="Recordings: .mcap, .npz, .csv, .db3, run folders or ROS 2 bag folders.")
]
ModelArgument = Annotated[Path, typer.Argument(metavar="MODEL.json", help="A model written by fit or diagnose.")]
RobotOption = Annotated[str | None, typer.Option("--robot", help="iiwa14, iiwa7, a URDF or an MDH table (CSV).")]
JointsOption = Annotated[
    str | None,
    typer.Option("--joints", metavar="A,B,…", help="Recorded joints that are the robot's, in its order, by name."),
]
LockOption = Annotated[
    list[str] | None,
    typer.Option("--lock", metavar="JOINT=POSITION", help="Joint of the URDF that stood still, rad (m); repeatable."),
]
ArmOption = Annotated[
    str | None, typer.Option("--arm", metavar="NAME", help="One of the arms that the file of --config names.")
]
WALL = "wall: its +x (iiwa14, iiwa7: −x of base_link) points down"
MountOption = Annotated[
    str | None, typer.Option("--mount", metavar="floor|wall|ceiling", help=f"How the base is mounted; {WALL}.")
]
FoundMountOption = Annotated[
    str | None,
    typer.Option(
        "--mount",
        metavar="floor|wall|ceiling|auto",
        help=f"How the base is mounted; {WALL}; auto: as the recordings say.",
    ),
]
GravityOption = Annotated[
    str | None,
    typer.Option(
        "--gravity",
        metavar="X,Y,Z",
        help="Gravity in the frame of the base, m/s²; iiwa14, iiwa7: the paper's, base_link turned by 180° about z.",
    ),
]


@dataclass(frozen=True, slots=True)
class RecordedArm:
    """Whose recordings they are, which of their joints are meant, and how the arm stood, as a command states it."""

    robot: RobotOption = None
    joints: JointsOption = None
    lock: LockOption = None
    mount: FoundMountOption = None
    gravity: GravityOption = None

    @property
    def finds_mount(self) -> bool:
        """Whether the recordings are to say how it stood."""
        return self.mount == "auto"

    @property
    def installation(self) -> Installation | None:
        """What is stated of the stand; None where nothing is."""
        return installation_of(self.gravity, None if self.finds_mount else self.mount, self.lock)

    def load(
        self, logs: Sequence[Path], *, model_robot: RobotModel | None = None, fits: bool = False, say: bool = True
    ) -> Inputs:
        """Recordings and their robot; what was found wrong is said on stderr, unless not `say`. As `read_inputs`.

        fits: whether a model of the arm will be fitted to them, which needs the gravity that it felt: a recording that
        contradicts the stated one is then a RecordingError, else it is only said.
        """
        from identification.audit.mount import other_stand, require_stated_stand
        from identification.errors import RecordingError
        from identification.recordings.reader import read_inputs
        from identification.recordings.standing import standing_values

        def read(stand: Installation | None) -> Inputs:
            return read_inputs(
                logs, robot=self.robot, installation=stand, joints=names_of(self.joints), model_robot=model_robot
            )

        inputs = read(self.installation)
        if not say:
            return inputs
        for log, recording in zip(logs, inputs.recordings, strict=True):
            for finding in (*recording.report.findings, *standing_values(recording)):
                message(f"{log}: {finding.sentence}")
        # How the arm of a model.json stands is stated by it; what a recording shows otherwise is an answer.
        if self.finds_mount and model_robot is None:
            found = other_stand(inputs.recordings, inputs.robot)
            if found is None:
                message("The recordings show no other mounting than the one stated.")
                return inputs
            _, mounting = found
            message(mounting.taken)
            inputs = read(mounting.installation(inputs.robot.locked_joints))
        if fits:
            require_stated_stand(inputs.recordings, inputs.robot)
            return inputs
        try:
            found = other_stand(inputs.recordings, inputs.robot)
        except RecordingError as error:  # beside a model it is an answer
            message(str(error))
            return inputs
        if found is not None:
            message(found[1].sentence if model_robot is None else found[1].other)
        return inputs


@contextmanager
def as_usage(*errors: type[Exception]) -> Iterator[None]:
    """Errors that the values of options alone make inside are usage errors: nothing was read yet, nothing computed."""
    try:
        yield
    except errors as error:
        raise typer.BadParameter(str(error)) from error


def settings_of(config: Path | None, arm: str | None) -> DaemonConfig:
    """The configuration in a file, of one arm where --arm names it; without a file, all as it is by default."""
    from daemon.config import DaemonConfig, load_config

    if config is not None:
        return load_config(config, arm)
    if arm is not None:
        raise typer.BadParameter("--arm names one of the arms in a file: add --config FILE.")
    return DaemonConfig()


def names_of(joints: str | None) -> list[str] | None:
    """The names in a list with commas. Raises a usage error for a list that no recording can have."""
    if joints is None:
        return None
    names = [name.strip() for name in joints.split(",") if name.strip()]
    if not names or len(set(names)) < len(names):
        what = "names no joint" if not names else "chooses a joint twice"
        raise typer.BadParameter(f"--joints '{joints}' {what}; A,B,… does, each recorded joint once.")
    return names


def installation_of(gravity: str | None, mount: str | None, lock: list[str] | None) -> Installation | None:
    """What the options say of the robot's stand, None where they say nothing."""
    from identification.errors import RobotError
    from identification.robots import Installation

    with as_usage(RobotError):
        return Installation.parse(gravity=gravity, mount=mount, lock=lock or ())
