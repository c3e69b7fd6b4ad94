"""Which name of several that explain alike is given. Truth: what was written onto the plant's torque."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daemon.cli.diagnosis import verdict_lines
from fixtures.cases.draw import draw_case
from fixtures.cases.files import write_recordings
from identification.base_parameters import BaseRegressor
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.effects import EFFECTS, effect_named
from identification.mismatch.effects.base import Place
from identification.mismatch.problem import build_problem
from identification.mismatch.reduction import build_evidence
from identification.mismatch.search.library import Library
from identification.mismatch.search.refinement import Member, estimate_of
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording, read_recording
from identification.report.diagnosis_sections import verdict_sentence
from identification.robots import RobotModel
from tests.identification.mismatch.plant import on_joint, record


@pytest.mark.parametrize(("deviations", "name"), [(3.3, "torque_offset"), (12.0, "cable_spring")])
def test_an_offset_is_called_a_spring_only_where_its_slope_is_plain(
    iiwa14: RobotModel,
    iiwa14_base: BaseRegressor,
    table3: PhysicalParameters,
    deviations: float,
    name: str,
) -> None:
    (evidence,) = build_evidence(record(iiwa14, table3), iiwa14, iiwa14_base)
    problem, library = build_problem([evidence]), Library(EFFECTS, [evidence])
    rows = library.rows(effect_named("cable_spring"), Place(joint=6), ())
    assert rows is not None
    of_noise, covariance = estimate_of(problem, Member(rows))
    # So that it comes out at so many deviations with this very noise.
    slope = deviations * float(np.sqrt(covariance[0, 0])) - float(of_noise[0])

    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return on_joint(6, 0.5 + slope * q[:, 5])

    unseen = record(iiwa14, table3, hidden, periods=4, motion=9, seed=2)
    diagnosis = diagnose([record(iiwa14, table3, hidden)], iiwa14, heldout=[unseen])
    assert [(item.effect, item.place.joint) for item in diagnosis.findings] == [(name, 6)]
    if name == "torque_offset":
        assert "orque offset of joint 6 stands in the place of cable spring of joint 6; the held" in diagnosis.remaining


@pytest.mark.parametrize(("size", "verdict"), [(0.0056, "unexplained"), (0.01, "explained")])
def test_what_is_there_and_too_weak_for_a_name_is_said_with_the_form_that_fits(
    iiwa14: RobotModel, table3: PhysicalParameters, size: float, verdict: str
) -> None:
    """Friction of joint 6 that rises with its load, of λ 50 and λ 160. The verdict was "explained" of both."""

    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        load = np.abs(torque[:, 5])
        return on_joint(6, size * load / load.mean() * np.sign(dq[:, 5]))

    diagnosis = diagnose([record(iiwa14, table3, hidden)], iiwa14)
    weak = "Load dependent friction of joint 6 is too weak here to be told from other physics" in diagnosis.remaining
    assert diagnosis.verdict == verdict
    assert weak == (not diagnosis.findings) == (verdict == "unexplained")
    too_weak = [{"effect": "load_dependent_friction", "joint": 6}] if weak else []
    assert diagnosis.to_json()["too_weak"] == too_weak
    for said in (verdict_lines(diagnosis)[0], verdict_sentence(diagnosis)):
        assert ("too weak" in said) == weak
        assert "nothing known" not in said
        assert "no effect that is known" not in said


def test_waves_of_an_order_that_no_gear_has_are_no_ripple(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    def waves(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return on_joint(4, 0.1 * np.sin(35.37 * q[:, 3]))

    unseen = record(iiwa14, table3, waves, periods=4, motion=9, seed=2)
    diagnosis = diagnose([record(iiwa14, table3, waves)], iiwa14, heldout=[unseen])
    assert diagnosis.verdict == "unexplained"
    assert not diagnosis.findings
    assert "Joint 4" in diagnosis.remaining


def drawn(seed: int, index: int, folder: Path, group: str, *families: str) -> tuple[Recording, Recording]:
    """A concealed case of an opened seed, which has to be what its test says of it."""
    case = draw_case(seed, index)
    assert (case.label["group"], *(effect["family"] for effect in case.label["effects"])) == (group, *families)
    first, second = (read_recording(path) for path in write_recordings(case, folder))
    return first, second


def test_a_torque_of_no_known_kind_is_not_written_as_a_sum_of_names(iiwa14: RobotModel, tmp_path: Path) -> None:
    """A cable that rubs along its guide was a spring, an inertia and a drag, none of them missed for much."""
    first, second = drawn(300, 92, tmp_path, "outside", "rubbing")
    diagnosis = diagnose([first], iiwa14, heldout=[second])
    assert not diagnosis.findings
    assert "joint 5 describes part of a torque that depends on own position" in diagnosis.remaining


def test_a_name_stands_against_classes_also_where_these_predict_the_other_motion_worse(
    iiwa14: RobotModel, tmp_path: Path
) -> None:
    """A bump at one angle was a wave over the angle: the class has the odds, but the other motion leaves its range."""
    first, second = drawn(2260719, 49, tmp_path, "outside", "bump")
    diagnosis = diagnose([first], iiwa14, heldout=[second])
    assert not diagnosis.findings
    assert [(item.name, item.joint) for item in diagnosis.classes] == [("own_position", 6)]
    assert "joint 6 describes part of a torque that depends on own position" in diagnosis.remaining


def test_what_is_left_of_a_set_that_explained_all_is_judged_as_beside_a_background(
    iiwa14: RobotModel, tmp_path: Path
) -> None:
    """Three names explained a background down to the noise; one fell, the other two stood at a fifth of the score."""
    first, second = drawn(331, 133, tmp_path, "background")
    diagnosis = diagnose([first], iiwa14, heldout=[second])
    assert diagnosis.verdict == "unexplained"
    assert not diagnosis.findings


@pytest.mark.parametrize(
    ("seed", "case", "label", "names"),
    [
        # Five smooth effects explained a background down to the noise.
        (9021, 62, ("background",), []),
        # The background of joint 1 is three times as strong as the ripple, and smooth.
        (9023, 60, ("single_background", "ripple"), [("torque_ripple", 4)]),
    ],
)
def test_beside_a_background_only_what_it_cannot_imitate_is_named(
    iiwa14: RobotModel, tmp_path: Path, seed: int, case: int, label: tuple[str, ...], names: list[tuple[str, int]]
) -> None:
    first, second = drawn(seed, case, tmp_path, *label)
    diagnosis = diagnose([first], iiwa14, heldout=[second])
    assert [(item.effect, item.place.joint) for item in diagnosis.findings] == names
