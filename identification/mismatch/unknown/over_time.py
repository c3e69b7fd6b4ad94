"""Whether what changes from period to period has earned its name against the classes of its joints.

The contrasts of a recording, weighted along the course of a change (Σ w_k z_k over the periods), are rows of the torque
that changed. Beside the name stand the classes of dependence with the same course, by the same evidence as in the mean:
a gain that drifts is no drift of the zero and no load that was taken off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.changes.between_periods import Change, find_between_periods
from identification.mismatch.changes.contrasts import Contrasts
from identification.mismatch.effects import EFFECTS
from identification.mismatch.effects.base import Place
from identification.mismatch.effects.enveloped import EnvelopedEffect
from identification.mismatch.effects.thermal_friction import ThermalFriction
from identification.mismatch.effects.torque_sensor_drift import TorqueSensorDrift
from identification.mismatch.evidence import Evidence
from identification.mismatch.prepared import Prepared, without_changes
from identification.mismatch.problem import Problem
from identification.mismatch.settings import FADE, LEAST_SHOWN, SPEAK
from identification.mismatch.unknown.claims import ClassClaim
from identification.mismatch.unknown.classes import CLASSES, Basis
from identification.mismatch.unknown.evidence import products
from identification.mismatch.unknown.inputs import Inputs, Ranges
from identification.mismatch.unknown.named import Named, shown_on, standings
from identification.mismatch.unknown.rows import WIDE_BANDS_HZ, JointRows, Rows, functions_of, usual_groups

ASKED = (
    "constant", "own_position", "own_position_by_direction", "own_velocity", "own_load", "own_load_by_direction",
    "own_load_by_position", "path_memory",
)  # fmt: skip
"""Classes that a change over time may have: functions of the joint's own state."""
KNOWN = 1e4
"""Rows that the noise of the contrasts is worth: as good as known, as they are what it was measured on."""


@dataclass(frozen=True, slots=True)
class Refused:
    """A change that is not named: what it looked like, on which joint (from 1), which classes take its place.

    rms_nm, interval_nm: of all that changes along its course on the joint, over the recording. nats: of the class.
    weak: it is there and too weak to be told from a neighbour; then nats are its own.
    """

    effect: str
    joint: int | None
    rivals: tuple[str, ...]
    rms_nm: float
    interval_nm: tuple[float, float]
    nats: float
    weak: bool = False

    @property
    def sentence(self) -> str:
        """For the notes."""
        name = self.effect.replace("_", " ") + ("" if self.joint is None else f" of joint {self.joint}")
        if self.weak:
            why = "is too weak here to be told from other torque that changes over the recording"
        else:
            why = f"describes part of a torque that changes over the recording and depends on {_words(self.rivals)}"
        return f"{name} {why}: it is not claimed"

    @property
    def claim(self) -> ClassClaim | None:
        """What is said instead; None where it is on no joint in particular or no class stands clear."""
        if self.joint is None or not (self.rivals or self.weak):
            return None
        low, high = self.interval_nm
        depends = f" and depends on {_words(self.rivals)}" if self.rivals else ""
        sentence = (
            f"Joint {self.joint}: a torque that changes over the recording{depends}, {self.rms_nm:.2g} Nm RMS "
            f"({low:.2g} to {high:.2g})."
        )
        size = self.rms_nm, self.interval_nm
        return ClassClaim("time", self.joint, *size, self.nats, np.zeros(0), (), (), sentence, None)


def changing(refused: Sequence[Refused]) -> list[ClassClaim]:
    """The strongest class of each joint whose torque changes over the recording without a name."""
    found: dict[int, ClassClaim] = {}
    for claim in filter(None, (item.claim for item in refused)):
        found[claim.joint] = max(found.get(claim.joint, claim), claim, key=lambda item: item.significance)
    return list(found.values())


def least_of_drifts(refused: Sequence[Refused]) -> dict[int | None, float]:
    """λ that mean and contrasts together have to show of a drift, by joint (from 1), where the contrasts refused one.

    What was too weak in the contrasts may show enough in the mean; what is another change is no drift of any size.
    """
    weak = {item.joint: LEAST_SHOWN for item in refused if item.weak}
    return weak | {item.joint: math.inf for item in refused if not item.weak}


def still_refused(refused: Sequence[Refused], found: Sequence[Change]) -> tuple[Refused, ...]:
    """Those that are not among changes that the mean has proved since."""
    names = {(item.effect.name, item.estimate.place.joint) for item in found}
    return tuple(item for item in refused if (item.effect, item.joint) not in names)


def _words(classes: Sequence[str]) -> str:
    return " and ".join(name.replace("_", " ") for name in classes) or "nothing that is known"


def earned_over_time(prepared: Prepared) -> tuple[Prepared, tuple[Refused, ...]]:
    """The changes that are earned; what they leave is looked through again without the names that are not.

    A joint whose torque changes as one class does has no other lasting change: neither a drift nor a warm-up is asked.
    """
    refused: list[Refused] = []
    for number, evidence in enumerate(prepared.evidences):
        banned: set[tuple[str, Place]] = set()
        asked = _Recording.of(evidence) if any(item.evidence == number for item in prepared.changes) else None
        while asked is not None:
            own = [item for item in prepared.changes if item.evidence == number]
            # A push acts in a moment: there is no function of the state that it could be.
            lasting = [item for item in own if "start_s" not in item.estimate.shape]
            failing = [
                (item.estimate.place, found) for item in lasting if (found := asked.refusal(item, own)) is not None
            ]
            if not failing:
                break
            for place, found in failing:
                refused.append(found)
                names = {found.effect} if place.joint is None else {TorqueSensorDrift.name, ThermalFriction.name}
                banned.update((name, place) for name in names)
            again = find_between_periods([evidence], EFFECTS, banned=frozenset(banned))
            prepared = without_changes(prepared, number, again)
    return prepared, tuple(refused)


@dataclass(frozen=True, slots=True, eq=False)
class _Recording:
    """The contrasts of one recording, and the functions of its joints (from 0) as far as they were asked for."""

    contrasts: Contrasts
    inputs: Inputs
    known: dict[int, list[tuple[Basis, FloatArray]]] = field(default_factory=dict)

    @classmethod
    def of(cls, evidence: Evidence) -> _Recording:
        ranges = Ranges.of([evidence.motion])
        return cls(Contrasts(evidence), Inputs(evidence.motion, ranges, 2.0 * FADE))

    def functions(self, joint: int) -> list[tuple[Basis, FloatArray]]:
        """Whitened columns (R, m) of each group of the classes that are asked."""
        if joint not in self.known:
            asked = [place for place in usual_groups(measured=True) if CLASSES[place[0]].name in ASKED]
            found = functions_of([self.contrasts.evidence], [self.inputs], joint, asked)
            self.known[joint] = [
                (basis, self.contrasts.whiten_repeated(rows[:, None], [joint])[:, 0]) for basis, rows in found
            ]
        return self.known[joint]

    def refusal(self, change: Change, own: Sequence[Change]) -> Refused | None:
        """Of one change beside all others of its recording, each free; None for one that is earned.

        What changes along one course is one thing: a name that leaves a class on its course is a part of it.
        """
        contrasts = self.contrasts
        course = _course(contrasts.evidence, change)
        if course is None:
            return None
        problem = self.problem(np.tensordot(course, contrasts.z, axes=1))
        every = (change, *(item for item in own if item is not change))
        names = [_named(problem, contrasts, course, item) for item in every]
        rows = self.rows(problem, names[0].joints)
        elsewhere = [()] * rows.problem.n
        standing = standings(rows, [name for name in names if np.any(name.columns)], [0], elsewhere)[0]
        beside = {name: loss for name, loss in standing.beside.items() if loss >= SPEAK}
        if standing.earned and not beside:
            return None
        joint = change.estimate.place.joint
        rms, interval = (0.0, (0.0, 0.0)) if joint is None else self.size(rows, joint - 1)
        if standing.weak and not beside:
            return Refused(change.effect.name, joint, (), rms, interval, standing.odds, weak=True)
        rivals = tuple(beside) or standing.rivals
        return Refused(change.effect.name, joint, rivals, rms, interval, max(beside.values(), default=0.0))

    def size(self, rows: Rows, joint: int) -> tuple[float, tuple[float, float]]:
        """RMS in Nm over the recording of what changes along a course on a joint (from 0), and its 95 % interval."""
        count = self.contrasts.periods * rows.samples[0]
        noise = np.where(rows.problem.weight[joint] > 0.0, rows.problem.noise[joint], 0.0) ** 2
        square = float(rows.problem.residual.reshape(rows.problem.n, -1)[joint] ** 2 @ noise)
        excess = square - float(noise.sum())
        spread = np.sqrt(2.0 * float(noise @ noise) + 4.0 * float(noise.max()) * max(excess, 0.0))
        rms, low, high = (float(np.sqrt(max(excess + sign * 1.96 * spread, 0.0) / count)) for sign in (0.0, -1.0, 1.0))
        return rms, (low, high)

    def problem(self, whitened: FloatArray) -> Problem:
        """Rows (R, n) along one course; base parameters do not change."""
        evidence, weight = self.contrasts.evidence, self.contrasts.weight.T
        n, size = weight.shape
        noise = np.where(weight > 0.0, 1.0 / np.where(weight > 0.0, weight, 1.0), 1.0)
        nothing, torque = np.zeros(size, dtype=np.int64), whitened.T.ravel()
        return Problem(
            n=n, weight=weight, noise=noise, freedom=evidence.noise_freedom.T, band=nothing, evidence=nothing,
            frequency=evidence.frequency, torque=torque, nominal=np.zeros((n, size, 0)),
            basis=np.zeros((n * size, 0)), residual=torque,
        )  # fmt: skip

    def rows(self, problem: Problem, joints: Sequence[int]) -> Rows:
        """The rows of a course, with the classes of some joints."""
        evidence, weight, n = self.contrasts.evidence, problem.weight, problem.n
        whitened = problem.torque.reshape(weight.shape)
        asked = np.isin(np.arange(n), list(joints))
        parts = []
        for joint in range(n):
            own = self.functions(joint) if asked[joint] else []
            group = np.repeat(np.arange(len(own)), [rows.shape[1] for _, rows in own]).astype(np.int64)
            columns = np.concatenate([*(rows for _, rows in own), whitened[joint, :, None]], axis=1)
            shown = tuple(np.eye(rows.shape[1]) for _, rows in own)
            parts.append(JointRows(columns, tuple(basis for basis, _ in own), group, shown))
        band = np.searchsorted(WIDE_BANDS_HZ, evidence.frequency)
        bands = len(WIDE_BANDS_HZ) + 1
        count = np.stack([np.bincount(band, weights=row > 0.0, minlength=bands) for row in weight])
        return Rows(
            problem=problem,
            evidences=(evidence,),
            fitted=self.inputs.ranges,
            inputs=(self.inputs,),
            joints=tuple(parts),
            part=problem.evidence,
            band=band,
            folds=1,
            prior=np.zeros(0),
            cell=band,
            grams=tuple(products(item.whitened, item.whitened, band, (1, bands)) for item in parts),
            count=count.reshape(n, 1, bands).astype(np.float64),
            misfit=(np.where(weight > 0.0, whitened * problem.noise, 0.0) ** 2).sum(axis=1) / evidence.samples,
            asked=asked,
            samples=(evidence.samples, 0),
            noise_rows=KNOWN,
            noise_odds=0.0,
        )


def _course(evidence: Evidence, change: Change) -> FloatArray | None:
    """(K,) weights of the periods, mean zero and length one, that a change's envelope has."""
    assert isinstance(change.effect, EnvelopedEffect)
    weight = change.effect.envelope(evidence.motion, change.estimate.shape).mean(axis=1)
    weight = weight - weight.mean()
    length = float(np.linalg.norm(weight))
    return weight / length if length > 1e-9 else None


def _named(problem: Problem, contrasts: Contrasts, course: FloatArray, change: Change) -> Named:
    """A change's columns along a course, in Nm. problem: the rows of that."""
    assert isinstance(change.effect, EnvelopedEffect)
    joints, rows = contrasts.rows(change.effect, change.estimate.place, change.estimate.shape)
    white = np.tensordot(course, contrasts.whiten(rows, joints), axes=1)
    used = np.flatnonzero(change.estimate.coefficients)
    weight = contrasts.weight.T[list(joints)][..., None]
    columns = np.zeros((contrasts.evidence.n, white.shape[0], used.size))
    columns[list(joints)] = np.where(
        weight > 0.0, white.transpose(1, 0, 2)[..., used] / np.where(weight > 0.0, weight, 1.0), 0.0
    )
    size = change.estimate.coefficients[used]
    return Named(change.effect.name, shown_on(problem, columns @ size), columns, size, 0.0)
