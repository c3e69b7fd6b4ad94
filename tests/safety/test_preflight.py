"""The preflight: known good and known bad tables, and agreement with the guard that judges the same rows one by one."""

from __future__ import annotations

import json

import numpy as np
import pytest

from safety.braking import stopping_state
from safety.collision import ForbiddenBox, Plane, Workspace
from safety.errors import TrajectoryShapeError
from safety.geometry import load_geometry
from safety.limits import IIWA14_R820
from safety.preflight import _Motion, _stopping_states, preflight
from safety.preflight_distance import Distances, SampledPath, sample
from safety.preflight_report import Check, PreflightReport
from safety.ramps import plan_stop_ramp
from tests.safety.motions import random_fourier_table

PERIOD = 0.001
LIMITS = IIWA14_R820


def _sway(amplitude: float = 0.3, seconds: float = 4.0, **joints: float) -> np.ndarray:
    """All joints swing at 0.5 Hz by `amplitude` about 0, or about the centre given as q4=..."""
    t = np.arange(round(seconds / PERIOD)) * PERIOD
    table = amplitude * np.sin(2 * np.pi * 0.5 * t)[:, None] * np.ones(7)
    for name, center in joints.items():
        table[:, int(name[1:]) - 1] += center
    return table


def _named(report: PreflightReport, name: str) -> Check:
    return next(check for check in report.checks if check.name == name)


def test_a_gentle_table_is_safe_and_says_so_in_every_check() -> None:
    report = preflight(_sway(), PERIOD, LIMITS, geometry=load_geometry("iiwa14"), start_row=3000)
    assert report.safe, report.failures
    assert [check.name for check in report.checks] == [
        "finite", "position", "velocity", "acceleration", "jerk", "stopping_velocity", "stop", "start_ramp",
        "self_collision", "workspace", "stop_self_collision", "stop_workspace", "start_self_collision",
        "start_workspace",
    ]  # fmt: skip
    assert all(check.sentence.endswith(".") for check in report.checks)
    assert _named(report, "velocity").value == pytest.approx(0.3 * np.pi, rel=1e-4)
    assert _named(report, "acceleration").value == pytest.approx(0.3 * np.pi**2, rel=1e-4)
    paths = {clearance.along for clearance in report.clearances}
    assert paths == {"motion", "stop", "start ramp"}
    assert len({(each.along, each.pair) for each in report.clearances}) == len(report.clearances) == 3 * (12 + 5)


def test_joint_four_at_two_point_two_radians_is_named() -> None:
    report = preflight(_sway(0.1, q4=2.1), PERIOD, LIMITS)
    check = _named(report, "position")
    assert not report.safe
    assert (check.passed, check.joint, check.unit) == (False, 4, "rad")
    assert check.value == pytest.approx(2.2, abs=1e-5)
    assert check.limit == pytest.approx(2.0944, abs=1e-4)
    assert "Joint 4 comes to 2.2000 rad" in check.sentence


def test_a_table_of_more_than_a_turn_is_asked_for_its_unit() -> None:
    for scale, asked in ((1.0, False), (3.0, False), (180.0 / np.pi, True)):
        check = _named(preflight(scale * _sway(0.8), 1e-3, IIWA14_R820), "position")
        assert check.sentence.endswith(" Is the table in degrees?") == asked


def test_a_lower_limit_is_named_with_its_sign() -> None:
    check = _named(preflight(_sway(0.1, q2=-2.1), PERIOD, LIMITS), "position")
    assert check.value == pytest.approx(-2.2, abs=1e-5)
    assert check.limit == pytest.approx(-2.0944, abs=1e-4)


def test_nan_is_named_with_its_row_and_nothing_else_is_said() -> None:
    table = _sway()
    table[1234, 5] = np.nan
    report = preflight(table, PERIOD, LIMITS, geometry=load_geometry("iiwa14"))
    assert not report.safe
    (check,) = report.checks
    assert (check.name, check.joint, check.row) == ("finite", 6, 1234)
    assert "Row 1234" in check.sentence
    assert "joint 6" in check.sentence


def test_too_fast_and_too_violent_are_told_apart() -> None:
    fast = preflight(_sway(1.0), PERIOD, LIMITS)
    assert [check.name for check in fast.failures] == ["velocity", "acceleration"]
    assert _named(fast, "velocity").joint == 4
    t = np.arange(4000) * PERIOD
    violent = 0.02 * np.sin(2 * np.pi * 5 * t)[:, None] * np.ones(7)
    assert [check.name for check in preflight(violent, PERIOD, LIMITS).failures] == ["acceleration"]


def test_a_seam_that_does_not_close_is_found_where_it_is() -> None:
    table = _sway() + np.linspace(0, 0.05, 4000)[:, None]
    repeated = preflight(table, PERIOD, LIMITS)
    assert not repeated.safe
    assert _named(repeated, "velocity").row == 0


def test_a_table_that_turns_at_its_limit_with_full_deceleration_fails_the_stop_not_the_position() -> None:
    """The table turns joint 1 one millimetre-radian before its limit and is back before the deceleration has to end; a
    stop has to take the deceleration back while it still moves outwards, and that takes it past the limit.
    """
    t = np.arange(2000) * PERIOD
    omega = 2 * np.pi * 1.0
    amplitude = 0.97 * LIMITS.acceleration[0] / omega**2
    table = np.zeros((2000, 7))
    table[:, 0] = LIMITS.position_upper[0] - 0.001 - amplitude * (1 - np.cos(omega * t))
    report = preflight(table, PERIOD, LIMITS)
    assert [check.name for check in report.failures] == ["stop"]
    assert _named(report, "stop").joint == 1
    table[:, 0] -= 0.03
    assert preflight(table, PERIOD, LIMITS).safe


def test_a_pose_below_the_floor_fails_the_workspace_with_link_and_distance() -> None:
    report = preflight(_sway(0.02, q2=2.05), PERIOD, LIMITS, geometry=load_geometry("iiwa14"))
    check = _named(report, "workspace")
    assert not check.passed
    assert check.value < -0.05
    assert "link 7 and floor overlap" in check.sentence
    raised = preflight(
        _sway(0.02, q2=2.05),
        PERIOD,
        LIMITS,
        geometry=load_geometry("iiwa14"),
        workspace=Workspace(floor_height_m=-0.7),
    )
    assert _named(raised, "workspace").passed


def test_folded_onto_the_base_fails_self_collision() -> None:
    table = _sway(0.02, q2=-2.0, q4=2.01, q3=0.26, q6=1.22)
    report = preflight(
        table, PERIOD, LIMITS, geometry=load_geometry("iiwa14"), workspace=Workspace(floor_height_m=None)
    )
    assert not _named(report, "self_collision").passed
    assert "link 0" in _named(report, "self_collision").sentence


def test_a_forbidden_box_in_the_way_is_named() -> None:
    report = preflight(
        _sway(0.3, q2=0.8),
        PERIOD,
        LIMITS,
        geometry=load_geometry("iiwa14"),
        workspace=Workspace(boxes=(ForbiddenBox("camera post", (0.7, 0.0, 0.9), (0.1, 0.1, 1.8)),)),
    )
    assert "camera post" in _named(report, "workspace").sentence
    assert not _named(report, "workspace").passed


def test_torques_are_checked_where_given() -> None:
    table = _sway()
    torque = np.zeros_like(table)
    torque[77, 5] = -41.0
    check = _named(preflight(table, PERIOD, LIMITS, torque=torque), "torque")
    assert (check.passed, check.joint, check.row, check.value, check.limit) == (False, 6, 77, 41.0, 40.0)
    torque[77, 5] = np.nan
    assert not _named(preflight(table, PERIOD, LIMITS, torque=torque), "torque").passed


def test_a_start_that_cannot_be_reached_is_an_answer() -> None:
    start = np.zeros(7)
    start[3] = 2.5
    report = preflight(_sway(), PERIOD, LIMITS, start_row=0, start_position=start)
    check = _named(report, "start_ramp")
    assert (check.passed, check.joint, check.value) == (False, 4, 2.5)


def test_the_report_is_plain_json() -> None:
    report = preflight(_sway(), PERIOD, LIMITS, geometry=load_geometry("iiwa14"), workspace=Workspace(None))
    text = json.dumps(report.to_json(), allow_nan=False)
    assert json.loads(text)["safe"] is True
    assert {"pair", "along", "distance_m", "guaranteed_m", "margin_m", "row"} == set(json.loads(text)["clearances"][0])


def test_the_stopping_states_of_guard_and_preflight_are_one_formula() -> None:
    generator = np.random.default_rng(3)
    velocity = generator.uniform(-1, 1, (200, 7)) * LIMITS.velocity * generator.choice([1e-5, 1.0], (200, 7))
    acceleration = generator.uniform(-1, 1, (200, 7)) * LIMITS.acceleration * generator.choice([1e-5, 1.0], (200, 7))
    speeds, rates = _stopping_states(velocity, acceleration, LIMITS, PERIOD)
    for row in range(200):
        for i in range(7):
            expected = stopping_state(
                velocity[row, i], acceleration[row, i], LIMITS.acceleration[i], LIMITS.jerk[i], PERIOD
            )
            assert (speeds[row, i], rates[row, i]) == pytest.approx(expected, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("scale", [0.9, 1.05])
def test_random_motions_pass_below_the_limits_and_fail_above(scale: float) -> None:
    generator = np.random.default_rng(4)
    table = random_fourier_table(generator, LIMITS)
    middle = (LIMITS.position_upper + LIMITS.position_lower) / 2
    assert preflight(middle + scale * (table - middle), PERIOD, LIMITS).safe is (scale < 1)


def test_shapes_that_are_no_table_are_refused() -> None:
    with pytest.raises(TrajectoryShapeError, match=r"\(5, 6\)"):
        preflight(np.zeros((5, 6)), PERIOD, LIMITS)
    with pytest.raises(TrajectoryShapeError, match="sample period"):
        preflight(np.zeros((5, 7)), 0.0, LIMITS)
    with pytest.raises(TrajectoryShapeError, match="torques"):
        preflight(_sway(), PERIOD, LIMITS, torque=np.zeros((3, 7)))


def test_the_bound_on_stops_holds_for_the_stop_from_every_row() -> None:
    """Held against each stop by itself, looked at four times as densely as the preflight does."""
    table, geometry = _sway(0.12, 2.0, q2=0.4, q4=-1.0)[::2], load_geometry("iiwa14")
    motion = _Motion.of(table, PERIOD, True, LIMITS)
    rows = range(0, len(table), 61)
    paths = []
    for row in rows:
        ramp = plan_stop_ramp(table[row], motion.stop_velocity[row], motion.stop_acceleration[row], LIMITS)
        paths.append(SampledPath(sample(ramp, 0.005), 0.005, row))
    # A wall so far from the furthest point of any stop.
    reached = max(float(geometry.tip_path(path.positions)[:, 0].max()) for path in paths)
    walls = (Plane("wall", (-1.0, 0.0, 0.0), -(reached + 0.09)),)
    workspace = Workspace(floor_height_m=None, walls=walls)
    report = preflight(table, PERIOD, LIMITS, geometry=geometry, workspace=workspace)
    _, single = Distances(geometry, workspace, LIMITS).check(paths, "stop")
    smallest = {each.pair: each.distance_m for each in single}
    claimed = {each.pair: each for each in report.clearances if each.along == "stop"}
    assert claimed.keys() == smallest.keys()
    for pair, clearance in claimed.items():
        assert clearance.guaranteed_m <= smallest[pair] + 1e-6
    # Near a wall more stops are looked at, until the bound says what is true: they keep the margin.
    assert report.safe == (min(smallest.values()) > 0.03), report.failures
