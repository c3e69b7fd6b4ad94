"""Claims about names against classes, on plants computed by Pinocchio with torque written here."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.mismatch.evidence import Evidence
from identification.mismatch.prepared import Prepared, prepare
from identification.mismatch.settings import DiagnosisSettings
from identification.mismatch.unknown import named as names_beside
from identification.mismatch.unknown.classes import CLASSES
from identification.mismatch.unknown.dependence import find_dependence
from identification.mismatch.unknown.named import Named, Standing, held_beside, shown_on, standings
from identification.mismatch.unknown.rows import Rows, build_rows
from identification.mismatch.unknown.selection import Selection
from identification.physical_parameters import PhysicalParameters
from identification.recordings import read_recording
from identification.robots import RobotModel, load_robot
from tests.identification.mismatch.plant import on_joint, record
from tests.reference import recording_file

JOINT = 5
Form = Callable[[np.ndarray, np.ndarray], np.ndarray]


def slack(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """A hose that pulls on joint 5 beyond 0.4 rad either way."""
    del dq
    return np.sign(q[:, JOINT - 1]) * np.maximum(np.abs(q[:, JOINT - 1]) - 0.4, 0.0)


def spring(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """A straight spring on joint 5."""
    del dq
    return np.asarray(q[:, JOINT - 1])


def stribeck(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """Friction of joint 5 that falls off with speed."""
    del q
    return np.asarray(np.exp(-((dq[:, JOINT - 1] / 0.1) ** 2)) * np.sign(dq[:, JOINT - 1]))


@pytest.fixture(scope="module")
def prepared(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> Callable[[dict[Form, float]], tuple[Prepared, Prepared]]:
    def of(hidden: dict[Form, float], elsewhere: dict[Form, float] | None = None) -> tuple[Prepared, Prepared]:
        def torque(forms: dict[Form, float]) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
            return lambda q, dq, _: on_joint(
                JOINT, sum((size * form(q, dq) for form, size in forms.items()), np.zeros(len(q)))
            )

        there = hidden if elsewhere is None else elsewhere
        recordings = (
            record(iiwa14, table3, torque(hidden), motion=9),
            record(iiwa14, table3, torque(there), periods=4, motion=3, seed=2),
        )
        first, second = (
            prepare([recording], iiwa14, iiwa14_base, DiagnosisSettings(), None) for recording in recordings
        )
        return first, second

    return of


def asked(
    pair: tuple[Prepared, Prepared], forms: dict[Form, float], effect: str = "", joints: frozenset[int] = frozenset()
) -> list[Standing]:
    """How names of these forms, found of these sizes, stand against the classes of the rows, asked on these joints."""
    rows = build_rows(*pair, joints)
    names = [_named(rows, form, size, effect) for form, size in forms.items()]
    return list(standings(rows, names, range(len(names)), [()] * rows.problem.n).values())


def _named(rows: Rows, form: Form, size: float, effect: str) -> Named:
    columns = np.concatenate([_projected(item, form) for item in rows.evidences], axis=1)
    return Named(effect, (JOINT - 1,), columns, np.array([size]), 0.0)


def _projected(evidence: Evidence, form: Form) -> np.ndarray:
    motion = evidence.motion
    torque = on_joint(JOINT, form(motion.position, motion.velocity))
    return evidence.project(torque[:, :, None]).transpose(1, 0, 2)


def test_a_wrong_form_of_the_right_dependence_is_not_earned_and_the_right_one_is(prepared: Callable) -> None:
    pair = prepared({slack: 0.6})
    (wrong,), (right,) = asked(pair, {spring: 0.3}), asked(pair, {slack: 0.6})
    assert not wrong.earned
    assert "own_position" in wrong.rivals
    assert right.earned
    assert right.odds > 3.0
    assert "own_position" in right.rivals
    assert right.kept == 0.0


def test_the_odds_of_a_name_do_not_depend_on_the_units_of_its_size(prepared: Callable) -> None:
    """A compliance of 1e-6 rad/Nm stood as well where it had been left out: its odds were those of nothing."""

    def in_other_units(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        return 1e8 * spring(q, dq)

    pair = prepared({spring: 0.6})
    (plain,), (scaled,) = asked(pair, {spring: 0.6}), asked(pair, {in_other_units: 6e-9})
    assert scaled.earned
    assert scaled.odds == pytest.approx(plain.odds, abs=0.1)


def test_right_names_stand_beside_each_other_on_one_joint(prepared: Callable) -> None:
    forms = {spring: 0.4, stribeck: 0.3}
    assert [item.earned for item in asked(prepared(forms), forms)] == [True, True]


def test_the_mean_of_a_function_of_no_known_form_is_no_offset(prepared: Callable) -> None:
    def constant(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        del dq
        return np.ones(len(q))

    def product(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Of the positions of two other joints, with a mean."""
        del dq
        return np.cos(1.5 * q[:, 1] + q[:, 3])

    (alone,) = asked(prepared({constant: 0.3}), {constant: 0.3}, "torque_offset")
    (beside,) = asked(prepared({product: 0.3}), {constant: 0.2}, "torque_offset")
    assert alone.earned
    assert not beside.earned


def test_a_size_that_another_motion_does_not_have_is_not_earned(prepared: Callable) -> None:
    (standing,) = asked(prepared({spring: 0.6}, {spring: 0.2}), {spring: 0.5})
    assert standing.agree < 1e-3
    assert not standing.earned


def test_nothing_is_earned_where_nothing_is(prepared: Callable) -> None:
    (standing,) = asked(prepared({}), {spring: 0.02})
    assert not standing.earned


def test_a_name_weighs_as_much_as_what_no_name_takes_beside_it(prepared: Callable) -> None:
    """What functions of no known form fail to describe may have any form."""
    (alone,) = asked(prepared({stribeck: 0.06}), {stribeck: 0.06})
    (beside,) = asked(prepared({stribeck: 0.06, slack: 0.6}), {stribeck: 0.06})
    assert alone.earned
    assert beside.odds > 3.0
    assert "own_position" in beside.beside
    assert not beside.earned


def test_a_torque_of_which_a_tenth_cannot_be_seen_has_no_name(prepared: Callable) -> None:
    """What shares nine tenths of it would fit as well."""
    (weak,), (clear,) = (asked(prepared({spring: size}), {spring: size}) for size in (0.008, 0.012))
    assert weak.odds > 3.0
    assert weak.shown < 60.0 < clear.shown
    assert not weak.earned
    assert clear.earned


def test_a_name_stands_against_classes_also_where_a_joint_holds_hardly_more_than_its_noise(prepared: Callable) -> None:
    pair = prepared({stribeck: 0.012})
    silent, heard = find_dependence(*pair), find_dependence(*pair, {JOINT - 1})
    assert not silent.held
    assert [(item.joint, CLASSES[item.number].name) for item in heard.held] == [(JOINT - 1, "own_velocity")]
    against_nothing, against_classes = (
        asked(pair, {stribeck: 0.012}, joints=joints)[0] for joints in (frozenset[int](), frozenset({JOINT - 1}))
    )
    assert not against_nothing.rivals
    assert "own_velocity" in against_classes.rivals
    assert against_classes.odds < against_nothing.odds / 2.0


@pytest.mark.parametrize("on_its_joint_too", [False, True])
def test_what_base_parameters_take_up_of_a_name_hides_neither_the_rest_of_it_nor_the_joint_where_that_is(
    on_its_joint_too: bool, prepared: Callable
) -> None:
    """A zero offset tilts the weight of the arm: most of its torque looks like other parameters, on other joints than
    the one where the rest of it shows. Here that is a spring on joint 5, beside parameters of joint 2 a hundred times
    as large, of these or of those alone that act on joint 5 as well: there base parameters take them up only together
    with what they are on joint 2.
    """
    rows = build_rows(*prepared({spring: 0.02}), {JOINT - 1})
    plain = _named(rows, spring, 0.02, "")
    columns = plain.columns.copy()
    for column in np.moveaxis(rows.problem.nominal, 2, 0):
        if np.any(column[1]) and np.any(column[JOINT - 1]) == on_its_joint_too:
            columns[..., 0] += 100.0 * column * np.linalg.norm(plain.columns) / np.linalg.norm(column)
    joints = shown_on(rows.problem, columns @ plain.size)
    assert JOINT - 1 in joints
    both = Named("", joints, columns, plain.size, 0.0)
    alone, beside = (standings(rows, [name], [0], [()] * rows.problem.n)[0] for name in (plain, both))
    assert beside.shown == pytest.approx(alone.shown, rel=0.1)
    assert alone.earned
    assert beside.earned


def test_without_periods_a_name_takes_only_the_class_that_it_is_missed_less_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beside a name without any torque each class of the EMPS stands, however little it weighs; beside the torque of
    one of them, the other.
    """
    robot = load_robot(recording_file("emps.urdf"))
    fitted = prepare(
        [read_recording(recording_file("emps_a.npz"))], robot, BaseRegressor(robot), DiagnosisSettings(), None
    )
    rows = build_rows(fitted, None)
    both = ("own_velocity", "torque_dynamics")
    chosen = [[place for place, item in enumerate(rows.joints[0].bases) if CLASSES[item.number].name in both]]
    whole = Selection.of(rows, rows.parts, predicted=True).with_groups(chosen)
    velocity = whole.classes(0, whole.states[0])[[item.name for item in CLASSES].index(both[0])]
    weights = np.zeros(whole.states[0].gram.columns)
    weights[np.isin(whole.states[0].gram.group, velocity)] = 1.0
    torque = rows.joints[0].whitened[:, whole.columns(0, whole.states[0])] @ (
        weights * whole.mean(0, whole.states[0])[0]
    )
    columns = (torque * rows.problem.noise[0])[None, :, None]
    monkeypatch.setattr(names_beside, "SPEAK", 1e9)
    for share, left in ((0.0, set(both)), (1.0, {both[1]})):
        name = Named("", (0,), share * columns, np.ones(1), 0.0)
        assert held_beside(rows, [name], chosen) == {0: left}
