"""How the base stands, asked of a recording alone: gravity's direction over the whole sphere. Pure.

A model fitted under the wrong gravity leaves much and looks like noise, so this is asked before any fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.arrays import FloatArray
from identification.audit.columns import GRAVITY, Geometry
from identification.audit.comparison import LEAST_GAIN, LEAST_SIGMAS, PARTS
from identification.audit.directions import Directions
from identification.audit.given import sizes_of, wide_open
from identification.audit.places import misplaced_joints
from identification.audit.rows import REPEATED, excerpt, rows_of
from identification.errors import RecordingError
from identification.fitting.misfit import notes_on_models_contradicted
from identification.fitting.rms import RmsTable
from identification.recordings.independence import recording_names
from identification.recordings.recording import Recording
from identification.remembered import once_per_object
from identification.robots.installation import Installation
from identification.robots.model import RobotModel

LEAST_ANGLE = np.radians(3.0)
"""A floor is level within this; less is for the audit against a model."""
LEAST_SHARE = 0.3
"""Of what the stated gravity leaves, that another takes away."""
TELLS = np.radians(10.0)
"""Half of a 95 % interval: wider, a recording does not tell how the base stands."""
WEIGHTLESS = (
    "The torque holds no weight of the arm: without gravity the recording goes far better with one rigid body. It is a "
    "torque beside the controller's own compensation of gravity, or an external one. Give the measured torque, or add "
    "what was taken off."
)
TURNS = 2
"""In which the noise that a direction leaves and its parameters settle."""
_SAME_DIRECTION = np.radians(0.5)
"""What is left under two directions so near is the same, and so would be the next direction."""


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """gravity: (3,) m/s² in the base frame, the likeliest; zero where the torque holds no weight. angle: rad from the
    stated one; spread: its standard deviation. gain, mirrored: nats of the likeliest against the stated, and against
    gravity upside down. rms_stated, rms_found: (n,) Nm that free parameters leave under each.
    """

    gravity: FloatArray
    angle: float
    spread: float
    gain: float
    mirrored: float
    rms_stated: FloatArray
    rms_found: FloatArray

    @property
    def _figures(self) -> tuple[str, str, str]:
        x, y, z = (f"{value:z.2f}" for value in self.gravity.tolist())
        return x, y, z

    @property
    def is_other(self) -> bool:
        """Whether the base stands otherwise than stated: by the evidence, and by an interval that tells."""
        return self.contradicts and self.angle > LEAST_SIGMAS * self.spread and self.tells

    @property
    def contradicts(self) -> bool:
        """Whether another gravity fits clearly better than the stated one, however closely that is known."""
        stated, found = (float(np.sum(values**2 / self.rms_found**2)) for values in (self.rms_stated, self.rms_found))
        return self.gain > LEAST_GAIN and self.angle > LEAST_ANGLE and found < (1.0 - LEAST_SHARE) * stated

    @property
    def weightless(self) -> bool:
        """Whether the torque is one without the weight of the arm."""
        return not self.gravity.any()

    @property
    def tells(self) -> bool:
        """Whether the recording shows how the base stands."""
        return bool(1.96 * self.spread < TELLS)

    @property
    def other(self) -> str:
        """How it stands where `is_other`, without what to do about it."""
        if self.weightless:
            return WEIGHTLESS
        x, y, z = self._figures
        half = max(np.degrees(1.96 * self.spread), 0.1)
        return (
            f"The base does not stand as stated: gravity is ({x}, {y}, {z}) m/s² in its frame, "
            f"{np.degrees(self.angle):.0f} ± {half:.2g}° from what is stated."
        )

    @property
    def sentence(self) -> str:
        """What an operator reads."""
        x, y, z = self._figures
        half = max(np.degrees(1.96 * self.spread), 0.1)
        if self.is_other:
            return self.other if self.weightless else f"{self.other} Give --mount auto, or --gravity={x},{y},{z}."
        if self.tells and self.angle < LEAST_ANGLE:
            well = f"The base stands as stated: gravity is {np.degrees(self.angle):.1f} ± {half:.1f}° from it"
            return f"{well}." if self.mirrored > LEAST_GAIN else f"{well}, or upside down, which looks alike here."
        if self.tells:
            return (
                f"Gravity may be {np.degrees(self.angle):.1f} ± {half:.1f}° from what is stated: ({x}, {y}, {z}) m/s². "
                "It would explain too little to be sure of it; it is taken as stated."
            )
        if self.contradicts:
            return (
                f"The base hardly stands as stated: gravity ({x}, {y}, {z}) m/s² in its frame fits far better. The "
                f"recording tells it to ± {half:.2g}° only, and the stated one is taken. Give --gravity as it stands."
            )
        return (
            "This recording does not tell how the base stands: it is taken as stated, but gravity "
            f"({x}, {y}, {z}) m/s² in its frame fits about as well. Record a motion that turns every link."
        )

    @property
    def taken(self) -> str:
        """What is said where it is taken for the fit."""
        x, y, z = self._figures
        return f"Gravity is taken as the recordings show it: ({x}, {y}, {z}) m/s² in the frame of the base."

    def installation(self, locked_joints: tuple[tuple[str, float], ...]) -> Installation:
        """The stand found, with joints that were held."""
        x, y, z = (float(value) for value in self.gravity)
        return Installation((x, y, z), locked_joints)


def require_stated_stand(recordings: Sequence[Recording], robot: RobotModel) -> None:
    """Raises RecordingError, field gravity, where a recording shows that the base stands otherwise than is stated."""
    found = other_stand(recordings, robot)
    if found is not None:
        recording, mounting = found
        raise RecordingError.at(recording.source.path, f"{mounting.sentence}", field="gravity")


def other_stand(recordings: Sequence[Recording], robot: RobotModel) -> tuple[Recording, Mounting] | None:
    """The first recording that contradicts the robot's gravity, and how its base stands; None where none does.

    Each is asked alone, so that one among many is found. Those at rest or too short contradict nothing; an arm with
    joints that follow others is not asked. Raises RecordingError where it is no other stand that a recording shows:
    field q for joints that stand elsewhere or count the other way, tau for a torque that holds no weight.
    """
    if robot.mimics:
        return None
    for recording in recordings:
        try:
            found = mounting_of([recording], robot, LEAST_GAIN)
        except RecordingError:
            continue
        if found is not None and found.is_other:
            misplaced = misplaced_joints([recording], robot, found.gravity)
            if misplaced is not None:
                raise RecordingError.at(recording.source.path, misplaced.sentence, field="q")
            if found.weightless:
                raise RecordingError.at(recording.source.path, found.sentence, field="tau")
            return recording, found
    return None


def stand_in_doubt(recordings: Sequence[Recording], robot: RobotModel) -> str:
    """What is said of the first recording that contradicts the robot's gravity, but hardly tells another; else empty.

    Of recordings at rest or too short nothing is said, nor of an arm with joints that follow others.
    """
    for recording in () if robot.mimics else recordings:
        try:
            found = mounting_of([recording], robot, LEAST_GAIN)
        except RecordingError:
            continue
        if found is not None and found.contradicts and not found.tells:
            return found.sentence
    return ""


def misplaced(recordings: Sequence[Recording], robot: RobotModel) -> str:
    """What is said where torques, positions or both are not those of their joint, or count the other way; else empty.

    So it is where another stand is likelier, of recordings at rest or too short, and where joints follow others.
    """
    return _misplaced_alone(recordings[0], robot) if len(recordings) == 1 else _misplaced(recordings, robot)


@once_per_object
def _misplaced_alone(recording: Recording, robot: RobotModel) -> str:
    """A recording is asked by its fit, by that of several, and before a load is weighed with it."""
    return _misplaced([recording], robot)


def _misplaced(recordings: Sequence[Recording], robot: RobotModel) -> str:
    try:
        found = misplaced_joints(recordings, robot)
        stand = None if found is None else mounting_of(recordings, robot, LEAST_GAIN)
        if stand is not None and stand.is_other:
            found = misplaced_joints(recordings, robot, stand.gravity)
    except RecordingError:
        return ""
    return "" if found is None else found.sentence


def notes_on_another_set_up(rms: RmsTable, recordings: Sequence[Recording], robot: RobotModel) -> tuple[str, ...]:
    """`notes_on_models_contradicted` with what a fit of those recordings would say of joints that stand elsewhere."""
    called = dict(zip(recording_names(recordings), recordings, strict=True))
    return notes_on_models_contradicted(rms, lambda name: misplaced([called[name]], robot))


def mounting_of(recordings: Sequence[Recording], robot: RobotModel, least_gain: float = -np.inf) -> Mounting | None:
    """Gravity of recordings without any model of the arm; None for one that no gravity acts on or that is all level.

    None too where the likeliest gravity gains less than `least_gain` nats against the stated one: how certain it is is
    then not asked. Zero where no gravity at all is likelier than any. Raises RecordingError for recordings at rest or
    too short.
    """
    stated = np.array(robot.gravity, dtype=np.float64)
    rows = rows_of([excerpt(recording) for recording in recordings])
    geometry, sizes = Geometry(robot, rows), sizes_of(robot, rows)
    if not geometry.heavy.any():
        return None
    everything = Directions.of(geometry, rows.torque)
    factor, mean = wide_open(sizes), np.zeros(len(sizes.each))
    gravity, std = stated, sizes.first_noise
    weight = 1.0 / (REPEATED * std**2)
    for _ in range(TURNS):
        # Weighted by what is left, the next direction may be another one.
        before = gravity
        std = np.maximum(everything.left(before, 1.0 / std**2, factor), sizes.least_noise)
        weight = 1.0 / (REPEATED * std**2)
        gravity, _ = everything.best(weight, mean, factor, GRAVITY)
        if _angle(gravity, before) < _SAME_DIRECTION:
            break
    none = np.zeros(3)
    likely, as_stated, without = (everything.evidence(each, weight, mean, factor) for each in (gravity, stated, none))
    weightless = without - likely > LEAST_GAIN
    gravity = none if weightless else gravity
    gain = (without if weightless else likely) - as_stated
    if gain < least_gain:
        return None
    angle = _angle(gravity, stated)
    rms = [everything.left(each, weight, factor) for each in (stated, gravity)]
    if weightless:
        return Mounting(gravity, angle, 0.0, gain, gain, rms[0], rms[1])
    mirrored = everything.evidence(gravity, weight, mean, factor) - everything.evidence(-gravity, weight, mean, factor)
    spread = Directions.of(geometry, rows.torque, PARTS).spread(gravity, weight, mean, factor)
    return Mounting(gravity, angle, spread, gain, mirrored, rms[0], rms[1])


def _angle(first: FloatArray, second: FloatArray) -> float:
    """The angle between two directions in rad; a right angle where one has no length."""
    size = max(float(np.linalg.norm(first) * np.linalg.norm(second)), 1e-9)
    return float(np.arccos(np.clip(first @ second / size, -1.0, 1.0)))
