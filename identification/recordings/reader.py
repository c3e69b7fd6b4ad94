"""One door for all recordings: by what a path is to the right reader, then joints, units and rows are judged alike."""

from __future__ import annotations

import fnmatch
import hashlib
import shlex
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from identification.errors import RecordingError, RecordingNotFoundError, RobotError
from identification.recordings.bag import bag_files, entries_of
from identification.recordings.cleaning import build_recording, check_shapes
from identification.recordings.csv_reader import read_csv
from identification.recordings.held import refuse_staircase
from identification.recordings.joint_choice import for_robot, select_joints
from identification.recordings.leaps import refuse_leaps, with_whole_turns
from identification.recordings.log_reader import read_bag_folder, read_log
from identification.recordings.npz_reader import read_npz
from identification.recordings.recording import PERIOD_STATED, UNITS_STATED, Finding, Recording
from identification.recordings.table import RawTable
from identification.recordings.units import check_units, in_si
from identification.robots import Installation, RobotModel, load_robot
from identification.robots.installation import ON_THE_FLOOR
from identification.robots.same_arm import OTHER_GRAVITY, difference_of_arms

Tables = list[RawTable] | Recording
READERS: dict[str, Callable[[Path], Tables]] = {".npz": read_npz, ".csv": read_csv, ".mcap": read_log, ".db3": read_log}
RUN_RECORDING = "recording.mcap"
RUN_PARTS = "recording.part*.mcap"
RUN_BROKEN = "recording.broken.mcap"
"""Kept beside the recording once its parts were joined."""
NOT_MEASURED = ("desired", "command", "target", "reference", "goal", "setpoint")
"""In the last word of a topic's name: what was wanted, not what was measured."""
NEARLY_AS_MANY = 0.8


@dataclass(frozen=True, slots=True)
class Inputs:
    """Recordings of one robot, and the robot, all with the same joints in the same order."""

    recordings: tuple[Recording, ...]
    robot: RobotModel


def read_inputs(
    files: Iterable[str | Path],
    *,
    robot: str | Path | None = None,
    installation: Installation | None = None,
    joints: Sequence[str] | None = None,
    model_robot: RobotModel | None = None,
) -> Inputs:
    """Recordings and their robot, as every command reads them; arguments as of `read_recording`.

    Raises RecordingError where two recordings name different robots or installations and nobody says which.
    """
    recordings = [
        read_recording(file, robot=robot, installation=installation, joints=joints, model_robot=model_robot)
        for file in files
    ]
    return inputs_of(recordings, robot=robot, installation=installation, model_robot=model_robot)


def inputs_of(
    recordings: Sequence[Recording],
    *,
    robot: str | Path | None = None,
    installation: Installation | None = None,
    model_robot: RobotModel | None = None,
) -> Inputs:
    """Recordings that were read already, with their robot; arguments and errors as of `read_inputs`."""
    if robot is None and model_robot is not None:
        arm = model_robot
    else:
        arm = load_robot(robot or robot_of(recordings), installation or _installation_of(recordings))
    return Inputs(tuple(for_robot(recording, arm) for recording in recordings), arm)


def read_recording(
    path: str | Path,
    *,
    robot: str | Path | RobotModel | None = None,
    installation: Installation | None = None,
    joints: Sequence[str] | None = None,
    model_robot: RobotModel | None = None,
    units: dict[str, str] | None = None,
    topic: str | None = None,
    period_s: float | None = None,
) -> Recording:
    """Read a recording: .npz, .csv, .mcap, .db3, the folder of a run or of a ROS 2 bag.

    robot: overrides the robot that the file names. installation: how it stands, overrides the file's. joints: which of
    the recorded joints are the robot's, in its order; default: by their names. model_robot: robot of the model that the
    recording is for, taken where the file names none; where it names another arm, that is an error. units: of t, q, dq
    and tau, over what the file states. topic: of a bag with several. period_s: with which the motion repeats, over what
    the file states.
    Doubtful rows are found, named in `Recording.report` and left out. Raises RecordingNotFoundError (exit 66) when
    there is no such file, RecordingError (exit 65) when it cannot be used; the text says why.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingNotFoundError.at(path, "there is no such recording")
    file = recording_file(path)
    with ThreadPoolExecutor(1) as beside:  # a digest needs no interpreter
        digest = beside.submit(_digest, file)
        found = read_bag_folder(file) if file.is_dir() else _reader_of(file)(file)
    if isinstance(found, Recording):
        if units or period_s is not None:
            original = found.source.metadata["imported_from"]
            field = f"{next(iter(units))}_unit" if units else "period_s"
            other = "in SI units since then: state other units" if units else "with its period: state another"
            raise RecordingError.named(path, f"is an import, {other} where {original} is imported", field=field)
        arm, notes = _arm(found, robot, installation, model_robot)
        recording = found if arm is None else with_whole_turns(for_robot(found, arm, joints), arm)
    else:
        tables = [replace(each, units={**each.units, **(units or {})}) for each in found]
        if period_s is not None:
            tables = [_with_period(each, period_s) for each in tables]
        table, arm, notes = _chosen(tables, robot, installation, joints, model_robot, topic)
        table = in_si(table, arm)
        recording = build_recording(table, sha256=digest.result())
        recording = recording if arm is None else with_whole_turns(recording, arm)
        recording = recording if arm is None or not arm.mimics else for_robot(recording, arm)
        if table.units:
            metadata = {**recording.source.metadata, UNITS_STATED: " ".join(table.units)}
            recording = replace(recording, source=replace(recording.source, metadata=metadata))
    if arm is not None:
        recording = replace(recording, robot=arm.spec, installation=arm.installation)
    elif installation is not None:
        recording = replace(recording, installation=installation)
    checked = check_units(recording, arm)
    if arm is not None:
        refuse_leaps(checked, arm)
        refuse_staircase(path, checked.position, checked.sampling_period_s)
    return _noted(checked, notes)


def recording_file(path: Path) -> Path:
    """The recording that a path stands for: the file itself, a run folder's log, or the folder of a bag.

    Raises RecordingError for a run whose log is in parts, and for a folder of thousands of files.
    """
    if not path.is_dir():
        return path
    if fnmatch.filter((entry.name for entry in entries_of(path)), RUN_PARTS) and not (path / RUN_BROKEN).is_file():
        command = f"iiwa-ident recover {shlex.quote(str(path))}"
        raise RecordingError.at(path, f"its recording is in parts; make it whole with: {command}")
    log = path / RUN_RECORDING
    return log if log.is_file() else path


def _reader_of(path: Path) -> Callable[[Path], Tables]:
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise RecordingError.named(
            path, f"recordings end in {', '.join(READERS)} or are folders, this one ends in '{path.suffix}'"
        )
    return reader


def _with_period(table: RawTable, period_s: float) -> RawTable:
    """The table with another statement of its period. Raises RecordingError where the run itself has written it."""
    if table.period_index is not None:
        what = "was recorded with the number of each period: they are taken, and no other is stated"
        raise RecordingError.named(table.path, what, field="period_s")
    return replace(table, period_s=period_s, metadata={**table.metadata, PERIOD_STATED: "1"})


def _chosen(
    tables: list[RawTable],
    robot: str | Path | RobotModel | None,
    installation: Installation | None,
    joints: Sequence[str] | None,
    model_robot: RobotModel | None,
    topic: str | None,
) -> tuple[RawTable, RobotModel | None, list[str]]:
    """The table that is meant, with the robot's joints only, the robot where one is known, and what was noticed."""
    for table in tables:
        check_shapes(table)
    arm, notes = _arm(tables[0], robot, installation, model_robot)
    path = tables[0].path
    if topic is not None:
        named = [table for table in tables if table.topic == topic]
        if not named:
            raise RecordingError.named(
                path,
                f"has no JointState topic {topic} with effort, but {', '.join(t.topic for t in tables)}",
                field="topic",
            )
        return select_joints(named[0], arm, joints), arm, notes
    fitting: list[RawTable] = []
    refusal: RecordingError | None = None
    for table in tables:
        try:
            fitting.append(select_joints(table, arm, joints))
        except RecordingError as error:
            refusal = refusal or error
    if not fitting:
        assert refusal is not None
        raise refusal
    measured = [table for table in fitting if not any(word in table.topic.split("/")[-1] for word in NOT_MEASURED)]
    fitting = sorted(measured or fitting, key=lambda table: -table.time.size)
    if len(fitting) > 1 and fitting[1].time.size > NEARLY_AS_MANY * fitting[0].time.size:
        raise RecordingError.named(
            path,
            f"{fitting[0].topic} and {fitting[1].topic} both hold joints with effort and as many "
            "messages; import it and choose one with --topic",
            field="topic",
        )
    if len(tables) > 1:
        others = ", ".join(table.topic for table in tables if table.topic != fitting[0].topic)
        notes.append(f"{fitting[0].topic} was read; it also holds {others}")
    return fitting[0], arm, notes


def _arm(
    found: RawTable | Recording,
    robot: str | Path | RobotModel | None,
    installation: Installation | None,
    model_robot: RobotModel | None,
) -> tuple[RobotModel | None, list[str]]:
    """The robot the recording is of, None where nobody knows, and sentences on whom that contradicts."""
    path = Path(found.path if isinstance(found, RawTable) else found.source.path)
    stood = found.installation
    if isinstance(robot, RobotModel):
        given: RobotModel | None = robot
    else:
        given = None if robot is None else load_robot(robot, installation or stood)
    if given is not None and model_robot is not None:
        _refuse_other_arm(path, given, model_robot)
    if found.robot is None:
        if given is None and model_robot is not None and stood.gravity != ON_THE_FLOOR.gravity:
            as_stated = Installation(stood.gravity, model_robot.locked_joints)
            _refuse_other_arm(path, load_robot(model_robot.spec, installation or as_stated), model_robot)
        return given or model_robot, []
    assumed = installation or (stood if stood != ON_THE_FLOOR or model_robot is None else model_robot.installation)
    try:
        named = load_robot(found.robot, given.installation if given is not None else assumed)
    except RobotError as error:
        if given is not None:
            return given, []
        if model_robot is not None:
            return model_robot, [f"the robot it names cannot be read ({error}); it was taken as {model_robot.name}"]
        if installation is not None:
            raise
        # Fits and diagnoses will say so; an import keeps all joints under their names.
        return None, []
    if given is not None:
        difference = difference_of_arms(named, given)
        if difference:
            return given, [f"it says that it is of {named.name}; it was taken as {given.name} ({difference}), as asked"]
        return given, []
    if model_robot is not None:
        _refuse_other_arm(path, named, model_robot)
        return model_robot, []
    return named, []


def _refuse_other_arm(path: Path, named: RobotModel, model_robot: RobotModel) -> None:
    difference = difference_of_arms(model_robot, named)
    if difference == OTHER_GRAVITY:
        there, here = (", ".join(f"{value:g}" for value in robot.gravity) for robot in (named, model_robot))
        raise RecordingError.named(
            path,
            f"was made under gravity ({there}) m/s² in the frame of the base, the model under ({here}). If that is "
            "not so, give the right --mount or --gravity, of an import where it is made",
            field="gravity",
        )
    if difference:
        raise RecordingError.named(
            path,
            f"is of {named.name}, but the model is of {model_robot.name}: {difference}. If the recording "
            f"is wrong about itself, say --robot {model_robot.spec}",
            field="robot",
        )


def _noted(recording: Recording, notes: list[str]) -> Recording:
    if not notes:
        return recording
    report = recording.report
    return replace(recording, report=report.first(Finding.of_all("note", report.rows_read, note) for note in notes))


def _digest(path: Path) -> str:
    """Digest of a file, or of a bag's files in their order; of a bag with one file that file's."""
    if not path.is_dir():
        return file_digest(path)
    digests = [file_digest(file) for file in bag_files(path)]
    return digests[0] if len(digests) == 1 else hashlib.sha256("".join(digests).encode()).hexdigest()


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _installation_of(recordings: Sequence[Recording]) -> Installation:
    if not recordings:
        return ON_THE_FLOOR
    first = recordings[0]
    for other in recordings[1:]:
        if other.installation != first.installation:
            raise RecordingError.named(
                other.source.path,
                f"was made with another gravity or other joints held than "
                f"{Path(first.source.path).name}; fit them apart, or say --mount and --lock for all",
                field="installation",
            )
    return first.installation


def robot_of(recordings: Iterable[Recording]) -> str:
    """The robot that all the recordings name.

    Raises RecordingError when one of them names none or two name different ones: the caller must then say which.
    """
    named: str | None = None
    first = ""
    for recording in recordings:
        name = Path(recording.source.path).name
        if recording.robot is None:
            raise RecordingError.named(
                recording.source.path,
                "does not say which robot it is of; give --robot NAME or --robot FILE.urdf",
                field="robot",
            )
        # An import names the file from its own folder: arms/../arm.urdf is arm.urdf.
        if named is not None and Path(recording.robot).resolve() != Path(named).resolve():
            raise RecordingError.named(
                recording.source.path,
                f"is of robot {recording.robot}, but {first} is of {named}; give --robot to use one for both",
                field="robot",
            )
        named, first = recording.robot, name
    if named is None:
        raise RecordingError("No recording was given")
    return named
