"""The model you have and the arm you have: recordings and a model in, the fewest differences between them out.

misread data → rows → search → numbers with intervals → sentences. Pure but for reading a simulator's file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from identification.arrays import FloatArray
from identification.audit.basis import Explanation
from identification.audit.columns import Geometry, SetUp
from identification.audit.comparison import LEAST_GAIN, REPORT
from identification.audit.difference import Audit, Difference
from identification.audit.given import WIDEST, GivenModel, Sizes, given_model, sizes_of
from identification.audit.held_out import Asked
from identification.audit.misread import by_its_velocity, misread
from identification.audit.numbers import found_numbers
from identification.audit.places import likeliest
from identification.audit.reading import Reading, in_degrees, read_so
from identification.audit.rows import Rows, rows_of
from identification.audit.search import Audited, search, search_turned
from identification.audit.sentences import difference_of, turned_signs
from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.errors import EstimationError
from identification.mismatch.data_faults.torque_signs import signs_of
from identification.mismatch.settings import MOST
from identification.model_file import Model
from identification.recordings.recording import Recording
from identification.robots.model import RobotModel, refuse_followers
from identification.robots.simulator_models import read_with_drives

ENOUGH = 0.7
"""Of what all parameters fitted anew explain: below it a name is not all."""
STILL_ITS_OWN = 4.0
"""A model that leaves less than so many times what it left of its own recordings holds."""
MUCH_MORE = 4.0
"""Times the squares that stay beside a load with all its numbers, above which mass and centre alone do not tell it."""


TOO_LITTLE = (
    "was made from a motion that shows too little of this one: its own uncertainty is larger than half of the torque "
    "here, so nothing can be named against it."
)


@dataclass(frozen=True, slots=True, eq=False)
class _Given:
    """source: a fit, or base parameters (p,) of a simulator's file. regressor: theirs; it has the gravity where the
    model was made. reading: how the recordings are read so far.
    """

    source: Model | FloatArray
    regressor: BaseRegressor
    model: GivenModel
    sizes: Sizes
    geometry: Geometry
    set_up: SetUp
    reading: Reading

    @classmethod
    def beside(
        cls, rows: Rows, robot: RobotModel, source: Model | FloatArray, regressor: BaseRegressor, name: str
    ) -> _Given:
        """A model beside the rows of recordings as they stand."""
        sizes = sizes_of(robot, rows)
        model = given_model(source, regressor, sizes, name)
        set_up = replace(SetUp.of(robot), delay_s=model.delay_s)
        return cls(source, regressor, model, sizes, Geometry(robot, rows), set_up, Reading.as_recorded(robot.n))

    def read(self, reading: Reading) -> _Given:
        """The same beside recordings that are read so: a torque under another joint has another size."""
        rows, model = reading.of_rows(self.geometry.rows), self.model.name
        read = _Given.beside(rows, self.geometry.robot, self.source, self.regressor, model)
        return replace(read, reading=self.reading.then(reading))


def audit(recordings: Sequence[Recording], robot: RobotModel, model: Model | Path, called: str = "") -> Audit:
    """What is different between a model and the arm of some recordings.

    model: a model.json as read, or a simulator's file. called: its name in the sentences, in place of its file's.
    Raises RecordingError for recordings that are too short or at rest, ModelFileError or RobotError for a model of
    another arm, EstimationError for a load beyond reason.
    """
    read_otherwise: list[Difference] = []
    reading = Reading.as_recorded(robot.n)
    degrees = [in_degrees(recording, robot.kinematics.revolute) for recording in recordings]
    if all(recording is not None for recording in degrees):
        recordings = [recording for recording in degrees if recording is not None]
        every, reading = tuple(range(1, robot.n + 1)), replace(reading, degrees=True)
        read_otherwise.append(misread("wrong_unit", every, 1.0, "The positions are in degrees, read as radians"))
    clock = by_its_velocity(recordings)
    if clock is not None:
        recordings, what = clock
        read_otherwise.append(what)
        reading = replace(reading, ratio=what.numbers[0].value)
    given = replace(_prepared(recordings, robot, model, called), reading=reading)
    if _too_wide(given):
        return Audit(given.model.name, "model_too_wide", (), (), (), f"{given.model.name} {TOO_LITTLE}")
    found = search(given.geometry, given.set_up, given.model, given.sizes)
    if _differs(found, given):
        found, given, moved = _as_it_shows(found, given, recordings)
        read_otherwise.extend(moved)
    return _said(found, given, read_otherwise)


def _as_it_shows(
    found: Audited, given: _Given, recordings: Sequence[Recording]
) -> tuple[Audited, _Given, list[Difference]]:
    """With columns in the places and of the signs that recordings show beside the model, and without any.

    Beside another difference, or friction that nobody knows, a model does not tell these. Taken where the model then
    makes the recordings clearly likelier, or as likely by fewer causes.
    """
    robot = given.geometry.robot
    regressor = BaseRegressor(robot, RegressorOptions(rotor_inertia=True, offset=True))
    readings: list[tuple[Reading, list[Difference], bool]] = []
    if robot.n > 1:
        asked = replace(Asked.of(given.geometry.rows, robot), gravity=given.set_up.gravity)
        for each in likeliest(asked, [None, given.model]):
            said = ". ".join(text for fault in each.reading.faults for text in fault)
            what = misread("wrong_joint_order", each.reading.joints, each.explained, said)
            readings.append((each.reading, [what], each.clear))
    taken: tuple[Audited, _Given, list[Difference]] = found, given, []
    for reading, moved, clear in readings or [(Reading.as_recorded(robot.n), [], True)]:
        instead = given.read(reading) if moved else given
        shown = signs_of(read_so(reading, recordings, robot), regressor)
        signs = shown[0] if np.all(shown == shown[0]) else np.ones(robot.n)
        if not moved and np.array_equal(signs, found.signs):
            continue
        again = search_turned(instead.geometry, instead.set_up, instead.model, instead.sizes, signs)
        fewer = _causes(again, moved) < _causes(taken[0], taken[2])
        sure = clear or (len(again.steps) <= len(taken[0].steps) and _holds(again, given.model))
        if sure and _nats(again, taken[0]) >= (0.0 if fewer else LEAST_GAIN):
            taken = again, instead, moved
    return taken


def _causes(found: Audited, moved: Sequence[Difference]) -> int:
    """How many things are different, torques that are turned for one."""
    return len(found.steps) + bool((found.signs < 0.0).any()) + len(moved)


def _holds(found: Audited, given: GivenModel) -> bool:
    """Whether the model, with what differs put in, leaves less than STILL_ITS_OWN times what it left of its own."""
    own = np.where(np.isfinite(given.left), given.left, found.now.noise.std)
    after, least = (_rms(explanation.holding(found.now.steps)) for explanation in (found.now, found.whole))
    return bool(np.all(np.minimum(least, after) < STILL_ITS_OWN * own))


def _differs(found: Audited, given: _Given) -> bool:
    """Whether anything was found, or more is left than a model that holds leaves."""
    if found.steps or (found.signs < 0.0).any() or not given.model.own:  # what a drawn model leaves is not known
        return True
    own = np.where(np.isfinite(given.model.left), given.model.left, found.first.noise.std)
    return bool(np.any(_rms(found.first) >= STILL_ITS_OWN * own))


def _rms(explanation: Explanation) -> FloatArray:
    """(n,) Nm that the differences alone leave on the rows that report."""
    counts = np.maximum(explanation.comparison.products.counts(REPORT), 1.0)
    return np.asarray(np.sqrt(explanation.reported(alone=True) / counts))


def _nats(one: Audited, other: Audited) -> float:
    """Log odds of what one search found against what another one did, by the noise of the quieter reading.

    Each beside all that the model leaves open, and whatever day it is: what another friction explains as well is no
    reason to read a recording otherwise.
    """
    noise = min(one.now.noise, other.now.noise, key=lambda each: each.loudness)
    odds = [
        replace(found.now, noise=noise).evidence() + sum(step.hypothesis.log_odds for step in found.steps)
        for found in (one, other)
    ]
    return odds[0] - odds[1]


def compared(recordings: Sequence[Recording], robot: RobotModel, model: Model | Path) -> Explanation:
    """Recordings beside a model before anything is looked for. Raises as `audit`."""
    given = _prepared(recordings, robot, model)
    return Explanation.of(given.geometry, given.set_up, given.model, given.sizes)


def _prepared(recordings: Sequence[Recording], robot: RobotModel, model: Model | Path, called: str = "") -> _Given:
    refuse_followers(robot, "compare a model with")
    source: Model | FloatArray
    if isinstance(model, Path):
        regressor, source = read_with_drives(model, robot)
        name = model.name
    else:
        regressor, source = model.regressor(robot), model
        name = Path(model.path or "the model").name
    rows = rows_of(recordings, regressor.options.coulomb_velocity)
    return _Given.beside(rows, robot, source, regressor, called or name)


def _too_wide(given: _Given) -> bool:
    """Whether a fit does not know the torque of this motion: its standard deviation against the torque's size."""
    if not given.model.own:
        return False
    used, torque = given.geometry.rows.used, given.geometry.rows.torque
    for gravity in (given.set_up.gravity, np.asarray(given.regressor.robot.gravity)):
        columns = given.geometry.columns(gravity)
        spread = np.einsum("rja,ab,rjb->rj", columns, given.model.covariance_on(1.0), columns, optimize=True)
        expected = columns @ given.model.values
        # A torque that is far smaller than what is expected does not make the model uncertain.
        size = max(float(np.where(used, each**2, 0.0).sum()) for each in (torque, expected))
        if float(np.where(used, spread, 0.0).sum()) <= MOST**2 * size:
            return False
    return True


def _said(found: Audited, given: _Given, read_otherwise: Sequence[Difference]) -> Audit:
    model, first, now = given.model, found.first, found.now
    noise = now.noise
    before, after, least = (_rms(explanation.holding(now.steps)) for explanation in (first, now, found.whole))
    numbers = found_numbers(now)
    if float(np.sum((after / noise.std) ** 2)) > MUCH_MORE * float(np.sum((least / noise.std) ** 2)):
        # Far from the link's origin a load's inertia is most of what it does: without it, mass and centre bend to it.
        whole = {each.hypothesis.place: each for each in found_numbers(found.whole)}
        numbers, after = [whole[each.hypothesis.place] for each in numbers], least
    for each in numbers:
        if each.hypothesis.effect == "payload" and abs(each.values[0]) > WIDEST * float(given.sizes.mass.mean()):
            raise EstimationError(
                f"{model.name} and the recording differ by {each.values[0]:.0f} kg on one link, which no such arm "
                "carries: they are of different arms, or the torque is not in Nm."
            )
    differences = [
        difference_of(step, each, given.set_up, now.comparison.set_up, model.name, given.geometry.robot)
        for step, each in zip(found.steps, numbers, strict=True)
    ]
    # One that was turned into the data cannot be taken out of them.
    gone = [
        step.hypothesis
        for step, item in zip(found.steps, differences, strict=True)
        if item.may_be_none and not step.hypothesis.bends
    ]
    if gone:
        return _said(found.without(gone), given, read_otherwise)
    reading = given.reading.then(Reading.with_signs(found.signs))
    for clock in (item for item in differences if item.effect == "wrong_time_base"):
        reading = replace(reading, ratio=reading.ratio * clock.numbers[0].value)
    if (found.signs < 0.0).any():
        share = 1.0 - float(np.sum((after / noise.std) ** 2) / np.sum((before / noise.std) ** 2))
        differences.insert(0, turned_signs(found.signs, share, float("nan"), model.name))
    differences[:0] = read_otherwise
    holds = _holds(found, model)
    verdict = _verdict(differences, before, after, noise.std, holds)
    unit = given.geometry.robot.torque_unit
    return Audit(model.name, verdict, tuple(differences), tuple(before.tolist()), tuple(after.tolist()),
                 _sentence(verdict, differences, (before, after, noise.std), unit, model, holds), holds,
                 reading)  # fmt: skip


def _verdict(differences: list[Difference], before: FloatArray, after: FloatArray, noise: FloatArray,
             holds: bool) -> str:  # fmt: skip
    if not differences:
        return "nothing" if holds else "unexplained"
    if holds and np.array_equal(before, after):
        return "named"
    weight = 1.0 / noise**2
    possible = float(weight @ np.maximum(before**2 - noise**2, 0.0))
    explained = float(weight @ (before**2 - after**2))
    return "named" if explained >= ENOUGH * possible else "partly"


def _sentence(
    verdict: str, differences: list[Difference], rms: tuple[FloatArray, ...], unit: str, model: GivenModel, holds: bool
) -> str:
    """rms: what the model leaves without and with the differences, and all parameters fitted anew; each (n,) Nm."""
    left, stays, least = (f"{float(np.sqrt(np.sum(values**2))):.3g} {unit}" for values in rms)
    # What a file says of friction is not believed here; the table of a leaderboard has it as the file states it.
    how = "all joints together" if model.own else "all joints together, friction and offsets fitted"
    match verdict:
        case "nothing" if model.own:
            return f"{model.name} holds: it leaves {left} RMS ({how}), and nothing in the set-up differs."
        case "nothing":
            # Of a file nobody knows what it leaves of a sound recording: it can only be as good as any rigid body.
            return (
                f"{model.name} holds as well as any rigid body: it leaves {left} RMS ({how}), all parameters fitted "
                f"anew {least}. No one thing in the set-up is seen to differ."
            )
        case "unexplained":
            return f"{model.name} leaves {left} RMS ({how}), and no one thing in the set-up explains it."
    found = " ".join(item.sentence for item in differences)
    rest = "" if verdict == "named" and holds else " That is not all that differs."
    if left == stays:
        return f"{found} With that put right {stays} RMS stay.{rest}"
    return f"{found} {left} RMS before, {stays} after, on rows not used for it.{rest}"
