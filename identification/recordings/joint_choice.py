"""Which of the recorded joints are the robot's, and in which order: by their names, never by guessing.

Pure functions of names, and their use on a table or a recording.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.errors import RecordingError
from identification.recordings.recording import OF_JOINTS, Finding, Recording
from identification.recordings.table import RawTable
from identification.robots.model import RobotModel

LARGEST_SHARE_OF_BAD_ROWS = 0.2
HELD_WITHIN = 0.02
"""rad or m: a brake's play, and what `--lock` is written to."""
_NUMBERED = re.compile(r"^(.*?)(\d+)$")
_SHOWN = 24
_OF_MOTION = ("position", "velocity", "command_position", "link_position")


@dataclass(frozen=True, slots=True)
class JointChoice:
    """columns: of the recording, in the order of the robot's joints. names: what the columns are called from now on.
    sentence: what was left out or put into another order, empty where nothing was.
    """

    columns: tuple[int, ...]
    names: tuple[str, ...] | None
    sentence: str = ""


def match_names(recorded: Sequence[str], robot: Sequence[str], *, serial: bool) -> tuple[int, ...] | None:
    """Places in `recorded` of the robot's joints, in their order; None where the names do not say it.

    Three rules, the first that holds: the robot's names as they are; the same with one prefix for all, on either side
    ("left/joint_a"); names that end in 1…n or 0…n−1 after one common stem, in the order of their numbers, against the
    robot's own numbers or, where it has none and is one chain (serial), its joints from the base outwards. Where two
    stems would do (two arms), none is taken.
    """
    places = {name: place for place, name in enumerate(recorded)}
    if all(name in places for name in robot):
        return tuple(places[name] for name in robot)
    if any(name in places for name in robot):
        return None
    prefixed = [matched for prefix in _prefixes(recorded, robot) if (matched := _with_prefix(places, robot, prefix))]
    if len(prefixed) == 1:
        return prefixed[0]
    sequences = _sequences(recorded, len(robot))
    if prefixed or len(sequences) != 1:
        return None
    own = _sequences(robot, len(robot))
    if not own and not serial:
        return None
    by_rank = [places[name] for name in sequences[0]]
    if not own:
        return tuple(by_rank)
    rank = {name: place for place, name in enumerate(own[0])}
    return tuple(by_rank[rank[name]] for name in robot)


def _prefixes(recorded: Sequence[str], robot: Sequence[str]) -> list[tuple[str, str]]:
    """(put before the robot's names, taken off the robot's names), from what the first joint allows."""
    first = robot[0]
    put = [(name.removesuffix(first), "") for name in recorded if name.endswith(first)]
    taken = [("", first.removesuffix(name)) for name in recorded if first.endswith(name)]
    return [pair for pair in (*put, *taken) if not "".join(pair)[-1:].isalnum()]


def _with_prefix(places: dict[str, int], robot: Sequence[str], prefix: tuple[str, str]) -> tuple[int, ...] | None:
    put, taken = prefix
    if not all(name.startswith(taken) for name in robot):
        return None
    names = [put + name.removeprefix(taken) for name in robot]
    return tuple(places[name] for name in names) if all(name in places for name in names) else None


def _sequences(names: Sequence[str], count: int) -> list[list[str]]:
    """Names with one stem that count from 1 to `count`, or from 0, in the order of their numbers."""
    stems: dict[str, dict[int, str]] = {}
    for name in names:
        found = _NUMBERED.match(name)
        if found is not None:
            numbered = stems.setdefault(found.group(1), {})
            number = int(found.group(2))
            # "j1" beside "j01": no order.
            numbered[-1 if number in numbered else number] = name
    return [
        [numbered[number] for number in sorted(numbered)]
        for numbered in stems.values()
        if sorted(numbered) in (list(range(1, count + 1)), list(range(count)))
    ]


def choose_joints(
    file: str | Path,
    recorded: Sequence[str] | None,
    count: int,
    robot: RobotModel | None = None,
    wanted: Sequence[str] | None = None,
) -> JointChoice:
    """The columns that are the robot's joints.

    recorded: names of the `count` columns, None where the file has none: then the columns are the robot's joints in
    order, and their number must be its own. wanted: names (or, without names, numbers from 1) in the order of the
    robot's joints; they decide. robot: None where no one knows it, which leaves all columns as they are.
    Raises RecordingError with both lists of names where they cannot be matched.
    """
    name = Path(file).name
    if recorded is not None:
        repeated = [item for item, times in Counter(recorded).items() if times > 1]
        if repeated:
            raise RecordingError.named(file, f"names joint '{repeated[0]}' twice", field="joint_names")
        if len(recorded) != count:
            raise RecordingError.named(file, f"names {len(recorded)} joints for {count} columns", field="joint_names")
    if wanted is not None:
        columns = _wanted(file, recorded, count, wanted)
        if robot is not None and len(columns) != len(robot.driven):
            raise RecordingError.named(
                file,
                f"{len(columns)} joints are chosen ({', '.join(wanted)}), but {_described(robot)}",
                field="joint_names",
            )
    elif recorded is None or robot is None:
        if robot is not None and count != len(robot.driven):
            raise RecordingError(_of_other_number(name, count, robot), file=file, field="q")
        return JointChoice(tuple(range(count)), None if recorded is None else tuple(recorded))
    else:
        serial = bool(np.all(robot.kinematics.parent == np.arange(-1, robot.n - 1)))
        matched = match_names(recorded, robot.driven_names, serial=serial)
        if matched is None:
            raise RecordingError(_unmatched(name, recorded, robot), file=file, field="joint_names")
        columns = matched
    labels = recorded if recorded is not None else tuple(str(column + 1) for column in range(count))
    chosen = [labels[column] for column in columns]
    left = [label for label in labels if label not in chosen]
    return JointChoice(columns, _names_after(recorded, robot, chosen), _sentence(labels, columns, left, robot))


def _names_after(
    recorded: Sequence[str] | None, robot: RobotModel | None, chosen: Sequence[str]
) -> tuple[str, ...] | None:
    if robot is not None:
        return robot.driven_names
    return None if recorded is None else tuple(chosen)


def _wanted(file: str | Path, recorded: Sequence[str] | None, count: int, wanted: Sequence[str]) -> tuple[int, ...]:
    labels = list(recorded) if recorded is not None else [str(column + 1) for column in range(count)]
    for item, times in Counter(wanted).items():
        if item not in labels or times > 1:
            what = "is chosen twice" if item in labels else "is none of its joints"
            raise RecordingError.named(
                file,
                f"'{item}' {what}; it has {_listed(labels)}"
                + ("" if recorded is not None else " (it names no joints: give their numbers)"),
                field="joint_names",
            )
    return tuple(labels.index(item) for item in wanted)


def _sentence(labels: Sequence[str], columns: Sequence[int], left: Sequence[str], robot: RobotModel | None) -> str:
    parts = []
    chosen = [labels[column] for column in columns]
    if robot is not None and list(columns) != sorted(columns):
        parts.append(f"its joints stand in another order than those of {robot.name} and were matched by name")
    elif robot is not None and tuple(chosen) != robot.driven_names:
        parts.append(f"its joints {_listed(chosen)} were taken as {_listed(robot.driven_names)} of {robot.name}")
    if left:
        parts.append(f"{_listed(left)} {'are' if len(left) > 1 else 'is'} left out")
    return "; ".join(parts)


def _of_other_number(name: str, count: int, robot: RobotModel) -> str:
    advice = (
        f"if {len(robot.driven) - count} of them stood still and were not recorded, say where: --lock JOINT=POSITION"
        if count < len(robot.driven)
        else "choose its columns from the base outwards, as in "
        f"--joints {','.join(map(str, range(1, len(robot.driven) + 1)))}"
    )
    return f"{name}: holds {count} joints, but {_described(robot)}; {advice}"


def _unmatched(name: str, recorded: Sequence[str], robot: RobotModel) -> str:
    there = [joint for joint in robot.driven_names if joint in recorded]
    missing = [joint for joint in robot.driven_names if joint not in recorded]
    if there:
        lock = " ".join(f"--lock {joint}=0" for joint in missing)
        return (
            f"{name}: holds {_listed(recorded)}, but not {_listed(missing)} of {robot.name}; if "
            f"{'they' if len(missing) > 1 else 'it'} stood still, say where, in rad (m): {lock}"
        )
    return (
        f"{name}: its joints {_listed(recorded)} cannot be matched with those of {robot.name}, "
        f"{_listed(robot.driven_names)}; name {len(robot.driven)} of them in that order with --joints NAME,NAME,…"
    )


def _described(robot: RobotModel) -> str:
    return f"the robot {robot.name} has {len(robot.driven)} ({_listed(robot.driven_names)})"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")


def select_joints(table: RawTable, robot: RobotModel | None, wanted: Sequence[str] | None = None) -> RawTable:
    """The table with the robot's joints only, in its order, and without the messages that name none of them.

    Without a robot and without `wanted`, the joints that most of the messages name together.
    Raises RecordingError where the joints cannot be matched, or where more than a fifth of the robot's messages names
    only some of its joints.
    """
    if robot is None and wanted is None and table.named is not None and table.joint_names is not None:
        wanted = _named_together(table)
    choice = choose_joints(table.path, table.joint_names, table.position.shape[1], robot, wanted)
    columns = list(choice.columns)
    changes: dict[str, Any] = {name: _columns(getattr(table, name), columns) for name in ("position", "torque")}
    optional = {name: _columns(values, columns) for name, values in table.optional.items()}
    findings, time = list(table.findings), table.time
    in_si = table.units.get("q", "rad") in ("rad", "m")  # where it is not, `--lock` and the column are of two units
    held_by, rows = robot if in_si else None, table.time.shape[0]
    findings += _left_out(table.path, choice, table.joint_names, table.position, held_by, rows)
    if table.named is not None:
        named = table.named[:, columns]
        mine = named.any(axis=1)
        partial = int((mine & ~named.all(axis=1)).sum())
        if partial > LARGEST_SHARE_OF_BAD_ROWS * max(int(mine.sum()), 1):
            raise RecordingError.named(
                table.path,
                f"{partial} of {int(mine.sum())} messages on {table.topic} name only some of "
                f"{_listed(choice.names or ())}; a row needs all of them at one time",
                field="joint_names",
            )
        if not mine.all():
            others = np.flatnonzero(~mine) + 1
            sentence = f"{others.size} messages on {table.topic} are of other joints and were left out"
            findings.append(Finding.of_rows("other_joints", others, sentence))
        changes = {name: values[mine] for name, values in changes.items()}
        optional = {name: values[mine] for name, values in optional.items()}
        time = time[mine]
    return replace(
        table, time=time, optional=optional, joint_names=choice.names, named=None, findings=findings, **changes
    )


def _columns(values: Any, columns: list[int]) -> Any:
    """Columns of an array, itself where they are all; one of another shape is left for the check of shapes to name."""
    if columns == list(range(values.shape[-1])):
        return values
    return values[:, columns] if values.ndim == 2 and values.shape[1] > max(columns) else values


def _named_together(table: RawTable) -> tuple[str, ...]:
    assert table.named is not None
    assert table.joint_names is not None
    sets = Counter(map(bytes, table.named))
    most = np.frombuffer(max(sets, key=lambda item: sets[item]), dtype=np.bool_)
    return tuple(name for name, there in zip(table.joint_names, most, strict=True) if there)


def for_robot(recording: Recording, robot: RobotModel, wanted: Sequence[str] | None = None) -> Recording:
    """The recording with the robot's joints in its order; the same object where they are so already.

    A joint that follows another stands where its rule says, without a torque of its own. Raises RecordingError where
    the joints cannot be matched.
    """
    if not robot.mimics:
        return _chosen_of(recording, robot, wanted)
    if recording.n == robot.n and recording.joint_names == robot.joint_names:
        return recording
    chosen = _chosen_of(recording, robot, wanted)
    changed: dict[str, Any] = {}
    for name, values in chosen.arrays(OF_JOINTS).items():
        whole = np.zeros((chosen.samples, robot.n))
        whole[:, list(robot.driven)] = values
        for follower, leader, multiplier, offset in robot.followers:
            if name in _OF_MOTION:
                whole[:, follower] = multiplier * whole[:, leader] + (0.0 if name == "velocity" else offset)
        changed[name] = whole
    return replace(chosen, joint_names=robot.joint_names, **changed)


def _chosen_of(recording: Recording, robot: RobotModel, wanted: Sequence[str] | None) -> Recording:
    choice = choose_joints(recording.source.path, recording.joint_names, recording.n, robot, wanted)
    columns = list(choice.columns)
    if not choice.sentence and columns == list(range(recording.n)):
        return recording
    changed: dict[str, Any] = {name: values[:, columns] for name, values in recording.arrays(OF_JOINTS).items()}
    rows_read = recording.report.rows_read
    notes = _left_out(recording.source.path, choice, recording.joint_names, recording.position, robot, rows_read)
    return replace(recording, joint_names=choice.names, report=recording.report.first(notes), **changed)


def _left_out(
    file: str | Path,
    choice: JointChoice,
    recorded: Sequence[str] | None,
    position: FloatArray,
    robot: RobotModel | None,
    rows: int,
) -> list[Finding]:
    """What is said of the joints left out. Raises RecordingError where one of them stood still, and not where `--lock`
    says.
    """
    notes = [Finding.of_all("joints_chosen", rows, choice.sentence)] if choice.sentence else []
    for called, joint, held, own in _held_columns(choice, recorded, position, robot) if robot is not None else ():
        if own.size == 0 or np.abs(own - held).max() <= HELD_WITHIN:
            continue
        if np.ptp(own) <= HELD_WITHIN:
            at = float(np.median(own))
            advice = (
                f"give --lock {joint}={at:.6g}" if called == f"joint {joint}" else "give --lock as the joints stood"
            )
            what = f"{called} stood at {at:.4g} rad (m), not at {held:g}; {advice}"
            raise RecordingError.named(file, what, field="joint_names")
        sentence = (
            f"WARNING, {called} is taken as held at {held:g} rad (m), but it was recorded from {own.min():.3g} to "
            f"{own.max():.3g}; of a gripper that may do, of an arm's joint it does not"
        )
        notes.append(Finding.of_all("held_joint_moves", rows, sentence))
    return notes


def _held_columns(
    choice: JointChoice, recorded: Sequence[str] | None, position: FloatArray, robot: RobotModel
) -> list[tuple[str, str, float, FloatArray]]:
    """Of each locked joint: what to call its column, its name, where it is said to be held, and what was recorded.

    Columns without names that are as many as the locked joints are theirs, each of the one that stands nearest.
    """
    columns = [values[np.isfinite(values)] for values in position.T]
    if recorded is not None:
        named = [(joint, held) for joint, held in robot.locked_joints if joint in recorded]
        return [(f"joint {joint}", joint, held, columns[recorded.index(joint)]) for joint, held in named]
    left = [column for column in range(len(columns)) if column not in choice.columns]
    if len(left) != len(robot.locked_joints):
        return []
    left.sort(key=lambda column: float(np.median(columns[column])) if columns[column].size else 0.0)
    locked = sorted(robot.locked_joints, key=lambda item: item[1])
    one = len(left) == 1
    return [
        (f"joint {joint}" if one else f"column {column + 1}, which is left out,", joint, held, columns[column])
        for column, (joint, held) in zip(left, locked, strict=True)
    ]
