"""What is no claim, however well it fits. Truth: numbers written here, closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pinocchio
import pytest

from identification.mismatch.changes.between_periods import Change, beside_flagged_rows, find_between_periods
from identification.mismatch.changes.contrasts import Contrasts
from identification.mismatch.changes.lasting import LONGEST_TIME, find_thermal
from identification.mismatch.effects import EFFECTS, effect_named
from identification.mismatch.effects.base import Estimate, Place
from identification.mismatch.effects.thermal_friction import ThermalFriction
from identification.mismatch.evidence import Evidence
from identification.mismatch.heldout import Residuals, worsened
from identification.mismatch.names.examination import Check, Examination, Rows
from identification.mismatch.names.objections import Objection, recurring, untenable, useless, without_objection
from identification.mismatch.problem import build_problem
from identification.mismatch.reduction import build_evidence
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member
from identification.mismatch.search.search import SearchResult
from identification.mismatch.search.trial import fitted
from identification.mismatch.settings import DiagnosisSettings
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Finding
from identification.robots import RobotModel
from tests.identification.mismatch.plant import PERIOD_S, SAMPLES, on_joint, record


def residuals(rows: np.ndarray, noise: float = 1.0) -> Residuals:
    ones = np.full(rows.shape, noise)
    return Residuals(rows, ones, ones, np.ones(rows.shape, dtype=bool), rows.shape[1], np.zeros((*rows.shape, 0)))


def test_a_change_that_only_adds_its_own_torque_makes_a_joint_worse() -> None:
    random = np.random.default_rng(1)
    noise = random.normal(size=(7, 400))
    change = np.zeros((7, 400))
    change[1] = 0.5 * np.sin(np.arange(400))
    # True: without it its torque stays in the rows. False: with it the torque was put there.
    assert not worsened(residuals(noise + change), residuals(noise)).any()
    assert worsened(residuals(noise), residuals(noise + change)).tolist() == [False, True, *[False] * 5]


def test_noise_alone_makes_no_joint_worse_in_a_hundred_true_changes() -> None:
    random = np.random.default_rng(2)
    refused = 0
    for _ in range(100):
        noise, change = random.normal(size=(7, 200)), random.normal(scale=0.15, size=(7, 200))
        refused += int(worsened(residuals(noise + change), residuals(noise)).any())
    assert refused <= 4  # seven joints, one in a thousand each


def test_a_rise_inside_its_own_noise_is_none() -> None:
    """Half of the change is true and half is not: the squares of a joint stay as they were, up to the noise."""
    random = np.random.default_rng(3)
    refused = 0
    for _ in range(100):
        noise, change = random.normal(size=(1, 200)), random.normal(scale=1.5, size=(1, 200))
        refused += int(worsened(residuals(noise + 0.5 * change), residuals(noise - 0.5 * change)).any())
    assert refused <= 28  # one in six is beyond one deviation, half are above zero


def examined(evidence: Evidence, name: str, joint: int, shape: dict[str, float] | None = None) -> list[str]:
    """Why an effect that the search had settled on may not stand."""
    library = Library(EFFECTS, (evidence,))
    problem, settings = build_problem((evidence,)), DiagnosisSettings()
    effect = effect_named(name)
    shapes = library.grid(effect, Place(joint=joint)) if shape is None else [tuple(shape.items())]
    rows = library.rows(effect, Place(joint=joint), shapes[0])
    assert rows is not None
    trial = fitted(problem, [Member(rows)], settings)
    exam = Examination(
        problem, cast(SearchResult, None), Rows((evidence,), (evidence.torque,), library), None, settings
    )
    return [item.why for item in untenable(exam, trial)]


@pytest.mark.parametrize(("stiffness", "said"), [(0.5, ""), (-0.5, "no machine has"), (0.002, "may as well be zero")])
def test_a_spring_stands_with_a_positive_size_that_is_clear_of_zero(
    iiwa14: RobotModel, table3: PhysicalParameters, iiwa14_base: object, stiffness: float, said: str
) -> None:
    def spring(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return on_joint(6, stiffness * q[:, 5])

    recording = record(iiwa14, table3, spring, periods=4, seed=11)
    (evidence,) = build_evidence(recording, iiwa14, iiwa14_base)  # type: ignore[arg-type]
    found = examined(evidence, "cable_spring", 6)
    assert [said in why for why in found] == ([True] if said else [])


class _Settled:
    """What sets of members, by their names, leave of two joints of white noise of 1 Nm.

    Each set has (size of a torque on joint 1 that has nothing to do with it, RMS of joint 2).
    """

    def __init__(self, left: dict[tuple[str, ...], tuple[float, float]]) -> None:
        self.left = left

    def __call__(self, members: Sequence[Any]) -> Check:
        noise, other = np.random.default_rng(4).normal(size=(2, 2, 200))
        added, rms = self.left[tuple(item.effect.name for item in members)]
        rows = np.stack([noise[0] + added * other[0], rms * noise[1]])
        extension = SimpleNamespace(coefficients=[np.ones(1) for _ in members])
        return cast(Check, SimpleNamespace(heldout_after=residuals(rows), extension=extension))


def _member(name: str, joint: int) -> Any:
    rows = SimpleNamespace(joints=(joint - 1,), rows=np.ones((1, 200, 1)), coefficients=1)
    return SimpleNamespace(effect=SimpleNamespace(name=name), place=Place(joint=joint), rows=rows)


def said_of(settled: _Settled, names: Sequence[str], *, noise_is_measured: bool) -> list[tuple[int, str]]:
    exam = cast(Examination, SimpleNamespace(problem=SimpleNamespace(n=2, noise_is_measured=noise_is_measured)))
    trial = cast(Any, SimpleNamespace(members=tuple(_member(name, 2) for name in names)))
    return [(item.index, item.why) for item in useless(exam, settled, trial)]


@pytest.mark.parametrize(("harm", "objected"), [(1.2, [1]), (0.1, [])])
def test_a_name_that_makes_another_joint_worse_beyond_its_noise_is_not_claimed(
    harm: float, objected: list[int]
) -> None:
    """Payload takes joint 2 from 5 to 1 Nm; cable_spring takes it from 1.5 to 1 and adds `harm` Nm to joint 1."""
    both = ("payload", "cable_spring")
    settled = _Settled({both: (harm, 1.0), both[:1]: (0.0, 1.5), both[1:]: (harm, 5.0)})
    found = said_of(settled, both, noise_is_measured=True)
    assert [index for index, _ in found] == objected
    assert all(why.startswith("makes joint 1 worse") for _, why in found)


@pytest.mark.parametrize(("without_it", "claimed"), [(5.0, True), (1.0, False)])
def test_without_a_measured_noise_a_name_that_foretells_nothing_is_not_claimed(
    without_it: float, claimed: bool
) -> None:
    settled = _Settled({("cable_spring",): (0.0, 1.0), (): (0.0, without_it)})
    assert not said_of(settled, ["cable_spring"], noise_is_measured=True)
    found = said_of(settled, ["cable_spring"], noise_is_measured=False)
    assert [why for _, why in found] == ([] if claimed else ["does not foretell data that were not fitted"])


class _Set:
    """A trial of which only the members are asked."""

    def __init__(self, members: Sequence[Any]) -> None:
        self.members = tuple(members)


@pytest.mark.parametrize("second_falls", [True, False])
def test_what_is_too_weak_for_a_name_is_there_though_another_name_took_its_place_and_fell(
    monkeypatch: pytest.MonkeyPatch, second_falls: bool
) -> None:
    first, second = _member("cable_spring", 1), _member("torque_offset", 1)

    def under_another_name(exam: Any, trial: _Set, index: int, fallen: set[tuple[str, Place]]) -> _Set | None:
        return None if (second.effect.name, second.place) in fallen else _Set([second])

    def rule(name: str, *, there: bool) -> Any:
        return lambda trial: [
            Objection(i, 0.0, "", there) for i, m in enumerate(trial.members) if m.effect.name == name
        ]

    place = "identification.mismatch.names.objections"
    monkeypatch.setattr(f"{place}._under_another_name", under_another_name)
    monkeypatch.setattr(f"{place}.fitted", lambda _problem, members, _settings: _Set(members))
    exam = cast(Examination, SimpleNamespace(problem=None, settings=None, unseen=None))
    rules = [rule("cable_spring", there=True), *([rule("torque_offset", there=False)] if second_falls else [])]
    trial, _, there = without_objection(exam, cast(Any, _Set([first])), rules)
    assert trial.members == (() if second_falls else (second,))
    assert there == ((first,) if second_falls else ())


@pytest.mark.parametrize(
    ("sizes", "deviations", "certain"),
    [
        ((0.1, 0.001), (0.01, 0.01), 10.0),
        ((0.001, 0.1), (0.01, 0.01), 10.0),
        ((0.01, 0.01), (0.01, 0.01), np.sqrt(2.0)),
        ((0.1, 0.5), (0.01, 1.0), 10.0),
        ((0.1, 0.0), (0.01, 1e6), 10.0),
    ],
)
def test_a_crosstalk_of_one_bending_moment_is_certain_whatever_is_known_of_the_other(
    sizes: tuple[float, float], deviations: tuple[float, float], certain: float
) -> None:
    of_both = np.diag(np.square(deviations))
    estimate = Estimate(Place(joint=3), {}, np.array(sizes), of_both)
    assert effect_named("bending_crosstalk").certainty(estimate) == pytest.approx(certain, rel=0.02)


def push(start_s: float) -> Change:
    shape = {"start_s": start_s, "duration_s": 0.3}
    effect = effect_named("external_contact")
    return cast(Change, SimpleNamespace(effect=effect, estimate=SimpleNamespace(shape=shape)))


def test_a_push_that_another_recording_has_at_the_same_moment_is_none() -> None:
    first, second, elsewhere = push(10.0), push(40.0), push(10.2)
    assert recurring([first, second], [first, second, elsewhere]) == [first]


def test_no_push_is_looked_for_beside_rows_that_the_import_left_out(
    iiwa14: RobotModel, table3: PhysicalParameters, iiwa14_base: object
) -> None:
    """A jolt of 30 N on the flange at 33 s; the import has left out its eight wildest rows."""
    recording = record(iiwa14, table3, periods=6)
    since = recording.time - 33.0
    model = iiwa14.pinocchio_model
    data = model.createData()
    jolt = np.zeros_like(recording.torque)
    for row in np.flatnonzero(np.abs(since) < 1.0):
        pinocchio.computeJointJacobians(model, data, recording.position[row])
        jacobian = pinocchio.getJointJacobian(model, data, 7, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        jolt[row] = np.exp(-np.abs(since[row]) / 0.08) * jacobian[:3].T @ np.array([20.0, -20.0, 10.0])
    jolted = replace(recording, torque=recording.torque + jolt)
    (evidence,) = build_evidence(jolted, iiwa14, iiwa14_base)  # type: ignore[arg-type]
    assert {change.effect.name for change in find_between_periods([evidence], EFFECTS)} == {"external_contact"}

    first = int(33.0 * SAMPLES / PERIOD_S)
    keep = np.ones(recording.samples, dtype=bool)
    keep[first : first + 8] = False
    told = Finding("garbled_rows", first + 1, first + 8, 8, "each of the 8 rows stands alone")
    report = replace(jolted.report, rows_kept=int(keep.sum()), findings=(told,))
    known = replace(jolted.rows(keep), report=report)
    ((low, high),) = beside_flagged_rows(known)
    assert low < 33.0 < high
    (evidence,) = build_evidence(known, iiwa14, iiwa14_base)  # type: ignore[arg-type]
    assert not find_between_periods([evidence], EFFECTS)


def test_friction_that_fades_for_far_longer_than_the_recording_has_no_time_constant_beyond_it(
    iiwa14: RobotModel, table3: PhysicalParameters, iiwa14_base: object
) -> None:
    """An excess that falls in a straight line is an exponential of any length."""
    recording = record(iiwa14, table3, periods=6)
    velocity = np.gradient(recording.position[:, 0], recording.time)
    fading = 0.5 * (1.0 - recording.time / 1200.0) * np.sign(velocity)
    torque = recording.torque.copy()
    torque[:, 0] += fading * 4.0
    (evidence,) = build_evidence(replace(recording, torque=torque), iiwa14, iiwa14_base)  # type: ignore[arg-type]
    found = find_thermal(Contrasts(evidence), ThermalFriction(), ())
    assert found is not None
    assert found.shape["time_constant_s"] <= LONGEST_TIME * 6.0 * PERIOD_S
