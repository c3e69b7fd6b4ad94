"""Claims about what an action of an operator tells. Truth: MuJoCo's inverse dynamics of the arm before and after it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import norm

from fixtures.cases.arm import GRAVITY, Arm, random_links, sign
from fixtures.cases.excitation import excitation_of
from identification.base_parameters import BaseRegressor
from identification.errors import RecordingError
from identification.excitation import default_trajectory, iiwa_limits, validation_trajectory
from identification.investigation.actions import TOLD, added_mass, differences, levelled, turned_tool, warmed_up
from identification.investigation.added_mass import AddedMass
from identification.investigation.day_terms import day_terms
from identification.investigation.discrepancy import Discrepancies
from identification.investigation.equivalences import INVISIBLE
from identification.investigation.experiments import Room, experiment
from identification.mismatch.evidence import Evidence
from identification.mismatch.reduction import build_evidence
from identification.mismatch.unknown.inputs import Ranges
from identification.recordings.reader import read_recording
from identification.robots import RobotModel

FloatArray = npt.NDArray[np.float64]

PERIODS, NOISE_NM = 4, 0.05
MASS = AddedMass(2.0, (0.03, -0.02, 0.05))
FLANGE_M = 0.126
OFFSET_NM = 0.3


class Recorded:
    """Recordings of the shipped motion of one arm with a smooth error of the model that nobody knows."""

    def __init__(self, folder: Path, robot: RobotModel, regressor: BaseRegressor) -> None:
        self.arm = Arm(random_links(np.random.default_rng(5)))
        self._folder, self._robot, self._regressor = folder, robot, regressor
        self._random = np.random.default_rng(9)
        self._number = 0

    def __call__(
        self,
        arm: Arm,
        *,
        gain: float = 0.0,
        friction: float = 1.0,
        offset: float = 0.0,
        other: bool = False,
        error: float = 0.3,
        gravity: FloatArray = GRAVITY,
        noise: float = NOISE_NM,
    ) -> Evidence:
        motion = excitation_of("", (validation_trajectory() if other else default_trajectory()).table())
        torque = arm.inverse_dynamics(motion.position, motion.velocity, motion.acceleration, gravity)
        links = arm.links
        torque += friction * (links.viscous * motion.velocity + links.coulomb * sign(motion.velocity))
        torque += error * np.cos(motion.position + 2.0 * np.roll(motion.position, 1, axis=1))
        torque *= 1.0 + gain
        torque[:, 3] += offset
        noisy = np.tile(torque, (PERIODS, 1)) + noise * self._random.normal(size=(PERIODS * len(torque), 7))
        file = self._folder / f"{self._number}.npz"
        self._number += 1
        position = np.tile(motion.position, (PERIODS, 1))
        np.savez(file, t=1e-3 * np.arange(len(noisy)), q=position, tau=noisy, robot=np.array("iiwa14"), period_s=10.0)
        return build_evidence(read_recording(file), self._robot, self._regressor)[0]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, iiwa14: RobotModel, iiwa14_base: BaseRegressor) -> Recorded:
    return Recorded(tmp_path_factory.mktemp("actions"), iiwa14, iiwa14_base)


@pytest.fixture(scope="module")
def before(recorded: Recorded) -> Evidence:
    return recorded(recorded.arm, offset=OFFSET_NM)


def with_mass(arm: Arm) -> Arm:
    """The flange is turned by half a turn about the last link's z."""
    return arm.with_point_mass(MASS.mass_kg, np.array([-0.03, 0.02, FLANGE_M + 0.05]))


@pytest.mark.parametrize(("gain", "answer"), [(0.0, "no_common_gain"), (0.01, "common_gain")])
def test_a_known_mass_tells_a_gain_of_all_sensors(recorded: Recorded, gain: float, answer: str) -> None:
    arm = recorded.arm
    told = added_mass(differences(recorded(arm, gain=gain), recorded(with_mass(arm), gain=gain))[0], MASS)
    assert (told.answer, told.settled) == (answer, True)
    read = float(told.sentence.split("read ")[1].split(" ±")[0])
    assert read == pytest.approx(100.0 * (1.0 + gain), abs=0.2)


def test_a_mass_on_the_axis_of_the_last_joint_tells_by_the_others(recorded: Recorded) -> None:
    """The example of the manual: such a mass loads joint 7 with nothing."""
    mass, arm = AddedMass(2.0, (0.0, 0.0, 0.05)), recorded.arm
    loaded = arm.with_point_mass(2.0, np.array([0.0, 0.0, FLANGE_M + 0.05]))
    told = added_mass(differences(recorded(arm, gain=0.01), recorded(loaded, gain=0.01))[0], mass)
    assert (told.answer, told.settled) == ("common_gain", True)
    assert "read 101." in told.sentence


def test_a_mass_that_nobody_fastened_settles_nothing(recorded: Recorded) -> None:
    told = added_mass(differences(recorded(recorded.arm), recorded(recorded.arm))[0], MASS)
    assert not told.settled
    assert "see that the mass is on the flange" in told.sentence


@pytest.mark.parametrize("kind", ["fourier", "one_joint", "loads"])
@pytest.mark.parametrize("invisible", sorted(INVISIBLE))
def test_what_is_called_invisible_is_a_combination_of_base_columns_on_any_motion(
    recorded: Recorded, iiwa14_base: BaseRegressor, kind: str, invisible: str
) -> None:
    """Truth: MuJoCo's torque of the whole arm, with viscous friction, and of a mass on its last link."""
    room = Room(iiwa_limits("iiwa14"), np.zeros(7))
    position, velocity, acceleration = (
        part[::20] for part in experiment(np.random.default_rng(4), room, kind, 3).states
    )
    arm, links = recorded.arm, recorded.arm.links
    rigid = arm.inverse_dynamics(position, velocity, acceleration)
    gain = 0.02 * (rigid + links.viscous * velocity)
    hidden = gain if invisible == "gain" else with_mass(arm).inverse_dynamics(position, velocity, acceleration) - rigid
    columns = iiwa14_base.matrix(position, velocity, acceleration).reshape(-1, iiwa14_base.size)
    left = hidden.ravel() - columns @ np.linalg.lstsq(columns, hidden.ravel(), rcond=None)[0]
    assert np.abs(left).max() < 1e-6 * np.abs(hidden).max()


def test_a_load_that_turns_is_no_last_link(recorded: Recorded) -> None:
    """Truth: first moments of a point mass, 1.5 kg at (0.04, 0.01) m, that is turned by half a turn."""
    place = np.array([0.04, 0.01, 0.2])
    first, second = (recorded.arm.with_point_mass(1.5, place * np.array([side, side, 1.0])) for side in (1.0, -1.0))
    told = turned_tool(differences(recorded(first), recorded(second))[0])
    assert told.answer == "load"
    moments = [float(part.split()[-1]) for part in told.sentence.split(" ±")[:2]]
    np.testing.assert_allclose(moments, [0.06, 0.015], atol=2e-3)


def test_a_last_link_of_another_mass_stays_where_it_is(recorded: Recorded) -> None:
    arm = recorded.arm.with_point_mass(1.5, np.array([0.04, 0.01, 0.2]))
    assert turned_tool(differences(recorded(arm), recorded(arm))[0]).answer == "last_link"


@pytest.mark.parametrize(("lean_deg", "answer"), [(0.3, "base_tilt"), (0.0, "level")])
def test_a_base_that_is_levelled_tells_how_far_it_leaned(recorded: Recorded, lean_deg: float, answer: str) -> None:
    """Truth: gravity as MuJoCo has it, turned about the base's x axis in the first of two recordings alone."""
    lean = np.radians(lean_deg)
    first = recorded(recorded.arm, gravity=9.81 * np.array([0.0, np.sin(lean), -np.cos(lean)]))
    told = levelled(differences(first, recorded(recorded.arm))[0])
    assert (told.answer, told.settled) == (answer, True)
    angle = float(told.sentence.split("by ")[1].split(" ±")[0])
    assert angle == pytest.approx(lean_deg, abs=0.03)


@pytest.mark.parametrize(
    ("friction", "offset", "answer"),
    [(0.7, OFFSET_NM, "sensor_offset"), (0.7, 0.7 * OFFSET_NM, "asymmetric_coulomb_friction"), (1.0, OFFSET_NM, "")],
)
def test_a_warm_arm_tells_an_offset_from_friction(
    recorded: Recorded, before: Evidence, friction: float, offset: float, answer: str
) -> None:
    """Friction of a warm arm is less by a share, and so is the part of it that differs between directions."""
    after = recorded(recorded.arm, friction=friction, offset=offset)
    dry = float(recorded.arm.links.coulomb[3])
    told = warmed_up(differences(before, after), 3, (OFFSET_NM, 0.005), (dry, 0.005))
    assert told.answer == answer
    assert told.settled == bool(answer)


def test_recordings_whose_torque_is_compared_up_to_different_frequencies_are_compared_up_to_the_lower(
    recorded: Recorded, before: Evidence
) -> None:
    """How far it is compared follows from each recording's own noise. Truth: the offset and friction put in."""
    cold = recorded(recorded.arm, offset=OFFSET_NM, noise=0.3)
    assert len(cold.torque) < len(before.torque)
    for first, second in ((before, cold), (cold, before)):
        (difference,) = differences(first, second)
        assert difference.rows.shape == cold.torque.shape
        assert levelled(difference).answer == "level"
    warm = (
        recorded(recorded.arm, friction=share, offset=OFFSET_NM, noise=noise)
        for share, noise in ((0.7, 0.3), (0.6, 0.05))
    )
    dry = float(recorded.arm.links.coulomb[3])
    assert warmed_up(differences(before, *warm), 3, (OFFSET_NM, 0.005), (dry, 0.005)).answer == "sensor_offset"


OFFSET, DRY = 0.17, 5.0
"""Nm: a small offset, and Coulomb friction, of the drawn worlds."""


def drawn(random: np.random.Generator, share: float, periods: int, *, falls: bool) -> Any:
    """Rows of a joint whose friction is a share of the cold one, and the offset with it where it falls."""
    rows = 200
    velocity = np.tile(np.sin(2.0 * np.pi * (2.0 * np.arange(rows) / rows + 0.1))[:, None], (1, 7))
    motion = SimpleNamespace(velocity=velocity, coulomb_velocity=0.0, position=np.zeros((rows, 7)))
    torque = DRY * share * np.sign(velocity) + OFFSET * (share if falls else 1.0)
    noise = np.full((rows, 7), 0.2 * np.sqrt(8.0 / periods))
    torque = torque + noise * random.normal(size=torque.shape)
    return SimpleNamespace(motion=motion, torque=torque, noise=noise, project=lambda part: part)


def warm_answers(random: np.random.Generator, count: int, *, falls: bool) -> tuple[str, str]:
    """What the last of some warm recordings tells alone, and what all of them do, of a small offset.

    Truth: drawn rows of a cold recording with eight periods and warm ones with four; friction falls by 30 % or more.
    """
    cold = drawn(random, 1.0, 8, falls=falls)
    warm = differences(cold, *(drawn(random, float(random.uniform(0.5, 0.7)), 4, falls=falls) for _ in range(count)))
    of = (OFFSET, 0.01), (DRY, 0.02)
    return warmed_up(warm[-1:], 3, *of).answer, warmed_up(warm, 3, *of).answer


@pytest.mark.parametrize("falls", [True, False])
def test_a_warm_recording_says_as_much_as_the_likelihood_of_what_was_recorded(falls: bool) -> None:
    """Truth: of two means c and w with the share s left of the friction, w - c is noise, or w - s c is."""
    random = np.random.default_rng(4)
    asked = 0
    for _ in range(300):
        share = float(random.uniform(0.55, 0.8))
        cold, warm = (drawn(random, part, periods, falls=falls) for part, periods in ((1.0, 8), (share, 4)))
        c, w = (float(item.torque[:, 3].mean()) for item in (cold, warm))
        of_c, of_w = (float(item.noise[0, 3]) ** 2 / len(item.torque) for item in (cold, warm))
        odds = norm.logpdf(w, share * c, math.sqrt(of_w + share**2 * of_c)) - norm.logpdf(w, c, math.sqrt(of_w + of_c))
        told = warmed_up(differences(cold, warm), 3, (c, math.sqrt(of_c)), (DRY, 0.01)).answer
        # What stands out from the model makes the noise larger than it is by up to a fifth.
        if abs(odds) > 1.3 * TOLD or abs(odds) < TOLD / 1.3:
            asked += 1
            of_odds = "asymmetric_coulomb_friction" if odds > 0.0 else "sensor_offset"
            assert told == (of_odds if abs(odds) > TOLD else ""), (odds, told)
    assert asked > 200


@pytest.mark.parametrize(("falls", "truth"), [(True, "asymmetric_coulomb_friction"), (False, "sensor_offset")])
def test_warm_recordings_judged_together_tell_more_often_and_are_right(falls: bool, truth: str) -> None:
    random = np.random.default_rng(31)
    alone, together = (
        np.array(part) for part in zip(*(warm_answers(random, 4, falls=falls) for _ in range(300)), strict=True)
    )
    assert np.mean(together == truth) > np.mean(alone == truth) + 0.15
    for told in (alone, together):
        wrong = (told != truth) & (told != "")
        assert np.mean(wrong) < 0.05  # odds of 20 to 1 are asked for


def no_classes(rows: list[Evidence]) -> Discrepancies:
    return Discrepancies(((),) * 7, Ranges.of([item.motion for item in rows]), 0.5)


def test_friction_and_an_offset_that_change_get_a_term_of_their_own(recorded: Recorded) -> None:
    """Truth: in the third recording friction is 15 % less everywhere, and joint 4 has an offset."""
    rows = [
        recorded(recorded.arm, error=0.0),
        recorded(recorded.arm, error=0.0, other=True),
        recorded(recorded.arm, error=0.0, friction=0.85, offset=0.1),
    ]
    terms = day_terms(rows, (), no_classes(rows), (np.zeros(0),) * 7)
    assert sorted((term.recording, term.joint) for term in terms) == [(2, joint) for joint in range(7)]
    found = {term.joint: term for term in terms}
    for joint, term in found.items():
        truth = [0.1 if joint == 3 else 0.0, -0.15 * recorded.arm.links.coulomb[joint]]
        np.testing.assert_allclose(term.change[:2], truth, atol=4.0 * float(term.deviation[:2].max()))
    assert "offset by +0.1" in found[3].sentence


def test_nothing_changes_where_another_motion_is_all(recorded: Recorded) -> None:
    rows = [recorded(recorded.arm, error=0.0), recorded(recorded.arm, error=0.0, other=True)]
    assert day_terms(rows, (), no_classes(rows), (np.zeros(0),) * 7) == ()


def test_another_motion_is_refused(recorded: Recorded, before: Evidence) -> None:
    with pytest.raises(RecordingError, match="is not the motion of"):
        differences(before, recorded(recorded.arm, other=True))


def test_what_cancels_leaves_the_noise_of_both(recorded: Recorded, before: Evidence) -> None:
    """Truth: whitened rows of nothing but noise have mean square one."""
    rows = differences(before, recorded(recorded.arm, offset=OFFSET_NM))[0]
    whitened = (rows.rows / rows.noise)[200:]
    assert float(np.mean(whitened**2)) == pytest.approx(1.0, abs=0.1)
    shifted = replace(before, torque=before.torque)
    assert np.all(differences(before, shifted)[0].rows == 0.0)
