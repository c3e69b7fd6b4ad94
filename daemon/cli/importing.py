"""The command `import`: recordings made by others, as logs of this project."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.cli.app import app
from daemon.cli.inputs import RecordedArm, names_of
from daemon.cli.option_groups import grouped
from daemon.cli.output import JsonOption, data, data_lines, message, wants_json_on_stdout, write_json

if TYPE_CHECKING:
    from identification.recordings import Recording


@app.command("import")
@grouped
def import_recording(
    files: Annotated[
        list[Path], typer.Argument(help="Recordings of others: .npz, .csv, ROS 2 .mcap, .db3 or bag folders.")
    ],
    arm: RecordedArm,
    topic: Annotated[str | None, typer.Option("--topic", help="JointState topic, where a bag has several.")] = None,
    unit: Annotated[
        list[str] | None,
        typer.Option(
            "--unit", metavar="QUANTITY=UNIT", help="Of t, q, dq or tau, such as q=deg, t=ms or q=deg,mm; repeatable."
        ),
    ] = None,
    period: Annotated[
        float | None,
        typer.Option("--period", help="Seconds until the motion repeats, over what the file states; 0: it does not."),
    ] = None,
    flip_torque: Annotated[
        bool, typer.Option("--flip-torque", help="Turn the sign of all torques, as where they have FRI's own.")
    ] = False,
    out: Annotated[Path | None, typer.Option("--out", help="Log to write (one file only); default: FILE.mcap.")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write over an earlier import. A robot's own log is never written over.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Bring recordings made by others into this project's log, and report gaps, jitter, repeated and garbled rows.

    Joints are matched with the robot's by name. No recording is ever written over.
    Example: iiwa-ident import measured.npz --robot arm.urdf --out measured.mcap
    """
    from identification.recordings import read_recording, write_recording
    from identification.recordings.standing import standing_values

    if out is not None and len(files) > 1:
        raise typer.BadParameter("--out takes one FILE; several files get a name of their own each.")
    targets = [out or _default_target(file) for file in files]
    _check_targets(files, targets, force)
    installation, units = arm.installation, _units_of(unit or ())
    results = []
    for file, target in zip(files, targets, strict=True):
        recording = read_recording(
            file,
            robot=arm.robot,
            installation=installation,
            joints=names_of(arm.joints),
            units=units,
            topic=topic,
            period_s=period,
        )
        recording = _as_it_stood(_turned(recording) if flip_torque else recording, find_mount=arm.finds_mount)
        write_recording(recording, target)
        results.append({"file": str(file), "log": str(target), **recording.report.to_json()})
        if not wants_json_on_stdout(json_file):
            data(
                f"{file}: {recording.samples} samples of {recording.n} joint{'s' * (recording.n != 1)}, "
                f"{recording.duration_s:.3f} s, written to {target}"
            )
            said = (*recording.report.findings, *standing_values(recording))
            data_lines(f"  {finding.sentence}" for finding in said)
    if json_file is not None:
        write_json(json_file, results)


def _turned(recording: Recording) -> Recording:
    """With the sign of all torques turned, which the import's report then says."""
    from identification.recordings.recording import Finding

    report = recording.report
    said = Finding.of_all("turned_torque", report.rows_read, "the sign of all torques was turned, as was asked for")
    return replace(recording, torque=-recording.torque, report=report.first([said]))


def _as_it_stood(recording: Recording, *, find_mount: bool) -> Recording:
    """The recording with the stand that it shows, where that is to be found; where it contradicts the stated one, a
    RecordingError. Without a robot nobody can say.
    """
    from identification.audit.mount import other_stand, require_stated_stand
    from identification.robots import load_robot

    if recording.robot is None:
        return recording
    robot = load_robot(recording.robot, recording.installation)
    if find_mount and (found := other_stand([recording], robot)) is not None:
        _, mounting = found
        message(mounting.taken)
        return replace(recording, installation=mounting.installation(robot.locked_joints))
    require_stated_stand([recording], robot)
    return recording


def _default_target(file: Path) -> Path:
    if file.suffix.lower() == ".mcap":
        return file.with_suffix(".imported.mcap")
    return file.with_name(f"{file.name}.mcap") if file.is_dir() else file.with_suffix(".mcap")


def _check_targets(files: list[Path], targets: list[Path], force: bool) -> None:
    """Raises a usage error where two imports would be one file, or where something would be lost."""
    from identification.recordings.writer import is_import

    source_of: dict[Path, Path] = {}
    for file, target in zip(files, targets, strict=True):
        place = target.resolve()
        if place in source_of:
            raise typer.BadParameter(
                f"{source_of[place]} and {file} would both be written to {target}; import one of them with --out."
            )
        source_of[place] = file
        if not target.exists():
            continue
        if not is_import(target):
            raise typer.BadParameter(f"{target} is there and is no import; it is not written over. Give another --out.")
        if not force:
            raise typer.BadParameter(f"{target} is there already; --force writes this import in its place.")
        if any(place == other.resolve() for other in files):
            raise typer.BadParameter(f"{target} would be written over itself; give another --out.")


def _units_of(texts: Sequence[str]) -> dict[str, str]:
    """Unit of each quantity; stated twice, for turning and for sliding joints, both with a comma."""
    from identification.recordings.units import unknown_unit

    units: dict[str, str] = {}
    for text in texts:
        quantity, separator, unit = (part.strip() for part in text.partition("="))
        if not separator:
            raise typer.BadParameter(f"'{text}' states no unit; QUANTITY=UNIT does, such as q=deg.")
        units[quantity] = f"{units[quantity]},{unit}" if quantity in units else unit
        if unknown := unknown_unit(quantity, units[quantity]):
            raise typer.BadParameter(f"By --unit {text}, {unknown}.")
    return units
