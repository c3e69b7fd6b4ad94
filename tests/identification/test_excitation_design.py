"""Claims about the search and what is shipped; condition numbers are numpy's, of the regressor that fits use."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor
from identification.errors import DesignError, TrajectoryNotFoundError
from identification.excitation import (
    FourierTrajectory,
    default_trajectory,
    iiwa_limits,
    limits_of_robot,
    trajectory_from_json,
    validation_trajectory,
)
from identification.excitation.constraints import PaperConstraints, verify
from identification.excitation.design import DesignProgress, design_excitation
from identification.excitation.local_search import Descent, DesignSettings, LocalSearch, Problem, Stage
from identification.excitation.objective import BaseMatrix
from identification.excitation.reference import reference_trajectory
from identification.physical_parameters import PhysicalParameters
from identification.robots import load_robot
from safety.collision import Workspace
from safety.geometry import load_geometry
from safety.limits import limits_for
from safety.preflight import preflight

STAGES = (Stage(1.0, 30, 0.6), Stage(0.5, 15, 0.9, 2))
QUICK = DesignSettings(
    seed=3, starts=2, processes=1, samples=40, stages=STAGES, hop=(Descent(15, 2),), polish=Descent(15, 2)
)


def _condition_number(trajectory: FourierTrajectory) -> float:
    motion = trajectory.evaluate(np.arange(1000) / 100.0)
    stacked = BaseRegressor(load_robot(trajectory.robot)).matrix(*motion).reshape(7000, 57)
    return float(np.linalg.cond(stacked))


def test_the_shipped_excitation_reaches_the_papers_condition_number_under_the_full_constraints() -> None:
    trajectory = default_trajectory()
    # The paper reports 65 for the same problem, L = 5, 10 s, 1000 samples.
    assert _condition_number(trajectory) <= 66.0
    report = verify(trajectory, iiwa_limits("iiwa14"))
    assert report["within_paper_limits"]
    assert report["within_limits"]
    assert report["samples"] == 10_000


@pytest.mark.parametrize("robot", ["iiwa14", "iiwa7"])
@pytest.mark.parametrize("shipped", [default_trajectory, validation_trajectory])
def test_a_shipped_file_says_how_it_was_made_and_what_it_achieves(
    shipped: Callable[[str], FourierTrajectory], robot: str
) -> None:
    trajectory = shipped(robot)
    assert trajectory.robot == robot
    assert isinstance(trajectory.record["seed"], int)
    assert trajectory.record["settings"]["harmonics"] == trajectory.harmonics
    assert trajectory.record["achieved"]["cond"] == pytest.approx(_condition_number(trajectory), rel=1e-6)
    assert verify(trajectory, iiwa_limits(robot))["within_limits"]


@pytest.mark.parametrize("robot", ["iiwa14", "iiwa7"])
def test_the_validation_motion_is_another_motion(robot: str) -> None:
    fitted, other = default_trajectory(robot).table(100.0), validation_trajectory(robot).table(100.0)
    correlation = [abs(np.corrcoef(fitted[:, joint], other[:, joint])[0, 1]) for joint in range(7)]
    assert max(correlation) < 0.9


def test_no_trajectory_is_shipped_for_an_unknown_robot() -> None:
    with pytest.raises(TrajectoryNotFoundError, match="design") as caught:
        default_trajectory("../iiwa14")
    assert caught.value.exit_code == 66


def test_a_search_ends_inside_the_constraints_and_far_better_than_it_began() -> None:
    robot = load_robot("iiwa14")
    events: list[DesignProgress] = []
    result = design_excitation(robot, limits_of_robot(robot), QUICK, progress=events.append)
    assert result.verified["within_paper_limits"]
    assert result.verified["within_limits"]
    assert result.cond == pytest.approx(_condition_number(result.trajectory), rel=1e-6)
    # Random trajectories of full amplitude lie at 200 to 800.
    assert result.cond < 120.0
    assert len(events) == len(result.history) == 3
    assert events[-1].best <= events[0].value
    again = trajectory_from_json(json.loads(json.dumps(result.trajectory.to_json())))
    np.testing.assert_array_equal(again.table(100.0), result.trajectory.table(100.0))


def test_the_same_seed_gives_the_same_trajectory_whatever_the_number_of_processes() -> None:
    robot = load_robot("iiwa14")
    limits = limits_of_robot(robot)
    one = design_excitation(robot, limits, QUICK)
    two = design_excitation(robot, limits, replace(QUICK, processes=2))
    np.testing.assert_array_equal(one.trajectory.a, two.trajectory.a)
    np.testing.assert_array_equal(one.trajectory.b, two.trajectory.b)


def test_a_spent_budget_begins_no_further_search_but_still_answers() -> None:
    robot = load_robot("iiwa14")
    ticks = iter(range(0, 10_000, 100))
    settings = replace(QUICK, starts=50, budget_s=1.0)
    result = design_excitation(robot, limits_of_robot(robot), settings, clock=lambda: float(next(ticks)))
    assert [event.stage for event in result.history] == [1, 2]
    assert result.verified["within_paper_limits"]


def test_a_search_whose_time_is_up_ends_with_the_better_of_what_it_has_and_what_it_began_with() -> None:
    robot = load_robot("iiwa14")
    search = LocalSearch(Problem(BaseMatrix(robot), limits_of_robot(robot), QUICK, np.zeros(7)))
    start = search.random_start(np.random.default_rng(3))
    asked: list[int] = []

    def time_is_up_after(iterations: int) -> tuple[float, np.ndarray]:
        asked.clear()

        def time_is_up() -> bool:
            asked.append(1)
            return len(asked) >= iterations

        return search.improve(start, Descent(200), time_is_up)

    one, inside = time_is_up_after(1)
    assert len(asked) == 2  # after the iteration, and when what it has is judged
    ten, _ = time_is_up_after(10)
    assert len(asked) == 11
    assert ten < one
    assert PaperConstraints(iiwa_limits("iiwa14"), np.zeros(7), 0.1, 5).excess(inside).max() <= 1.0 + 1e-12


def test_true_limits_allow_a_better_condition_number_and_hold_at_every_millisecond() -> None:
    robot = load_robot("iiwa14")
    limits = limits_of_robot(robot)
    paper = design_excitation(robot, limits, QUICK)
    true = design_excitation(robot, limits, replace(QUICK, limits="true"))
    assert true.verified["within_limits"]
    assert true.cond < paper.cond


def test_a_motion_that_asks_for_more_torque_than_there_is_is_not_inside_the_limits(table3: PhysicalParameters) -> None:
    """The paper's own limits know no torque; where the bodies are known it is counted all the same."""
    robot, limits = load_robot("iiwa14"), limits_of_robot(load_robot("iiwa14"))
    weak = replace(limits, torque=np.full(7, 20.0))
    sound, asked = (design_excitation(robot, each, QUICK, nominal=table3) for each in (limits, weak))
    assert sound.verified["within_limits"]
    assert max(sound.verified["torque"]) <= 1.0
    assert max(asked.verified["torque"]) > 1.0
    assert not asked.verified["within_limits"]
    assert asked.verified["within_paper_limits"]
    np.testing.assert_array_equal(asked.trajectory.a, sound.trajectory.a)


def test_a_joint_without_limits_is_refused_in_words() -> None:
    limits = limits_of_robot(load_robot("iiwa14"))
    with pytest.raises(DesignError, match=r"joint 3 has no position limits.*state lower and upper") as caught:
        replace(limits, position_upper=np.where(np.arange(7) == 2, np.nan, limits.position_upper))
    assert "nan" not in str(caught.value)


def test_a_joint_whose_range_has_no_zero_moves_about_its_middle() -> None:
    """As joint 4 of a Panda, −3.07 to −0.07 rad: every motion was about zero, and such an arm was refused."""
    limits = replace(
        limits_of_robot(load_robot("iiwa14")),
        position_lower=np.array([-2.9, -1.76, -2.9, -3.07, -2.9, -0.02, -2.9]),
        position_upper=np.array([2.9, 1.76, 2.9, -0.07, 2.9, 3.75, 2.9]),
    )
    designed = design_excitation(load_robot("iiwa14"), limits, QUICK).trajectory
    for motion in (designed, *(reference_trajectory(kind, limits) for kind in ("sine_series", "polynomial_10"))):
        position = motion.evaluate(np.arange(10_000) / 1000.0)[0]
        assert np.all(position > limits.position_lower)
        assert np.all(position < limits.position_upper)
        np.testing.assert_allclose(position[0, [0, 3, 5]], [0.0, -1.57, 1.865], atol=1e-9)
        assert np.ptp(position[:, 3]) > 0.8


def test_nothing_is_returned_that_the_caller_finds_dangerous() -> None:
    robot = load_robot("iiwa14")
    with pytest.raises(DesignError, match="free of collisions"):
        design_excitation(robot, limits_of_robot(robot), QUICK, acceptable=lambda _: False)


def test_a_motion_too_large_to_be_safe_is_made_smaller() -> None:
    robot = load_robot("iiwa14")
    reach = []

    def acceptable(trajectory: FourierTrajectory) -> bool:
        reach.append(float(np.max(np.abs(trajectory.table(100.0)))))
        return reach[-1] < 0.75 * reach[0]

    result = design_excitation(robot, limits_of_robot(robot), replace(QUICK, starts=1), acceptable=acceptable)
    shrunk = result.trajectory.record["settings"]["shrunk_to"]
    assert np.max(np.abs(result.trajectory.table(100.0))) == pytest.approx(shrunk * reach[0])
    assert shrunk == 0.7
    assert result.verified["within_paper_limits"]
    assert result.cond == pytest.approx(_condition_number(result.trajectory), rel=1e-6)


@pytest.mark.parametrize(
    "settings",
    [
        {"objective": "beauty"}, {"harmonics": 2}, {"period_s": 0.0}, {"starts": 0}, {"samples": 10},
        {"limits": "none"}, {"period_s": 1e9}, {"budget_s": 0.0}, {"budget_s": -1.0}, {"budget_s": float("nan")},
        {"seed": -1},
    ],
)  # fmt: skip
def test_settings_nothing_can_be_designed_for_are_refused(settings: dict[str, object]) -> None:
    with pytest.raises(DesignError):
        DesignSettings(**settings)  # type: ignore[arg-type]


def test_limits_for_another_number_of_joints_are_refused() -> None:
    robot = load_robot("iiwa14")
    limits = iiwa_limits("iiwa7")
    short = type(limits)(
        limits.position_lower[:6], limits.position_upper[:6], limits.velocity[:6], limits.acceleration[:6]
    )
    with pytest.raises(DesignError, match="6 joints"):
        design_excitation(robot, short, QUICK)


@pytest.mark.parametrize("robot", ["iiwa14", "iiwa7"])
@pytest.mark.parametrize("shipped", [default_trajectory, validation_trajectory])
def test_the_preflight_accepts_what_is_shipped(shipped: Callable[[str], FourierTrajectory], robot: str) -> None:
    # Limits, stops at any moment, self-collision and floor, by the package that guards the robot.
    report = preflight(
        shipped(robot).table(1000.0),
        0.001,
        limits_for(robot),
        geometry=load_geometry(robot),
        workspace=Workspace(),
        stop_stride=500,
    )
    assert report.safe, [check.sentence for check in report.failures]


def test_a_time_budget_is_used_up_by_hops_from_the_best_motions() -> None:
    """Time is counted in finished searches; without a budget there is no hop, and seed and starts alone decide."""
    stages = (Stage(1.0, 3, 0.5), Stage(0.5, 3, 0.9))
    robot, limits = load_robot("iiwa14"), iiwa_limits("iiwa14")
    finished: list[DesignProgress] = []
    settings = DesignSettings(starts=2, stages=stages, hop=(Descent(3),), polish=Descent(3), seed=1, budget_s=12.0)
    result = design_excitation(robot, limits, settings, progress=finished.append, clock=lambda: float(len(finished)))
    hops = [event for event in result.history if event.planned == 0]
    assert len(hops) > 3
    assert {event.stage for event in hops} == {3}
    assert len({event.start for event in hops}) == len(hops)
    plain = design_excitation(robot, limits, replace(settings, budget_s=None))
    assert not [event for event in plain.history if event.planned == 0]
    assert result.cond <= plain.cond


def test_a_slow_judgement_is_counted_in_the_budget() -> None:
    """Time is counted in finished searches and in judgements of 8 s each, as a preflight takes on a busy machine."""
    robot, limits = load_robot("iiwa14"), iiwa_limits("iiwa14")
    finished: list[DesignProgress] = []
    judged: list[FourierTrajectory] = []

    def acceptable(trajectory: FourierTrajectory) -> bool:
        judged.append(trajectory)
        return True

    def clock() -> float:
        return len(finished) + 8.0 * len(judged)

    settings = DesignSettings(
        starts=2, stages=(Stage(1.0, 3, 0.5),), hop=(Descent(3),), polish=Descent(3), seed=1, budget_s=40.0
    )
    design_excitation(robot, limits, settings, progress=finished.append, clock=clock, acceptable=acceptable)
    assert len(judged) == 2
    assert 30.0 <= clock() <= settings.budget_s
